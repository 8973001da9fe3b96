"""The files of a benchmark: benchmark.json and .md, leaderboard.json, rows.parquet, pictures, and the files of BOP."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet
from tactile_loc import format_markdown, write_texts
from tactile_loc.commands import write_atomically
from tactile_loc.plugin import ConfigError

from tactile_loc_benchmark.bop_files import write_bop
from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.leaderboard import read_document, record_leaderboard
from tactile_loc_benchmark.results import Results, UsedMethod, UsedSource
from tactile_loc_benchmark.suite import Suite, SuiteEntry
from tactile_loc_benchmark.summary import WITHIN_M

HEAD = (
    *("source", "touches", "method"),
    *("within 0.5 mm", "1 mm (95 % interval)", "2 mm", "5 mm", "any listed, 1 mm", "median, mm"),
    *("determined: within 1 mm", "median, mm", "AUC", "AR MSSD", "shape, 1 mm", "calibration error", "covered, 95 %"),
    *("certain: right", "time"),
)
TABLE_NOTE = (
    "A pose is measured by its pose error, MSSD: the largest displacement of a surface point. The first shares are of "
    "examples whose first pose is near enough. Examples without a pose count as missed. Intervals are bootstrap "
    "intervals over the examples. Determined: examples in which no method lists a wrong pose that explains the touches "
    "as well as the true pose. AUC: mean share within 0.1, 0.2, ... 5 mm. AR MSSD: mean share within 5, 10, ... 50 % "
    "of the diameter, as in BOP. Shape: share of first poses with a shape distance of at most 1 mm: the mean distance "
    "of the surfaces. Certain: examples that the method calls certain."
)
NAME, ROWS = "benchmark", "rows.parquet"
MOST_BYTES = 2**28  # of a table in memory
POSES = ("T_base_object", "true_T_base_object", "scores")  # values of a row that are not in the table of rows


def write_benchmark(out: Path, results: Results, pictures: Sequence[Mapping[str, Any]] = ()) -> list[Path]:
    """Write all results into the folder `out`, and return the paths. Raises OutputError.

    `pictures` shows a touch of each source: see `page.show_sources`.
    """
    document = {**record_benchmark(results), "pictures": list(pictures)}
    written = write_texts(out, NAME, document, md=format_summary(results))
    if results.rows:
        written += write_texts(out, "leaderboard", record_leaderboard(results))
        written.append(write_rows(out / ROWS, list_rows(results)))
        written.append(write_bop(out, results.rows))
    return written


def record_benchmark(results: Results) -> dict[str, Any]:
    """Return the leaderboard's document with the suite's objects, its components, and the failures, as JSON values."""
    return {
        **record_leaderboard(results),
        "plan": results.suite.model_dump(mode="json"),
        "left_out": results.left_out,
        "failed": list(results.failed),
    }


def read_benchmark(folder: Path) -> tuple[Results, list[Mapping[str, Any]]]:
    """Return the results, with rows without poses, and the pictures that `write_benchmark` wrote into a folder.

    Raises TactileLocError if a file is missing or damaged, or if there are no rows.
    """
    path = folder / f"{NAME}.json"
    document = read_document(path)
    rows = read_rows(folder / ROWS)
    try:
        suite = Suite.model_validate(document["plan"])
        sources = [UsedSource(**_read_used(document, "sources", one)) for one in suite.source]
        methods = [UsedMethod(**_read_used(document, "methods", one)) for one in suite.method]
        about = document["versions"], document["created"]
        return Results(suite, sources, methods, rows, document["failed"], *about), document["pictures"]
    except (LookupError, TypeError, ValueError) as error:
        raise ConfigError(f"{path} is damaged or incomplete ({error!r}); run the benchmark again") from error


def write_rows(path: Path, rows: Sequence[Row]) -> Path:
    """Write rows as Parquet, atomically, and return the path. A value that a row lacks is missing.

    A column has numbers, truths or texts; values of several types become texts. Raises OutputError.
    """
    names = dict.fromkeys(name for row in rows for name in row)
    table = pyarrow.table({name: _unify([row.get(name) for row in rows]) for name in names})
    return write_atomically(path, lambda temporary: parquet.write_table(table, temporary))


def _unify(values: Sequence[Any]) -> Any:
    """Return the values of a column of one type, with None for missing ones."""
    values = [value.item() if isinstance(value, np.generic) else value for value in values]
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {float, int} and kinds != {int}:
        return pyarrow.array(values, pyarrow.float64())
    if kinds <= {bool} or kinds <= {int} or kinds <= {str}:
        return pyarrow.array(values)
    texts = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
    return pyarrow.array(texts, pyarrow.string())


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a file of `write_rows`, without missing values.

    Raises ConfigError if the file cannot be read, or takes too much memory.
    """
    try:
        about = parquet.read_metadata(path)
        packed = sum(about.row_group(n).total_byte_size for n in range(about.num_row_groups))
        if max(packed, 8 * about.num_rows * about.num_columns) > MOST_BYTES:
            raise ValueError(f"it takes more than {MOST_BYTES / 2**20:.0f} MiB of memory")
        columns = map(about.schema.column, range(about.num_columns))
        # a long text may stand in many rows, so texts are read as dictionaries
        texts = [column.path for column in columns if column.physical_type == "BYTE_ARRAY"]
        table = parquet.read_table(path, read_dictionary=texts)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read ({error}); run the benchmark again") from error
    rows = (zip(table.column_names, row, strict=True) for row in zip(*map(_list_values, table.columns), strict=True))
    return [{name: value for name, value in row if value is not None and value == value} for row in rows]


def _list_values(column: Any) -> list[Any]:
    """Return the values of a column (pyarrow). Equal texts are one object, and take memory once."""
    values: list[Any] = []
    for chunk in column.chunks:
        if hasattr(chunk, "dictionary"):
            texts = chunk.dictionary.to_pylist()
            values += [None if k is None else texts[k] for k in chunk.indices.to_pylist()]
        else:
            values += chunk.to_pylist()
    return values


def _read_used(document: Mapping[str, Any], kind: str, entry: SuiteEntry) -> dict[str, Any]:
    """Return what the document states about an entry of the suite; only its name, if it was left out."""
    described = document[kind].get(entry.label, {"name": entry.name})
    return {"label": entry.label, **described, "problem": document["left_out"].get(entry.label, "")}


def list_rows(results: Results) -> list[Row]:
    """Return all rows, without the listed poses."""
    return [{key: value for key, value in row.items() if key not in POSES} for row in results.rows]


def describe_suite(results: Results) -> str:
    """Return a sentence about the suite."""
    suite = results.suite
    summary = f"{suite.summary}. " if suite.summary else ""
    return f"{summary}{suite.examples} examples of each object, seed {suite.seed}."


def format_summary(results: Results) -> str:
    """Return the tables as Markdown."""
    parts = [f"# Benchmark: {results.suite.name}\n", f"{describe_suite(results)} {TABLE_NOTE}\n"]
    if results.rows:
        parts.append(format_markdown(tabulate(results.groups)))
    parts += ["## Sources\n", format_markdown(tabulate_sources(results))]
    parts += ["## Methods\n", format_markdown(tabulate_methods(results))]
    if results.failed:
        parts += ["## Failures\n", format_markdown(tabulate_failures(results))]
    return "\n".join(parts)


def tabulate_sources(results: Results) -> list[list[str]]:
    """Return a row for each source: its licence, versions and number of objects, or why it was left out."""
    rows = [["source", "licence", "versions", "objects", "left out"]]
    for one in results.sources:
        objects = str(len(one.objects) or "-")
        rows.append([one.label, one.licence or "-", _join_versions(one.libraries), objects, one.problem])
    return rows


def tabulate_methods(results: Results) -> list[list[str]]:
    """Return a row for each method: the paper that it follows and its versions, or why it was left out."""
    rows = [["method", "follows", "versions", "left out"]]
    for one in results.methods:
        rows.append([one.label, one.paper or "-", _join_versions(one.libraries), one.problem])
    return rows


def tabulate_failures(results: Results) -> list[list[str]]:
    """Return a row for each job that ended with an error."""
    header = ["source", "object", "method", "error"]
    return [header, *([failed[name] for name in header] for failed in results.failed)]


def _join_versions(libraries: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in libraries.items()) or "-"


def format_share(share: float | None) -> str:
    """Return a share, 0 to 1, in %; "-" without a share."""
    return "-" if share is None else f"{100 * share:.0f} %"


def format_length(length_m: float | None) -> str:
    """Return a length, metres, in mm with three digits; "-" without a length."""
    if length_m is None:
        return "-"
    value_mm = 1e3 * length_m
    return f"{value_mm:.3f}" if value_mm < 1 else f"{value_mm:.2f}" if value_mm < 10 else f"{value_mm:.1f}"


def format_within(group: Row, number: int) -> str:
    """Return the share within WITHIN_M[number] with its interval, in %."""
    low, high = group["within_range"][number]
    return f"{format_share(group['within'][number])} ({100 * low:.0f} to {100 * high:.0f})"


def tabulate(groups: Sequence[Row]) -> list[list[str]]:
    """Return a table with a row for each group, sorted by source and number of touches, the header first."""
    order = {source: number for number, source in enumerate(dict.fromkeys(group["source"] for group in groups))}
    ordered = sorted(groups, key=lambda group: (order[group["source"]], group["touches"]))
    return [list(HEAD), *(list(list_cells(group)) for group in ordered)]


def list_cells(group: Row) -> Iterator[str]:
    """Yield the cells of a group under HEAD."""
    yield from (group["source"], str(group["touches"]), group["method"])
    near = WITHIN_M.index(1e-3)
    for number, share in enumerate(group["within"]):
        yield format_within(group, number) if number == near else format_share(share)
    yield format_share(group["listed_within"][near])
    yield format_length(group["median_m"])
    yield f"{format_share(group['determined_within_1_mm'])} of {group['determined']}"
    yield format_length(group["median_determined_m"])
    yield f"{group['auc']:.2f}"
    yield f"{group['average_recall_mssd']:.2f}"
    yield format_share(group["shape_within_1_mm"])
    yield "-" if group["calibration_error"] is None else f"{group['calibration_error']:.2f}"
    yield format_share(group["covered"])
    yield f"{group['certain_right']} of {group['certain']}" if group["certain"] else "-"
    yield "-" if group["median_s"] is None else f"{1e3 * group['median_s']:.0f} ms"
