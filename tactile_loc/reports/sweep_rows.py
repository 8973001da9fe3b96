"""The rows of a sweep, one a combination: what each is made of, and what came of it."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from typing import Any

from tactile_loc.core.registry import SLOTS
from tactile_loc.reports.source import ResultError, Source

FACTORS = ("object", *SLOTS, "noise", "seed", "count")  # and every "slot.option": what a combination is made of
MEDIAN = "_median_mm"
LINES = ("chosen", "reg-1", "best-1", "reg-10", "best-10", "best-50", "closest")  # in the order of what is asked for
NOT_COMPONENTS = ("object", "noise", "seed", "count")

Row = dict[str, Any]


def read_rows(source: Source) -> list[Row]:
    """Read sweep.csv: texts of FACTORS and of options, numbers of all else; None where there is nothing.

    Raises ResultError when it is missing, empty, or has no row of its own.
    """
    path = source.path.with_suffix(".csv")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [{str(k): _value(str(k), v) for k, v in row.items()} for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ResultError(f"{path} cannot be read ({reason}); run the sweep again") from error
    if not rows:
        raise ResultError(f"{path} holds no combination; run the sweep again")
    return rows


def is_factor(column: str) -> bool:
    """Whether a column says what a combination is made of, rather than what came of it."""
    return column in FACTORS or (column.partition(".")[0] in SLOTS and "." in column)


def varying(rows: Sequence[Row]) -> list[str]:
    """Return the factors that do not have the same value in all rows."""
    return [column for column in rows[0] if is_factor(column) and len({row[column] for row in rows}) > 1]


def components(rows: Sequence[Row]) -> list[str]:
    """Return the factors that vary and are of the method's making: components and their options."""
    return [factor for factor in varying(rows) if factor not in NOT_COMPONENTS]


def measured_lines(rows: Sequence[Row]) -> list[str]:
    """Return the lines whose median error is known of any row."""
    columns = [c.removesuffix(MEDIAN) for c in rows[0] if c.endswith(MEDIAN)]
    known = [line for line in columns if any(isinstance(row[line + MEDIAN], float) for row in rows)]
    return sorted(known, key=lambda line: LINES.index(line) if line in LINES else len(LINES))


def _value(column: str, text: str | None) -> Any:
    if text is None or text == "":
        return None
    if is_factor(column):
        return text
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else None
