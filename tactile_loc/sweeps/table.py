"""The table of a sweep: one row a combination, in the plan's order, as CSV and Parquet."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.errors import MissingLibraryError, OutputError
from tactile_loc.core.registry import SLOTS
from tactile_loc.evaluation.tabular import csv_table
from tactile_loc.store.files import write_atomically
from tactile_loc.sweeps.choices import varied_options
from tactile_loc.sweeps.combinations import Combination
from tactile_loc.sweeps.measures import ERRORS, TIMES, TRUST
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.work import Outcome

if TYPE_CHECKING:
    import pyarrow

Row = dict[str, Any]

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
WHOLE = ("seed", "count", "grid_poses")
TEXTS = ("object", *SLOTS, "noise", "error", "key", "built")


def columns_of(plan: Plan) -> list[str]:
    """Return the names of a plan's columns, in their order."""
    return [*IDENTITY, *varied_columns(plan), "grid_poses", *ERRORS, *TRUST, "error", "key", *MOMENTARY]


def varied_columns(plan: Plan) -> list[str]:
    """Return "slot.option" for each option that tells choices of one component apart."""
    return [f"{slot}.{option}" for slot, choices in plan.slots.items() for option in varied_options(choices)]


def rows_of(plan: Plan, combinations: Iterable[Combination], outcomes: Mapping[str, Outcome]) -> list[Row]:
    """Return a row of all columns for each combination; None where there is no value."""
    columns, varied = columns_of(plan), varied_columns(plan)
    rows = []
    for one in combinations:
        outcome = outcomes[one.key]
        known = {**_identity(one, varied), **(outcome.measured or {}), "error": outcome.error, "key": one.key}
        known["built"] = json.dumps(list(outcome.built))
        rows.append({column: known.get(column) for column in columns})
    return rows


def csv_text(rows: Sequence[Row]) -> str:
    """Return rows as CSV; what has no value is empty."""
    return csv_table([{name: _cell(value) for name, value in row.items()} for row in rows])


def read_csv(path: Path) -> list[Row]:
    """Read rows that `csv_text` wrote, with their types; an empty cell of any column but `error` is None."""
    with path.open(encoding="utf-8", newline="") as file:
        return [{name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)]


def parquet_table(rows: Sequence[Row]) -> pyarrow.Table:
    """Return rows as a table with the types that their columns always have, even when empty."""
    import pyarrow

    kinds = {name: _kind(name, rows) for name in rows[0]}
    columns = {name: [_typed(row[name], kind) for row in rows] for name, kind in kinds.items()}
    return pyarrow.table(columns, schema=pyarrow.schema(kinds.items()))


def write_parquet(path: Path, rows: Sequence[Row]) -> Path:
    """Write rows as Parquet, atomically, and return the path. Raises OutputError."""
    from pyarrow import ArrowException, parquet

    try:
        return write_atomically(path, lambda temporary: parquet.write_table(parquet_table(rows), temporary))
    except ArrowException as error:
        raise OutputError(f"{path} cannot be written ({error})") from error


def require_parquet() -> None:
    """Raise MissingLibraryError when there is nothing to write Parquet with."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            "a sweep writes Parquet with pyarrow, which is not installed: pip install 'tactile-loc[sweep]'"
        ) from error


def _identity(one: Combination, varied: Sequence[str]) -> Row:
    config = one.config
    slots = {slot: getattr(config, slot) for slot in SLOTS}
    options = {}
    for column in varied:
        slot, _, option = column.partition(".")
        options[column] = slots[slot].options.get(option)
    named = {slot: chosen.name for slot, chosen in slots.items()}
    return {
        "object": one.object,
        **named,
        "noise": config.touch.noise,
        "seed": config.seed,
        "count": one.count,
        **options,
    }


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return json.dumps(value) if isinstance(value, bool | list | dict) else value


def _value(name: str, text: str) -> Any:
    if name in TEXTS:
        return text
    if text == "":
        return None
    if name in WHOLE:
        return int(text)
    if "." not in name:
        return float(text)
    try:
        return json.loads(text)  # an option: a number, true or false, or a list
    except ValueError:
        return text


def _kind(name: str, rows: Sequence[Row]) -> Any:
    """The Parquet type of a column: an option's is that of its values."""
    import pyarrow

    if name in TEXTS:
        return pyarrow.string()
    if name in WHOLE:
        return pyarrow.int64()
    found = {type(row[name]) for row in rows} - {type(None)}
    if "." in name and found == {bool}:
        return pyarrow.bool_()
    if "." in name and found == {int}:
        return pyarrow.int64()
    return pyarrow.float64() if found <= {int, float} else pyarrow.string()


def _typed(value: Any, kind: Any) -> Any:
    import pyarrow

    if value is None or kind != pyarrow.string() or isinstance(value, str):
        return value
    return json.dumps(value)
