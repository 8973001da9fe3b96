"""The files of a benchmark: benchmark.json and .md, leaderboard.json, rows.parquet, and the files of BOP."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tactile_loc.benchmark.bop_scenes import make_scenes
from tactile_loc.benchmark.leaderboard import record_leaderboard
from tactile_loc.benchmark.runner import Benchmark
from tactile_loc.benchmark.summary import WITHIN_M, Group, format_within
from tactile_loc.core.formatting import format_mm
from tactile_loc.evaluation.recall.bop import write_bop
from tactile_loc.evaluation.recall.tables import format_share
from tactile_loc.evaluation.tabular import Table, format_json, format_markdown, write_texts
from tactile_loc.sweeps.results import write_parquet

HEAD = (
    "source", "touches", "method", "within 0.5 mm", "1 mm (95 % interval)", "2 mm", "5 mm", "any listed, 1 mm",
    "median, mm", "determined: within 1 mm", "median, mm", "AUC", "MSSD", "calibration error", "covered, 95 %",
    "certain: right", "time",
)  # fmt: skip
TABLE_NOTE = (
    "A pose is measured by its surface distance. The first shares are of examples whose first pose is near enough. "
    "Examples without a pose count as missed. Intervals are bootstrap intervals over the examples. Determined: "
    "examples in which no method lists a wrong pose that explains the touches as well as the true pose. AUC: mean "
    "share within 0.1, 0.2, ... 5 mm. MSSD: average recall of BOP. Certain: examples that the method calls certain."
)
POSES = ("T_base_object", "true_T_base_object", "scores")  # values of a row that are not in the table of rows


def write_benchmark(out: Path, found: Benchmark) -> list[Path]:
    """Write all results into the folder `out`, and return their paths. Raises OutputError."""
    written = write_texts(out, "benchmark", json=format_json(record_benchmark(found)), md=format_summary(found))
    if found.rows:
        written += write_texts(out, "leaderboard", json=format_json(record_leaderboard(found)))
        written.append(write_parquet(out / "rows.parquet", make_table(found)))
        ids, *_ = write_bop(out, make_scenes(found.rows), "benchmark")
        written.append(ids.parent)
    return written


def record_benchmark(found: Benchmark) -> dict[str, Any]:
    """Return the leaderboard's document with the suite's objects, its components, and the failures, as JSON values."""
    return {
        **record_leaderboard(found),
        "plan": found.suite.model_dump(mode="json"),
        "left_out": found.left_out,
        "failed": [{**cell.names, "error": cell.error} for cell in found.failed],
    }


def make_table(found: Benchmark) -> Any:
    """Return all rows as a pandas table, without the listed poses."""
    import pandas as pd

    return pd.DataFrame([{key: value for key, value in row.items() if key not in POSES} for row in found.rows])


def describe_suite(found: Benchmark) -> str:
    """Return a sentence about the suite."""
    suite = found.suite
    summary = f"{suite.summary}. " if suite.summary else ""
    return f"{summary}{suite.examples} examples of each object, seed {suite.seed}."


def format_summary(found: Benchmark) -> str:
    """Return the tables as Markdown."""
    parts = [f"# Benchmark: {found.suite.name}\n", f"{describe_suite(found)} {TABLE_NOTE}\n"]
    if found.rows:
        parts.append(format_markdown(tabulate(found.groups)))
    parts += ["## Sources\n", format_markdown(tabulate_sources(found))]
    parts += ["## Methods\n", format_markdown(tabulate_methods(found))]
    if found.failed:
        parts += ["## Failures\n", format_markdown(tabulate_failures(found))]
    return "\n".join(parts)


def tabulate_sources(found: Benchmark) -> Table:
    """Return a row for each source: its licence, versions and number of objects, or why it was left out."""
    rows = [["source", "licence", "versions", "objects", "left out"]]
    for one in found.sources:
        objects = str(len(one.objects) or "-")
        rows.append([one.entry.label, one.licence or "-", _join_versions(one.libraries), objects, one.problem])
    return rows


def tabulate_methods(found: Benchmark) -> Table:
    """Return a row for each method: the paper that it follows and its versions, or why it was left out."""
    rows = [["method", "follows", "versions", "left out"]]
    for one in found.methods:
        rows.append([one.entry.label, one.paper or "-", _join_versions(one.libraries), one.problem])
    return rows


def tabulate_failures(found: Benchmark) -> Table:
    """Return a row for each job that ended with an error."""
    return [["source", "object", "method", "error"], *([*cell.names.values(), cell.error] for cell in found.failed)]


def _join_versions(libraries: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in libraries.items()) or "-"


def tabulate(groups: Sequence[Group]) -> Table:
    """Return a table with a row for each group, sorted by source and number of touches, the header first."""
    order = {source: number for number, source in enumerate(dict.fromkeys(group.source for group in groups))}
    ordered = sorted(groups, key=lambda group: (order[group.source], group.touches))
    return [list(HEAD), *(list(list_cells(group)) for group in ordered)]


def list_cells(group: Group) -> Iterator[str]:
    """Yield the cells of a group under HEAD."""
    yield from (group.source, str(group.touches), group.method)
    near = WITHIN_M.index(1e-3)
    for number, share in enumerate(group.within):
        yield format_within(group, number) if number == near else format_share(share)
    yield format_share(group.listed_within[near])
    yield _format_length(group.median_m)
    yield f"{format_share(group.determined_within_1_mm)} of {group.determined}"
    yield _format_length(group.median_determined_m)
    yield f"{group.auc:.2f}"
    yield f"{group.average_recall_mssd:.2f}"
    yield "-" if group.calibration_error is None else f"{group.calibration_error:.2f}"
    yield format_share(group.covered)
    yield f"{group.certain_right} of {group.certain}" if group.certain else "-"
    yield "-" if group.median_s is None else f"{1e3 * group.median_s:.0f} ms"


def _format_length(length_m: float | None) -> str:
    return "-" if length_m is None else format_mm(length_m)
