"""The tables of a sweep: sweep.csv, .parquet, .md and .json. Other commands read sweep.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.runtime.errors import ConfigError, advise_choice
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION
from tactile_loc.evaluation.sweep.sweep import IDENTITY, ChoiceMedian, Sweep
from tactile_loc.evaluation.text_tables import (
    Table,
    build_document,
    format_csv,
    format_document,
    pivot,
    write_parquet,
    write_texts,
)
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import read_json

SCHEMA_VERSION = 1
FAILED = "failed"


def require_line(line: str) -> str:
    """Return `line` if it is a line of the protocol. Raises ConfigError otherwise."""
    if line not in LINES:
        raise ConfigError(f"there is no line {line!r}; {advise_choice(line, LINES)}")
    return line


def write_sweep_tables(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write the tables of a sweep into the folder `out` and return their paths. Raises OutputError.

    The summary shows the errors of `line`, one of the protocol's LINES.
    """
    csv, summary = format_csv(sweep.rows), format_summary(sweep, line)
    written = write_texts(out, "sweep", record_sweep(sweep, line), csv=csv, md=summary)
    return [*written, write_parquet(out / "sweep.parquet", sweep.rows)]


def record_sweep(sweep: Sweep, line: str) -> dict[str, Any]:
    """Return the plan, the versions, the number of built stages, and each row with its settings, as JSON values."""
    configurations = {one.key: one.describe() for one in sweep.combinations}
    return build_document(
        SCHEMA_VERSION,
        protocol_version=PROTOCOL_VERSION,
        line=line,
        plan=sweep.plan.describe(),
        combinations=len(sweep.combinations),
        failed=sweep.failed,
        built=sweep.built,
        rows=[{**row, "configuration": configurations[row["key"]]} for row in sweep.rows],
    )


def read_sweep(folder: Path) -> dict[str, Any]:
    """Read the sweep.json of a folder. Raises ConfigError if the file is missing or damaged."""
    path = folder / "sweep.json"
    try:
        found = read_json(path)
        _require_rows(found["rows"])
        _ = dict(found["versions"])
    except FileNotFoundError as error:
        raise ConfigError(f"there is no file {path}; give the `out` folder of a finished sweep") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path} is damaged ({type(error).__name__}); run this sweep again") from error
    return dict(found)


def _require_rows(rows: list[dict[str, Any]]) -> None:
    """Raise an error that `read_sweep` catches if a row lacks its combination, or has an error that is not a number."""
    if not rows:
        raise ValueError("it has no row")
    for row in rows:
        chosen = [row["configuration"][slot] for slot in SLOTS]
        said = [row[name] for name in IDENTITY], [(one["name"], one["options"].items()) for one in chosen]
        medians = [value for name, value in row.items() if name.endswith("_median_mm")]
        if not said or not all(value is None or isinstance(value, int | float) for value in medians):
            raise ValueError("an error is not a number")


def format_summary(sweep: Sweep, line: str) -> str:
    """Return, as Markdown, a table for each noise with the median ADD of `line`, mm, and a list of failures."""
    plan = sweep.plan
    seeds = f", mean over seeds {', '.join(map(str, plan.seeds))}" if len(plan.seeds) > 1 else ""
    parts: list[str | Table] = [
        f"Median surface distance (ADD, symmetric poses equal) of `{line}` over {plan.count} simulated touches, "
        f"mm{seeds}. The best value of each column is bold."
    ]
    same = [f"{slot} {choices[0].name}" for slot, choices in plan.slots.items() if len(choices) == 1]
    if same:
        parts.append(f"Common to all rows: {', '.join(same)}.")
    medians = sweep.compute_medians(line)
    for noise in plan.noises:
        parts += [f"## Noise: {noise}", tabulate_medians(medians, noise, _mark_best)]
    if sweep.failed:
        parts += [f"## Failed: {sweep.failed} of {len(sweep.combinations)}", "\n".join(_list_failures(sweep))]
    return format_document(f"Sweep: {line}", parts)


def tabulate_medians(medians: Sequence[ChoiceMedian], noise: str, cell: Callable[[float, float], str]) -> Table:
    """Return a row for each label, and a column for each object, for one noise.

    `cell` gives the text of an error, mm, beside the best error of the column. A failed combination has FAILED.
    """
    found = [median._asdict() for median in medians if median.noise == noise]
    best_mm: dict[str, float] = {}
    for one in found:
        best_mm[one["object"]] = np.fmin(one["error_mm"], best_mm.get(one["object"], np.nan))

    def format_cell(one: dict[str, Any]) -> str:
        return FAILED if math.isnan(one["error_mm"]) else cell(one["error_mm"], best_mm[one["object"]])

    header, *rows = pivot(found, ("label",), "object", format_cell)
    return [["components", *header[1:]], *rows]


def _mark_best(error_mm: float, best_mm: float) -> str:
    """Return an error in mm, in bold if it is the best."""
    text = format_mm(1e-3 * error_mm)
    return f"**{text}**" if text == format_mm(1e-3 * best_mm) else text


def _list_failures(sweep: Sweep) -> Iterator[str]:
    for one in sweep.combinations:
        error = sweep.outcomes[one.key].error
        if error:
            names = ", ".join(getattr(one.config, slot).name for slot in sweep.plan.slots)
            yield f"- {one.object}, {names}, noise {one.config.touch.noise}, seed {one.config.seed}: {error}"
