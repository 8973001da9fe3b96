"""The files of a benchmark: benchmark.json and .md, rows.parquet, and the files of BOP."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tactile_loc.benchmark.runner import Benchmark
from tactile_loc.benchmark.summary import WITHIN_M, Group, summarise
from tactile_loc.core.formatting import format_mm
from tactile_loc.evaluation.recall.tables import format_share
from tactile_loc.evaluation.tabular import format_json, format_markdown, write_texts
from tactile_loc.io.streams.records import read_versions
from tactile_loc.sweeps.results import write_parquet

SCHEMA_VERSION = 1
HEAD = (
    "source", "touches", "method", "within 0.5 mm", "1 mm (95 % interval)", "2 mm", "5 mm", "any listed, 1 mm",
    "median, mm", "determined: within 1 mm", "median, mm", "AUC", "MSSD", "calibration error", "covered, 95 %",
    "certain: right", "time",
)  # fmt: skip


def write_benchmark(out: Path, found: Benchmark) -> list[Path]:
    """Write all results into the folder `out`, and return their paths. Raises OutputError."""
    groups = summarise(found.rows)
    texts = {"json": format_json(record_benchmark(found, groups)), "md": format_summary(found, groups)}
    written = write_texts(out, "benchmark", **texts)
    if found.rows:
        written.append(write_parquet(out / "rows.parquet", make_table(found)))
    return written


def record_benchmark(found: Benchmark, groups: Sequence[Group]) -> dict[str, Any]:
    """Return the suite, the sources with their licences and versions, the groups and the failures, as JSON values."""
    return {
        "schema_version": SCHEMA_VERSION,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": read_versions(),
        "suite": found.suite.model_dump(mode="json"),
        "sources": [
            {
                "label": source.entry.label, "problem": source.problem, "licence": source.licence,
                "libraries": dict(source.libraries), "objects": list(source.objects), "recorded": source.recorded,
            }
            for source in found.sources
        ],
        "groups": [group.describe() for group in groups],
        "failed": [
            {"source": c.source.entry.label, "object": c.object, "method": c.method.label, "error": c.error}
            for c in found.failed
        ],
    }  # fmt: skip


def make_table(found: Benchmark) -> Any:
    """Return all rows as a pandas table, without the listed poses."""
    import pandas as pd

    dropped = ("T_base_object", "true_T_base_object", "scores")
    return pd.DataFrame([{key: value for key, value in row.items() if key not in dropped} for row in found.rows])


def format_summary(found: Benchmark, groups: Sequence[Group]) -> str:
    """Return the tables as Markdown."""
    suite = found.suite
    parts = [
        f"# Benchmark: {suite.name}\n",
        f"{suite.summary}. {suite.examples} examples of each object, seed {suite.seed}. A pose is measured by its "
        "surface distance. Intervals are bootstrap intervals over the examples.\n",
        format_markdown(tabulate(groups)),
    ]
    parts += [f"- The source {one.entry.label!r} was left out: {one.problem}" for one in found.sources if one.problem]
    parts += [f"- {cell.name} failed: {cell.error}" for cell in found.failed]
    return "\n".join(parts).rstrip() + "\n"


def tabulate(groups: Sequence[Group]) -> list[list[str]]:
    """Return a table with a row for each group, sorted by source and number of touches, the header first."""
    order = {source: number for number, source in enumerate(dict.fromkeys(group.source for group in groups))}
    ordered = sorted(groups, key=lambda group: (order[group.source], group.touches))
    return [list(HEAD), *(list(_list_cells(group)) for group in ordered)]


def _list_cells(group: Group) -> Iterator[str]:
    yield from (group.source, str(group.touches), group.method)
    near = WITHIN_M.index(1e-3)
    for number, share in enumerate(group.within):
        low, high = group.within_range[number]
        yield f"{format_share(share)} ({100 * low:.0f} to {100 * high:.0f})" if number == near else format_share(share)
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
