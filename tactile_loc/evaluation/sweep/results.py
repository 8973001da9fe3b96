"""The files of a sweep: sweep.csv, .parquet, .md, .json, and two pictures. Other commands read sweep.json."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.runtime.errors import ConfigError, OutputError, advise_choice
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION
from tactile_loc.evaluation.sweep.figures import draw_effects, draw_error_time
from tactile_loc.evaluation.sweep.sweep import IDENTITY, Sweep
from tactile_loc.evaluation.tabular import format_json, format_markdown, write_texts
from tactile_loc.io.streams.records import read_versions
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import read_json, write_atomically
from tactile_loc.view.pictures import save_figure

if TYPE_CHECKING:
    import pandas as pd

SCHEMA_VERSION = 1
FAILED = "failed"


def require_line(line: str) -> str:
    """Return `line` if it is a line of the protocol. Raises ConfigError otherwise."""
    if line not in LINES:
        raise ConfigError(f"there is no line {line!r}; {advise_choice(line, LINES)}")
    return line


def write_sweep(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write all results into the folder `out` and return their paths.

    The summary and the pictures show the errors of `line`, one of the protocol's LINES. A picture without data is left
    out. Raises OutputError.
    """
    document, table = format_json(record_sweep(sweep, line)), format_csv(sweep.table)
    written = write_texts(out, "sweep", csv=table, md=format_summary(sweep, line), json=document)
    written.append(write_parquet(out / "sweep.parquet", sweep.table))
    for name, draw in (("error-time", draw_error_time), ("effects", draw_effects)):
        figure = draw(sweep, line)
        path = out / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)  # an older sweep may have drawn it
        else:
            written.append(save_figure(path, figure))
    return written


def format_csv(table: pd.DataFrame) -> str:
    """Return a table as CSV; missing values are empty, and booleans are true or false."""
    truths = table.select_dtypes("boolean").columns
    written = table.assign(**{name: table[name].map({True: "true", False: "false"}) for name in truths})
    return str(written.to_csv(index=False, lineterminator="\n"))


def write_parquet(path: Path, table: pd.DataFrame) -> Path:
    """Write a table as Parquet, atomically, and return the path. Raises OutputError."""
    from pyarrow import ArrowException

    try:
        packed = table.to_parquet(engine="pyarrow", index=False)
    except ArrowException as error:
        raise OutputError(f"{path} cannot be written ({error})") from error
    return write_atomically(path, lambda temporary: temporary.write_bytes(packed))


def record_sweep(sweep: Sweep, line: str) -> dict[str, Any]:
    """Return the plan, the versions, the number of built stages, and each row with its settings, as JSON values."""
    configurations = {one.key: one.describe() for one in sweep.combinations}
    return {
        "schema_version": SCHEMA_VERSION,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": read_versions(),
        "protocol_version": PROTOCOL_VERSION,
        "line": line,
        "plan": sweep.plan.describe(),
        "combinations": len(sweep.combinations),
        "failed": sweep.failed,
        "built": sweep.built,
        "rows": [{**row, "configuration": configurations[row["key"]]} for row in sweep.rows],
    }


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
    parts = [f"# Sweep: {line}\n"]
    parts.append(
        f"Median surface distance (ADD, symmetric poses equal) of `{line}` over {plan.count} simulated touches, "
        f"mm{seeds}. The best value of each column is bold."
    )
    same = [f"{slot} {choices[0].name}" for slot, choices in plan.slots.items() if len(choices) == 1]
    if same:
        parts.append(f"Common to all rows: {', '.join(same)}.")
    medians = sweep.compute_medians(line)
    for noise in plan.noises:
        parts.append(f"\n## Noise: {noise}\n\n{_format_pivot(pivot(medians, noise))}")
    parts += _list_failures(sweep)
    return "\n".join(parts).rstrip() + "\n"


def pivot(medians: pd.DataFrame, noise: str) -> pd.DataFrame:
    """Return the errors of `Sweep.compute_medians` with one noise, mm, with a row for each label.

    Each object has a column.
    """
    found = medians[medians["noise"] == noise]
    wide = found.pivot(index=[*SLOTS, "label"], columns="object", values="error_mm").droplevel(list(SLOTS))
    return wide[list(found["object"].unique())]


def _format_pivot(errors_mm: pd.DataFrame) -> str:
    """Return a pivot as Markdown, with the best value of each column in bold."""
    best = errors_mm.min()
    rows = [
        [str(label), *(_format_cell(value, best[name]) for name, value in row.items())]
        for label, row in errors_mm.iterrows()
    ]
    return format_markdown([["components", *errors_mm.columns], *rows])


def _format_cell(error_mm: float, best_mm: float) -> str:
    if error_mm != error_mm:
        return FAILED
    text = format_mm(1e-3 * error_mm)
    return f"**{text}**" if text == format_mm(1e-3 * best_mm) else text


def _list_failures(sweep: Sweep) -> Iterator[str]:
    if sweep.failed:
        yield f"\n## Failed: {sweep.failed} of {len(sweep.combinations)}\n"
    for one in sweep.combinations:
        error = sweep.outcomes[one.key].error
        if error:
            names = ", ".join(getattr(one.config, slot).name for slot in sweep.plan.slots)
            yield f"- {one.object}, {names}, noise {one.config.touch.noise}, seed {one.config.seed}: {error}"
