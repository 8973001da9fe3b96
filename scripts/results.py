"""Results of benchmarks: the tables that were printed, in benchmarks/results/VERSION/RUN.json.

A run is a benchmark with its arguments; it is named after the benchmark, or otherwise where there are several of one.
Runs that were measured before there were such files were taken from the page that had their tables: their `source`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Table:
    """A printed table: the names of its columns, and its rows; an empty first cell is that of the row above."""

    columns: list[str]
    rows: list[list[str]]

    def markdown(self, columns: Sequence[str] = ()) -> str:
        """Return it as Markdown, of all columns or those named. Raises LookupError for a column that is not there."""
        chosen = [self.place(name) for name in columns] or range(len(self.columns))
        rows = [[row[k] for k in chosen] for row in (self.columns, *self.rows)]
        rule = "|---" * len(rows[0]) + "|"
        first, *others = [f"| {' | '.join(row)} |" for row in rows]
        return "\n".join([first, rule, *others]) + "\n"

    @cached_property
    def filled(self) -> list[list[str]]:
        """The rows, none without a first cell."""
        rows: list[list[str]] = []
        for row in self.rows:
            rows.append([row[0] or (rows[-1][0] if rows else ""), *row[1:]])
        return rows

    def place(self, column: str | int) -> int:
        """The place of a column that is named, or numbered from 0. Raises LookupError where it is not there."""
        if isinstance(column, str) and column not in self.columns:
            raise LookupError(f"there is no column {column!r} among {self.columns}")
        return self.columns.index(column) if isinstance(column, str) else column

    def numbers(self, column: str | int, *words: str) -> list[float]:
        """The numbers of the cell in the first row whose cells begin with `words`. Raises LookupError without one."""
        for row in self.filled:
            if row[: len(words)] == list(words):
                return [float(number) for number in NUMBER.findall(row[self.place(column)])]
        raise LookupError(f"no row of the table begins with {words}")

    def column(self, column: str | int) -> list[float]:
        """The first number of every cell of a column that has one. Raises LookupError where it is not there."""
        found = [NUMBER.search(row[self.place(column)]) for row in self.rows]
        return [float(number[0]) for number in found if number]


@dataclass(frozen=True)
class Kept:
    """What a benchmark printed, where and when; `yardstick_ms` is the median time of the fixed piece of work.

    `beside` holds the sentences of the documentation that tell of this measurement what its tables do not. Of what was
    taken from a page, `source`, the time that it took and the yardstick are not known.
    """

    benchmark: str
    arguments: list[str]
    version: str
    date: str
    seconds: float | None
    yardstick_ms: float | None
    machine: dict[str, Any]
    packages: dict[str, str]
    tables: list[Table]
    run: str = ""
    source: str = ""
    beside: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """What the run is called, and its file."""
        return self.run or self.benchmark

    @classmethod
    def read(cls, path: Path) -> Kept:
        """Read one that was kept."""
        values = json.loads(path.read_text(encoding="utf-8"))
        return cls(**{**values, "tables": [Table(**table) for table in values["tables"]]})

    def write(self, folder: Path) -> Path:
        """Write it into the folder of its version; return the file."""
        path = folder / self.version / f"{self.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_text(asdict(self)), encoding="utf-8")
        return path

    def table(self, number: int) -> Table:
        """Return the table of a number, from 1. Raises LookupError where there are fewer."""
        if not 1 <= number <= len(self.tables):
            raise LookupError(f"{self.name} has {len(self.tables)} tables, and no number {number}")
        return self.tables[number - 1]


def _text(values: dict[str, Any]) -> str:
    """JSON with a line for each row of a table, so that what changed is seen."""
    rows: list[str] = []

    def placed(row: list[str]) -> str:
        rows.append(json.dumps(row, ensure_ascii=False))
        return f"row {len(rows) - 1}"

    tables = [{"columns": placed(t["columns"]), "rows": [placed(row) for row in t["rows"]]} for t in values["tables"]]
    text = json.dumps({**values, "tables": tables}, indent=1, ensure_ascii=False)
    return re.sub(r'"row (\d+)"', lambda match: rows[int(match[1])], text) + "\n"


def tables(text: str) -> list[Table]:
    """Return the Markdown tables of what a benchmark printed, each row with as many cells as its heading.

    Other lines between rows, of what is noteworthy about one, do not end a table.
    """
    found: list[Table] = []
    before: list[str] = []
    is_row = False
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip()[1:-1].split("|")] if line.strip().startswith("|") else []
        is_rule = bool(cells) and all(re.fullmatch(r":?-+:?", cell) for cell in cells)
        if is_rule and before:
            if is_row:  # it was the next table's heading
                found[-1].rows.pop()
            found.append(Table(before, []))
        is_row = bool(cells and found and not is_rule)
        if is_row:
            count = len(found[-1].columns)
            found[-1].rows.append((cells + [""] * count)[:count])
        before = cells
    return found


def versions(folder: Path = RESULTS) -> list[str]:
    """Return the versions that have results, the oldest first."""
    found = [path.name for path in folder.glob("*") if path.is_dir()]
    return sorted(found, key=lambda name: [int(part) for part in re.findall(r"\d+", name)])


def latest(folder: Path = RESULTS) -> dict[str, Kept]:
    """Return every run by its name, as the newest version that has it kept it."""
    paths = {path.stem: path for version in versions(folder) for path in sorted((folder / version).glob("*.json"))}
    return {name: Kept.read(paths[name]) for name in sorted(paths)}
