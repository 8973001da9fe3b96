"""Reads tables from CSV files: a heading with the names of the columns, and rows of texts and numbers."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import TactileLocError, quote

Row = Mapping[str, str]


def read_table(path: Path, what: str, error: type[TactileLocError]) -> tuple[Sequence[Row], Sequence[str]]:
    """Return the rows of a CSV file in UTF-8, and the names of its columns. A missing cell is an empty text.

    `what` names the content of one row, such as "sensor pose". Raises `error` if the file cannot be read or has no row.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            rows = [_clean(row) for row in reader]
            columns = [name.strip() for name in reader.fieldnames or ()]
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"{path} cannot be read as a table ({reason}); give a CSV file in UTF-8") from problem
    if not rows:
        raise error(f"{path} holds no {what}; give a heading with the names of the columns, and a row for each {what}")
    return rows, columns


def _clean(row: Mapping[str | None, Any]) -> Row:
    """Return the cells below named columns, without spaces."""
    return {name.strip(): (cell or "").strip() for name, cell in row.items() if name is not None}


def read_number(row: Row, name: str, error: type[TactileLocError]) -> float:
    """Return the number in a column of a row. Raises `error` if it is missing or not finite."""
    try:
        value = float(row[name])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise error(f"{name} is {quote(row[name])}; give a number")
    return value
