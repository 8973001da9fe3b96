"""Rows as tables in Markdown, CSV and JSON. A row maps names to JSON values, and a name ends with its unit."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.io.streams.records import read_versions
from tactile_loc.store.files import write_text

Row = dict[str, Any]
Table = list[list[str]]
"""Rows of cells; the first row names the columns."""


def tabulate(rows: Iterable[Mapping[str, str]]) -> Table:
    """Return the table of at least one row; a row maps headings, which are the same for all rows, to cells."""
    found = list(rows)
    return [list(found[0]), *(list(row.values()) for row in found)]


def pivot(rows: Iterable[Row], names: Sequence[str], column: str, cell: Callable[[Any], str]) -> Table:
    """Return a table with a row for each combination of the values `names`, and a column for each value of `column`."""
    heads: dict[str, None] = {}
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        heads[row[column]] = None
        found.setdefault(tuple(row[name] for name in names), {})[row[column]] = cell(row)
    return [
        [*names, *map(str, heads)],
        *([*key, *(cells.get(head, "") for head in heads)] for key, cells in found.items()),
    ]


def format_length(length_m: float | None) -> str:
    """Return a length, metres, in millimetres; "-" if it is None."""
    return "-" if length_m is None else format_mm(length_m)


def format_share(share: float | None) -> str:
    """Return a share, 0 to 1, as a whole percentage; "-" without a share."""
    return "-" if share is None else f"{100 * share:.0f} %"


def format_markdown(table: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    header, *rows = table
    lines = ([cell.replace("|", "\\|") for cell in line] for line in (header, ["---"] * len(header), *rows))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def format_document(heading: str, parts: Iterable[str | Sequence[Sequence[str]]]) -> str:
    """Return a heading, paragraphs and tables as Markdown."""
    texts = (f"{part}\n" if isinstance(part, str) else format_markdown(part) for part in parts)
    return "\n".join([f"# {heading}\n", *texts])


def format_csv(rows: Sequence[Row]) -> str:
    """Return rows as CSV with the names of the first row; a missing value is empty, and a truth is true or false."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows[0])
    writer.writerows([format_value(row[name]) for name in rows[0]] for row in rows)
    return text.getvalue()


def show_in_mm(row: Row) -> Row:
    """Return the single values of a row with six digits, and lengths in mm instead of metres."""
    found = {}
    for name, value in row.items():
        if isinstance(value, float) and name.endswith("_m"):
            found[f"{name}m"] = f"{1e3 * value:.6g}"
        elif not isinstance(value, dict | list | tuple):
            found[f"{name}m" if name.endswith("_m") else name] = f"{value:.6g}" if isinstance(value, float) else value
    return found


class NotedTable(NamedTuple):
    """A table with a `title` for the terminal and a `note` for a document; where one is empty, it is not shown."""

    title: str
    note: str
    table: Table


@dataclass(frozen=True, eq=False)
class EvaluationResults:
    """What an evaluation writes and shows: a JSON `document`, the `rows` of the CSV, and tables with their notes.

    `details` are further parts of the Markdown document.
    """

    name: str
    heading: str
    document: dict[str, Any]
    rows: Sequence[Row]
    tables: Sequence[NotedTable]
    details: Sequence[str | Table] = ()

    def format_markdown(self) -> str:
        """Return the tables with a note, and the details, as Markdown."""
        noted = [part for one in self.tables if one.note for part in (one.note, one.table)]
        return format_document(self.heading, [*noted, *self.details])

    def write(self, folder: Path) -> list[Path]:
        """Write NAME.json, NAME.csv, with lengths in mm, and NAME.md; return their paths. Raises OutputError."""
        csv = format_csv([show_in_mm(row) for row in self.rows])
        return write_texts(folder, self.name, self.document, csv=csv, md=self.format_markdown())


def build_document(schema_version: int, **values: Any) -> dict[str, Any]:
    """Return a JSON document of `values`, with the current time and the library versions."""
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return {"schema_version": schema_version, "created": created, "versions": read_versions(), **values}


def write_texts(folder: Path, name: str, document: Mapping[str, Any], **texts: str) -> list[Path]:
    """Write the file `name`.json and each text as `name`.KEYWORD in `folder`; return the paths. Raises OutputError."""
    every = {"json": f"{json.dumps(document, indent=1)}\n", **texts}
    return [write_text(folder / f"{name}.{suffix}", text) for suffix, text in every.items()]


def format_value(value: Any) -> Any:
    """Return a value for a cell of a CSV file: a number, a text, None, or JSON."""
    if value is None or (isinstance(value, str | int | float) and not isinstance(value, bool)):
        return value
    return json.dumps(value)
