"""The tables of a sweep: sweep.csv, .md and .json, differences.csv and touches.csv."""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.runtime.errors import ConfigError, advise_choice
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION
from tactile_loc.evaluation.sweep.combination import IDS, name_time, round_numbers
from tactile_loc.evaluation.sweep.plan import find_varying_slots
from tactile_loc.evaluation.sweep.sweep import FAILED, IDENTITY, ChoiceMedian, Sweep, list_varied_columns
from tactile_loc.evaluation.sweep.uncertainty import ComparedMedian, Estimate
from tactile_loc.evaluation.text_tables import (
    Row,
    Table,
    build_document,
    format_csv,
    format_document,
    format_value,
    pivot,
    write_texts,
)
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import write_atomically, write_text

SCHEMA_VERSION = 1
DIFFERENCES = (
    "Medians of the paired differences from the base, `{base}`, on the same touches. The statement says whether the "
    "95 % interval excludes zero. Of 20 combinations that are equal, about one seems different by chance."
)


def require_line(line: str) -> str:
    """Return `line` if it is a line of the protocol. Raises ConfigError otherwise."""
    if line not in LINES:
        raise ConfigError(f"there is no line {line!r}; {advise_choice(line, LINES)}")
    return line


def write_sweep(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write all results of a sweep into the folder `out` and return their paths. Raises OutputError.

    The summary shows the errors of `line`, one of the protocol's LINES.
    """
    table, summary = format_csv(sweep.rows), format_summary(sweep, line)
    written = write_texts(out, "sweep", record_sweep(sweep, line), csv=table, md=summary)
    differences = write_text(out / "differences.csv", format_csv(list_differences(sweep, line)))
    return [*written, differences, write_touches(out, sweep)]


def write_touches(out: Path, sweep: Sweep) -> Path:
    """Write touches.csv, with a row for each combination, touch and line, and return its path. Raises OutputError."""
    names = [*IDENTITY[:-1], *list_varied_columns(sweep.plan)]

    def write(temporary: Path) -> None:
        with temporary.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([*names, "touch", "refused", "line", "error_mm", "time_ms"])
            for one, row in zip(sweep.combinations, sweep.rows, strict=True):
                if row["error"]:
                    continue
                same = [format_value(row[name]) for name in names]
                refused = sweep.list_touches(one, "refused").astype(int).tolist()
                for line in LINES:
                    values = zip(
                        refused,
                        sweep.list_touches(one, f"{line}_mm").tolist(),
                        sweep.list_touches(one, name_time(line)).tolist(),
                        strict=True,
                    )
                    writer.writerows([*same, i, past, line, mm, ms] for i, (past, mm, ms) in enumerate(values))

    return write_atomically(out / "touches.csv", write)


def list_differences(sweep: Sweep, line: str) -> list[Row]:
    """Return a row for each median of `line`: error and time with their intervals, and the differences from the base.

    Differences are None for the base itself, for other touches, and if one of both failed.
    """
    varied = list_varied_columns(sweep.plan)
    pairs = zip(sweep.combinations, sweep.rows, strict=True)
    rows_of: dict[Any, Row] = {(one.object, one.config.touch.noise, one.place[1:-2]): row for one, row in pairs}
    rows = []
    for one in sweep.compute_medians(line):
        row = rows_of[one.object, one.noise, one.choices]
        values: Row = {name: row[name] for name in ("object", *SLOTS, *varied, "noise")} | {"line": line}
        for kind, unit, compared in (("error", "mm", one.error), ("time", "ms", one.time)):
            for name, estimate in ((kind, compared.median), (f"{kind}_difference", compared.difference)):
                parts = (f"{name}_{unit}", f"{name}_low_{unit}", f"{name}_high_{unit}")
                values |= dict(zip(parts, round_numbers(estimate), strict=True))
            values[f"{kind}_verdict"] = compared.verdict
        rows.append(values)
    return rows


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
        differences=list_differences(sweep, line),
        rows=[{**row, "configuration": configurations[row["key"]]} for row in sweep.rows],
    )


def format_summary(sweep: Sweep, line: str) -> str:
    """Return, as Markdown, tables of the median ADD of `line`, mm, for each noise, and the failures.

    The first table of a noise has the medians, the second the differences from the base.
    """
    plan = sweep.plan
    seeds = f", mean over seeds {', '.join(map(str, plan.seeds))}" if len(plan.seeds) > 1 else ""
    parts: list[str | Table] = [
        f"Median ADD (symmetric poses equal) of `{line}` over {plan.count} simulated touches, "
        f"mm{seeds}, with the 95 % interval in brackets. The best value of each column is bold."
    ]
    same = [f"{slot} {choices[0].name}" for slot, choices in plan.slots.items() if len(choices) == 1]
    if same:
        parts.append(f"Common to all rows: {', '.join(same)}.")
    parts += [_state_changes(sweep.find_changed())] if sweep.find_changed() else []
    medians = sweep.compute_medians(line)
    for noise in plan.noises:
        parts += [f"## Noise: {noise}", tabulate_medians(medians, noise, _mark_best)]
        if find_varying_slots(plan):
            base = next(one.label for one in medians if not any(one.choices))
            parts += [DIFFERENCES.format(base=base), tabulate_differences(medians, noise)]
    if sweep.failed:
        parts += [f"## Failed: {sweep.failed} of {len(sweep.combinations)}", "\n".join(_list_failures(sweep))]
    return format_document(f"Sweep: {line}", parts)


def _state_changes(changed: Mapping[str, Sequence[str]]) -> str:
    """State which slots change the grid or the touches."""
    said = [f"`{slot}` also changes the {' and the '.join(names)}" for slot, names in changed.items()]
    return f"Not all else is equal: {'; '.join(said)}. The columns {' and '.join(IDS)} show which rows share them."


def tabulate_medians(medians: Sequence[ChoiceMedian], noise: str, cell: Callable[[Estimate, float], str]) -> Table:
    """Return a row for each label, and a column for each object, for one noise.

    `cell` gives the text of an error, mm, beside the best error of the column. A failed combination has FAILED.
    """
    found = [vars(one) | {"error_mm": one.error_mm} for one in medians if one.noise == noise]
    best_mm: dict[str, float] = {}
    for one in found:
        best_mm[one["object"]] = np.fmin(one["error_mm"], best_mm.get(one["object"], np.nan))

    def format_cell(one: dict[str, Any]) -> str:
        return FAILED if math.isnan(one["error_mm"]) else cell(one["error"].median, best_mm[one["object"]])

    header, *rows = pivot(found, ("label",), "object", format_cell)
    return [["components", *header[1:]], *rows]


def tabulate_differences(medians: Sequence[ChoiceMedian], noise: str) -> Table:
    """Return a row for each label, and two columns for each object, for one noise: differences of error and time."""
    found = [
        {"label": one.label, "column": f"{one.object}, {unit}", "cell": _write_difference(compared)}
        for one in medians
        if one.noise == noise
        for unit, compared in (("mm", one.error), ("ms", one.time))
    ]
    header, *rows = pivot(found, ("label",), "column", lambda one: str(one["cell"]))
    return [["components", *header[1:]], *rows]


def _write_difference(compared: ComparedMedian) -> str:
    """Return a difference with its interval and its verdict."""
    value, low, high = compared.difference
    if math.isnan(value):
        return compared.verdict
    interval = "" if math.isnan(low) else f" ({low:+.3g} to {high:+.3g})"
    return f"{value:+.3g}{interval}, {compared.verdict}"


def _mark_best(error: Estimate, best_mm: float) -> str:
    """Return an error in mm with its interval, in bold if it is the best."""
    text = format_mm(1e-3 * error.value)
    marked = f"**{text}**" if text == format_mm(1e-3 * best_mm) else text
    if math.isnan(error.low):
        return marked
    return f"{marked} ({format_mm(1e-3 * error.low)} to {format_mm(1e-3 * error.high)})"


def _list_failures(sweep: Sweep) -> Iterator[str]:
    for one in sweep.combinations:
        error = sweep.outcomes[one.key].error
        if error:
            names = ", ".join(getattr(one.config, slot).name for slot in sweep.plan.slots)
            yield f"- {one.object}, {names}, noise {one.config.touch.noise}, seed {one.config.seed}: {error}"
