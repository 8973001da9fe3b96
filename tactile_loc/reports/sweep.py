"""The report of a sweep: every combination, error against time, the effect of each component, and failures."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tactile_loc.evaluation.sweep.combination import IDS, name_time
from tactile_loc.evaluation.sweep.sweep import IDENTITY
from tactile_loc.io.streams.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section
from tactile_loc.slots.registry import SLOTS

NOT_COMPONENTS = ("object", "noise", "seed", "count")
SHOWN_FACTORS = ("object", "encoder", "refiner")  # if no factor varies
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
UNITS = {"_mm": "mm", "_ms": "ms", "_s": "s", "_nats": "nats", "_share": "share"}
MOST_BEST = 4  # number of objects whose best combination is named

Row = dict[str, Any]


def make_sweep_page(path: Path) -> Page:
    """Return the page of a sweep from its sweep.json.

    Raises ResultError if the file cannot be read, and ValueError if it has no combination.
    """
    document = read_document(path)
    rows = read_rows(document)
    lines = find_measured_lines(rows)
    failed = [row for row in rows if row.get("error")]
    good = [row for row in rows if not row.get("error")]
    factors = find_varying(rows) or [factor for factor in SHOWN_FACTORS if factor in rows[0]]
    kinds = find_components(rows) if lines else []
    line_times = {line: name_time(line) for line in lines if name_time(line) in rows[0]}
    times = {column: name for column, name in TIMES.items() if column in rows[0] or (column == OF_LINE and line_times)}
    by = find_varying(rows) or ["object"]
    choices = {"times": times, "factors": by, "first": "refiner" if "refiner" in by else by[0]}
    failures = {"factors": factors, "rows": [[*(row[f] or "" for f in factors), row["error"]] for row in failed]}
    summary = {"numbers": list(_list_numbers(rows, len(failed), lines)), "count": len(good), "lines": lines}
    differences = _tabulate_differences(document, factors)
    sections = [
        Section("summary", "", summary),
        *([Section("time", "Error against time", choices)] if lines and times else []),
        *([Section("effects", "Effect of each component", {"factors": kinds})] if kinds else []),
        *([Section("differences", "Differences from the base", differences)] if differences["rows"] else []),
        Section("rows", "Combinations", _tabulate_rows(good, factors, lines)),
        *([Section("failed", "Failed combinations", failures)] if failed else []),
        Section("made", "Settings", _describe_settings(document, rows)),
    ]
    others = [column for column in dict.fromkeys([*TIMES, *line_times.values(), *OTHERS]) if column in rows[0]]
    ranges = [f"{line}_{end}_{unit}" for line in lines for end in ("low", "high") for unit in ("mm", "ms")]
    columns = [*factors, *(line + MEDIAN for line in lines), *others, *(name for name in ranges if name in rows[0])]
    drawn = [{column: row.get(column) for column in columns} for row in good]
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


def find_components(rows: Sequence[Row]) -> list[str]:
    """Return the components and options that vary."""
    return [factor for factor in find_varying(rows) if factor not in NOT_COMPONENTS]


def find_measured_lines(rows: Sequence[Row]) -> list[str]:
    """Return the lines (kinds of error) whose median is known in at least one row, in the order of `LINES`."""
    columns = [c.removesuffix(MEDIAN) for c in rows[0] if c.endswith(MEDIAN)]
    known = [line for line in columns if any(isinstance(row[line + MEDIAN], float) for row in rows)]
    return sorted(known, key=lambda line: LINES.index(line) if line in LINES else len(LINES))


def _read_value(column: str, value: Any) -> Any:
    if value is None or value == "":
        return None
    if is_factor(column):
        return value if isinstance(value, str) else json.dumps(value)
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else None
    return value


def _write_about(document: Mapping[str, Any], rows: Sequence[Row]) -> str:
    objects = list(dict.fromkeys(str(row.get("object")) for row in rows))
    touches = {str(row.get("count")) for row in rows} - {"None"}
    count = f"{touches.pop()} simulated touches for each combination; " if len(touches) == 1 else ""
    noises = ", ".join(dict.fromkeys(str(row.get("noise")) for row in rows if row.get("noise")))
    noise = f"noise {noises}; " if noises else ""
    return f"objects {', '.join(objects)}; {count}{noise}{document.get('created', '')}"


def _list_numbers(rows: Sequence[Row], failed: int, lines: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    factors = find_varying(rows)
    yield "combinations", str(len(rows)), f"that differ in {', '.join(factors) or 'nothing'}"
    yield "failed", str(failed), "combinations with an error"
    if not lines:
        return
    column = lines[0] + MEDIAN
    for name in list(dict.fromkeys(row["object"] for row in rows))[:MOST_BEST]:
        known = [row for row in rows if row["object"] == name and isinstance(row[column], float)]
        if known:
            best = min(known, key=lambda row: float(row[column]))
            made = ", ".join(str(best[f]) for f in factors if f != "object" and best[f])
            yield f"best of {name}", f"{best[column]:.3g} mm", f"median of {lines[0]}: {made}"


def _tabulate_rows(rows: Sequence[Row], factors: Sequence[str], lines: Sequence[str]) -> dict[str, Any]:
    """Return the headings and rows of a table.

    A heading is (text, whether it is a factor). A cell is (text, number for sorting or None, whether it is a factor).
    """
    measures = [line + MEDIAN for line in TABLE_LINES if line in lines]
    columns = [*factors, *measures, *(column for column in OTHERS if rows and column in rows[0])]
    return {
        "header": [(_write_heading(column), is_factor(column)) for column in columns],
        "rows": [[_format_cell(column, row.get(column)) for column in columns] for row in rows],
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
    found = [row for row in document.get("differences") or [] if isinstance(row, Mapping)]
    named = [factor for factor in factors if found and factor in found[0]]
    rows = [
        [
            *(str(row[name]) if row[name] is not None else "" for name in named),
            *(text for kind, unit in (("error", "mm"), ("time", "ms")) for text in _write_difference(row, kind, unit)),
        ]
        for row in found
    ]
    heads = ["error (mm)", "statement", "time (ms)", "statement"]
    return {"line": str(document.get("line")), "header": [*named, *heads], "left": len(named), "rows": rows}


def _write_difference(row: Mapping[str, Any], kind: str, unit: str) -> Iterator[str]:
    """Yield the difference from the base with its interval, and the statement."""
    value, low, high = (row.get(f"{kind}_difference_{part}{unit}") for part in ("", "low_", "high_"))
    interval = "" if low is None or high is None else f" ({low:+.3g} to {high:+.3g})"
    yield "" if value is None else f"{value:+.3g}{interval}"
    yield str(row.get(f"{kind}_verdict", ""))


def _describe_settings(document: Mapping[str, Any], rows: Sequence[Row]) -> dict[str, Any]:
    factors, first = find_varying(rows), rows[0]
    built, plan, versions = (
        found if isinstance(found := document.get(key), Mapping) else {} for key in ("built", "plan", "versions")
    )
    return {
        "same": [(c, str(first[c])) for c in first if is_factor(c) and c not in factors and first[c] is not None],
        "built": [(stage, count) for stage, count in built.items() if isinstance(count, int)],
        "plan": format_toml(plan),
        "versions": list(versions.items()),
    }
