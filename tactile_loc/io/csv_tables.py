"""Reads tables from CSV files: a heading with the names of the columns, and rows of texts and numbers."""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tactile_loc.core.runtime.errors import TactileLocError, did_you_mean, quote
from tactile_loc.store.files import read_text

Row = Mapping[str, str]

SEPARATORS = ",;\t"
_NOTES = r"(?:[^\S\n]*(?:#.*)?\n)*"  # empty lines and comments
_PREAMBLE = re.compile(rf"{_NOTES}(?:sep=(.)\n{_NOTES})?", re.IGNORECASE)  # spreadsheets name the separator
_NUMBER = re.compile(r"[+-]?\d*([.,])\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Table:
    """The `rows` of a CSV file, the names of its `columns`, and the `lines` of the file in which the rows end."""

    rows: Sequence[Row]
    columns: Sequence[str]
    lines: Sequence[int]


def read_table(path: Path, what: str, error: type[TactileLocError]) -> Table:
    """Read a table from a CSV file. A missing cell is an empty text, and empty rows are left out.

    Lines above the heading that begin with # are comments, and so are rows of one cell that begins with #.
    Cells are separated by commas, or, as in the heading, by semicolons or tabs. Then the decimal sign may be a comma.
    `what` names the content of one row, such as "sensor pose". Raises `error` if the file cannot be read or has no row.
    """
    try:
        text = read_text(path)
        preamble = _PREAMBLE.match(text)
        assert preamble is not None  # it may be empty
        text = text[preamble.end() :]
        separator = preamble[1] or max(SEPARATORS, key=text.partition("\n")[0].count)
        reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
        above = preamble[0].count("\n")
        read = [(above + reader.line_num, [cell.strip() for cell in line]) for line in reader if not _is_empty(line)]
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"{path} cannot be read as a table ({reason}); give a CSV file in UTF-8") from problem
    if len(read) < 2:
        raise error(f"{path} holds no {what}; give a heading with the names of the columns, and a row for each {what}")
    heading, cells = read[0][1], [line for _, line in read[1:]]
    twice = next((name for name in heading if name and heading.count(name) > 1), None)
    if twice is not None:
        raise error(f"{path} has more than one column {twice!r}; keep one of them")
    for number, line in enumerate(cells, start=1):
        if any(line[len(heading) :]):
            raise error(
                f"row {number} of {path} has {len(line)} cells, but the heading has {len(heading)}; separate the cells "
                "by semicolons if the decimal sign is a comma"
            )
    if separator != ",":
        cells = _replace_decimal_commas(cells, path, error)
    rows = [dict(zip(heading, line + [""] * len(heading), strict=False)) for line in cells]
    return Table(rows, heading, [number for number, _ in read[1:]])


def _is_empty(line: Sequence[str]) -> bool:
    """Return whether a row has only empty cells, or is a comment without separators."""
    return not any(cell.strip() for cell in line) or (len(line) == 1 and line[0].startswith("#"))


def _replace_decimal_commas(rows: Sequence[Sequence[str]], path: Path, error: type[TactileLocError]) -> list[list[str]]:
    """Return rows whose numbers have decimal points. Raises `error` if some have commas, and some have points."""
    signs = {found[1] for row in rows for cell in row if (found := _NUMBER.fullmatch(cell))}
    if len(signs) > 1:
        raise error(f"some numbers of {path} have a decimal comma, and some a decimal point; write all in one way")
    return [[cell.replace(",", ".") if _NUMBER.fullmatch(cell) else cell for cell in row] for row in rows]


def require_columns(
    path: Path, columns: Sequence[str], needed: Iterable[str], error: type[TactileLocError], advice: str = ""
) -> None:
    """Raise `error`, which names the first missing column, unless a table has all `needed` columns."""
    missing = next((name for name in needed if name not in columns), None)
    if missing is not None:
        near = did_you_mean(missing, columns)
        raise error(f"{path} has no column {missing!r}.{near} Its columns are {', '.join(columns)}{advice}")


def read_number(row: Row, name: str, error: type[TactileLocError]) -> float:
    """Return the number in a column of a row. Raises `error` if it is missing or not finite."""
    try:
        value = float(row[name])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise error(f"{name} is {quote(row[name])}; give a number")
    return value
