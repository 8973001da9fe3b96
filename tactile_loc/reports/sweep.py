"""The report of a sweep: every combination, error against time, the effect of each component, and failures."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tactile_loc.evaluation.sweep.combination import IDS, TIMED_LINES, name_time
from tactile_loc.evaluation.sweep.sweep import IDENTITY
from tactile_loc.io.streams.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section
from tactile_loc.slots.registry import SLOTS

NOT_COMPONENTS = ("object", "noise", "seed", "count")
SHOWN_FACTORS = ["object", "encoder", "refiner"]  # if no factor varies
MEDIAN = "_median_mm"
LINES = ("chosen", "reg-1", "best-1", "reg-10", "best-10", "best-50", "closest")  # in the order of interest
TABLE_LINES = ("best-1", "reg-1", "chosen", "closest")
OTHERS = ("coverage_80", "nll_nats", "reg-1_ms", "chosen_ms", "model_s", "grid_poses", *IDS)
OF_LINE = "line"  # the choice of the time that belongs to the chosen line
TIMES = {
    OF_LINE: "time per touch of this line (ms)",
    "encode_ms": "encode (ms)",
    "match_ms": "match (ms)",
    "refine_ms": "refine one pose (ms)",
    "choose_ms": "refine nine others and choose (ms)",
    "model_s": "building the model (s)",
}
DRAWN = (  # the results that plots show
    *(f"{line}_{what}_mm" for line in LINES for what in ("median", "low", "high")),
    *(f"{line}_{what}" for line in TIMED_LINES for what in ("ms", "low_ms", "high_ms")),
    *(column for column in TIMES if column != OF_LINE),
)
UNITS = {"_mm": "mm", "_ms": "ms", "_s": "s", "_nats": "nats", "_share": "share"}
MOST_BEST = 4  # number of objects whose best combination is named

Row = dict[str, Any]


def make_sweep_page(path: Path) -> Page:
    """Return the page of a sweep from its sweep.json.

    Raises ResultError if the file cannot be read, and LookupError, TypeError or ValueError if it is not of a sweep.
    """
    document = read_document(path)
    rows = read_rows(document)
    failed = [row for row in rows if row["error"]]
    good = [row for row in rows if not row["error"]]
    varying = find_varying(rows)
    factors, kinds = varying or SHOWN_FACTORS, [name for name in varying if good and name not in NOT_COMPONENTS]
    choices = {"times": TIMES, "factors": factors, "first": "refiner" if "refiner" in factors else factors[0]}
    failures = {"factors": factors, "rows": [[*(row[f] or "" for f in factors), row["error"]] for row in failed]}
    lines = LINES if good else ()
    summary = {"numbers": list(_list_numbers(rows, varying)), "count": len(good), "lines": lines}
    sections = [
        Section("summary", "", summary),
        *([Section("time", "Error against time", choices)] if good else []),
        *([Section("effects", "Effect of each component", {"factors": kinds})] if kinds else []),
        Section("differences", "Differences from the base", _tabulate_differences(document, factors)),
        Section("rows", "Combinations", _tabulate_rows(good, factors)),
        *([Section("failed", "Failed combinations", failures)] if failed else []),
        Section("made", "Settings", _describe_settings(document, rows[0], varying)),
    ]
    drawn = [{column: row[column] for column in (*factors, *DRAWN)} for row in good]
    line_times = {line: name_time(line) for line in LINES}
    data = {"factors": factors, "components": kinds, "rows": drawn, "line_times": line_times}
    title = f"Sweep: {len(rows)} combinations"
    return Page("sweep", title, _write_about(document, rows), sections, data, ["errors.js", "sweep.js"])


def read_rows(document: Mapping[str, Any]) -> list[Row]:
    """Return a sweep's rows, with factors as texts, results as numbers, and None for missing values.

    Raises ValueError if there is no row.
    """
    rows = [{column: _read_value(column, value) for column, value in row.items()} for row in document["rows"]]
    if not rows:
        raise ValueError("it has no combinations")
    return rows


def is_factor(column: str) -> bool:
    """Return whether a column is a factor. Factors define a combination; all other columns are results."""
    return column in IDENTITY or (column.partition(".")[0] in SLOTS and "." in column)


def find_varying(rows: Sequence[Row]) -> list[str]:
    """Return the factors that do not have the same value in all rows."""
    return [column for column in rows[0] if is_factor(column) and len({row[column] for row in rows}) > 1]


def _read_value(column: str, value: Any) -> Any:
    if value is None or value == "":
        return None
    if is_factor(column):
        return value if isinstance(value, str) else json.dumps(value)
    return float(value) if isinstance(value, int | float) else value


def _write_about(document: Mapping[str, Any], rows: Sequence[Row]) -> str:
    objects, noises = (", ".join(dict.fromkeys(row[name] for row in rows)) for name in ("object", "noise"))
    touches = f"{rows[0]['count']} simulated touches for each combination"
    return f"objects {objects}; {touches}; noise {noises}; {document['created']}"


def _list_numbers(rows: Sequence[Row], factors: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    good, column = [row for row in rows if not row["error"]], LINES[0] + MEDIAN
    yield "combinations", str(len(rows)), f"that differ in {', '.join(factors) or 'nothing'}"
    yield "failed", str(len(rows) - len(good)), "combinations with an error"
    for name in list(dict.fromkeys(row["object"] for row in good))[:MOST_BEST]:
        best = min((row for row in good if row["object"] == name), key=lambda row: float(row[column]))
        made = ", ".join(str(best[f]) for f in factors if f != "object" and best[f])
        yield f"best of {name}", f"{best[column]:.3g} mm", f"median of {LINES[0]}: {made}"


def _tabulate_rows(rows: Sequence[Row], factors: Sequence[str]) -> dict[str, Any]:
    """Return the headings and rows of a table.

    A heading is (text, whether it is a factor). A cell is (text, number for sorting or None, whether it is a factor).
    """
    columns = [*factors, *(line + MEDIAN for line in TABLE_LINES), *OTHERS]
    return {
        "header": [(_write_heading(column), is_factor(column)) for column in columns],
        "rows": [[_format_cell(column, row[column]) for column in columns] for row in rows],
    }


def _format_cell(column: str, value: Any) -> tuple[str, str | None, bool]:
    number = isinstance(value, float)
    text = f"{value:.4g}" if number else "" if value is None else str(value)
    return text, repr(value) if number else None, is_factor(column)


def _write_heading(column: str) -> str:
    """Return a column's heading. The heading of a measure has the unit in brackets."""
    if is_factor(column):
        return column
    name = column.replace("_median", "")
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def _tabulate_differences(document: Mapping[str, Any], factors: Sequence[str]) -> dict[str, Any]:
    """Return the headings and cells of the paired differences from the base, and their line of the protocol."""
    found = document["differences"]
    named = [factor for factor in factors if factor in found[0]]  # they are means over seeds
    rows = [
        [
            *("" if row[name] is None else str(row[name]) for name in named),
            *(text for kind, unit in (("error", "mm"), ("time", "ms")) for text in _write_difference(row, kind, unit)),
        ]
        for row in found
    ]
    heads = ["error (mm)", "statement", "time (ms)", "statement"]
    return {"line": document["line"], "header": [*named, *heads], "left": len(named), "rows": rows}


def _write_difference(row: Mapping[str, Any], kind: str, unit: str) -> Iterator[str]:
    """Yield the difference from the base with its interval, and the statement."""
    value, low, high = (row[f"{kind}_difference_{part}{unit}"] for part in ("", "low_", "high_"))
    interval = "" if low is None or high is None else f" ({low:+.3g} to {high:+.3g})"
    yield "" if value is None else f"{value:+.3g}{interval}"
    yield row[f"{kind}_verdict"]


def _describe_settings(document: Mapping[str, Any], row: Row, varying: Sequence[str]) -> dict[str, Any]:
    same = {factor: row[factor] for factor in row if is_factor(factor) and factor not in varying}
    return {
        "same": [(factor, value) for factor, value in same.items() if value is not None],
        "built": list(document["built"].items()),
        "plan": format_toml(document["plan"]),
        "versions": list(document["versions"].items()),
    }
