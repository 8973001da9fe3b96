"""The tables of benchmarks, kept in benchmarks/results/VERSION/RUN.json.

A run is a benchmark with its arguments. Its name is the benchmark's name or another name. Runs that are older than
these files were copied from a page, which is their `source`.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Table:
    """A printed table. If the first cell of a row is empty, it stands for the first cell of the row above."""

    columns: list[str]
    rows: list[list[str]]

    def markdown(self, columns: Sequence[str] = ()) -> str:
        """Return all columns, or the named ones, as Markdown, with "50% 75%" as "50 %, 75 %".

        Raises LookupError for an unknown column.
        """
        chosen = [self.find_column(name) for name in columns] or range(len(self.columns))
        lines = [f"| {' | '.join(row[k] for k in chosen)} |" for row in (self.columns, *self.rows)]
        first, *others = [re.sub(r"(?<=\d)%", " %", re.sub(r"% (?=\d)", "%, ", line)) for line in lines]
        return "\n".join([first, "|---" * len(chosen) + "|", *others]) + "\n"

    @cached_property
    def filled(self) -> list[list[str]]:
        """The rows, with empty first cells filled from the row above."""
        firsts = accumulate((row[0] for row in self.rows), lambda above, cell: cell or above)
        return [[first, *row[1:]] for first, row in zip(firsts, self.rows, strict=True)]

    def find_column(self, column: str | int) -> int:
        """Return the index of a column, given by name or index. Raises LookupError for an unknown name."""
        if isinstance(column, str) and column not in self.columns:
            raise LookupError(f"there is no column {column!r} among {self.columns}")
        return self.columns.index(column) if isinstance(column, str) else column

    def numbers(self, column: str | int, *words: str) -> list[float]:
        """Return the numbers of a cell in the first row that begins with `words`.

        Raises LookupError if there is no such row.
        """
        for row in self.filled:
            if row[: len(words)] == list(words):
                return [float(number) for number in NUMBER.findall(row[self.find_column(column)])]
        raise LookupError(f"no row of the table begins with {words}")

    def column(self, column: str | int) -> list[float]:
        """Return the first number of each cell of a column, without cells that have no number.

        Raises LookupError for an unknown column.
        """
        found = [NUMBER.search(row[self.find_column(column)]) for row in self.rows]
        return [float(number[0]) for number in found if number]


@dataclass(frozen=True)
class Kept:
    """The tables of a run, with the machine and the date. `yardstick_ms` is the median time of a fixed piece of work.

    `beside` has the documentation's sentences about this run whose figures are not computed from its tables. If a run
    was copied from a page, its duration and yardstick are unknown.
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
        """The name of the run and of its file."""
        return self.run or self.benchmark

    @property
    def measurement(self) -> str:
        """The version and the date, as text."""
        return f"{self.version} of {self.date}"

    @classmethod
    def read(cls, path: Path) -> Kept:
        """Read a results file."""
        return cls.parse(path.read_text(encoding="utf-8"))

    @classmethod
    def parse(cls, text: str) -> Kept:
        """Read the text of a results file."""
        values = json.loads(text)
        return cls(**{**values, "tables": [Table(**table) for table in values["tables"]]})

    def write(self, folder: Path) -> Path:
        """Write a results file, with a line for each row of a table, and return its path."""
        path = folder / self.version / f"{self.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(asdict(self), indent=1, ensure_ascii=False)
        text = re.sub(r'(\[|,)\n {4,5}(?=")', lambda cell: "[" if cell[1] == "[" else ", ", text)
        path.write_text(re.sub(r'"\n {3,4}\]', '"]', text) + "\n", encoding="utf-8")
        return path

    def table(self, number: int) -> Table:
        """Return a table by its number, from 1. Raises LookupError for an unknown number."""
        if not 1 <= number <= len(self.tables):
            raise LookupError(f"{self.name} has {len(self.tables)} tables, and no number {number}")
        return self.tables[number - 1]


class Results(dict[str, Kept]):
    """The runs by name. The methods raise LookupError for an unknown run, table, column or row."""

    def at(self, run: str, number: int, column: str | int, *words: str) -> list[float]:
        """Return the numbers of a cell in the first row that begins with `words`."""
        return self[run].table(number).numbers(column, *words)

    def column(self, run: str, number: int, column: str | int) -> list[float]:
        """Return the first number of each cell of a column."""
        return self[run].table(number).column(column)


def find_tables(text: str) -> list[Table]:
    """Return the Markdown tables of a benchmark's output. Other lines between rows do not end a table."""
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("|")]
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]
    rules = [k for k, row in enumerate(rows) if k and all(re.fullmatch(r":?-+:?", cell) for cell in row)]
    found = []
    for rule, end in zip(rules, [*(k - 1 for k in rules[1:]), len(rows)], strict=False):
        count = len(rows[rule - 1])
        found.append(Table(rows[rule - 1], [(row + [""] * count)[:count] for row in rows[rule + 1 : end]]))
    return found


def list_versions(folder: Path = RESULTS) -> list[str]:
    """Return the versions with results, the oldest first."""
    return sorted((path.name for path in folder.glob("[0-9]*") if path.is_dir()), key=_order_version)


def _order_version(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)]


def read_latest(folder: Path = RESULTS) -> Results:
    """Return the newest results of each run."""
    paths = {path.stem: path for version in list_versions(folder) for path in sorted((folder / version).glob("*.json"))}
    return Results((name, Kept.read(paths[name])) for name in sorted(paths))


def read_before(now: Kept, folder: Path = RESULTS) -> Kept | None:
    """Return the results of a run before `now`; None if there are none.

    They are those of the newest older version. If only this version has the run, they are the newest committed results
    from another measurement.
    """
    order = _order_version(now.version)
    for version in reversed([one for one in list_versions(folder) if _order_version(one) < order]):
        if (path := folder / version / f"{now.name}.json").exists():
            return Kept.read(path)
    committed = _read_committed(folder / now.version / f"{now.name}.json")
    return next((kept for kept in committed if (kept.date, kept.seconds) != (now.date, now.seconds)), None)


def _read_committed(path: Path) -> Iterator[Kept]:
    """Yield the committed states of a results file, the newest first. States of an older format are left out."""
    for commit in _ask_git(path.parent, "log", "--format=%H", "--", path.name).split():
        with suppress(ValueError, TypeError, KeyError):
            yield Kept.parse(_ask_git(path.parent, "show", f"{commit}:./{path.name}"))


def _ask_git(folder: Path, *words: str) -> str:
    """Return the output of git in a folder; empty if git fails or is not installed."""
    try:
        asked = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return asked.stdout if asked.returncode == 0 else ""
