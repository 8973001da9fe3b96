"""The table of a sweep: one row a combination, in the plan's order, as a DataFrame, CSV and Parquet."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.errors import MissingLibraryError, OutputError
from tactile_loc.core.slots.registry import SLOTS
from tactile_loc.store.files import write_atomically
from tactile_loc.sweeps.combination import Combination
from tactile_loc.sweeps.plan import Plan, varied_options
from tactile_loc.sweeps.workers import COVERAGES, ERRORS, TIMES, Outcome

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
MEASURED = (*ERRORS, *COVERAGES, "nll_nats", *TIMES, "model_s")
WHOLE = ("seed", "count", "grid_poses")
TEXTS = ("object", *SLOTS, "noise", "error", "key", "built")


def columns_of(plan: Plan) -> list[str]:
    """Return the names of a plan's columns, in their order."""
    results = ("grid_poses", *ERRORS, *COVERAGES, "nll_nats", "error", "key", *MOMENTARY)
    return [*IDENTITY, *varied_columns(plan), *results]


def varied_columns(plan: Plan) -> list[str]:
    """Return "slot.option" for each option that tells choices of one component apart."""
    return [f"{slot}.{option}" for slot, choices in plan.slots.items() for option in varied_options(choices)]


def rows_of(plan: Plan, combinations: Iterable[Combination], outcomes: Mapping[str, Outcome]) -> list[Row]:
    """Return a row of all columns for each combination, as JSON values; None where there is no value."""
    columns, varied = columns_of(plan), varied_columns(plan)
    rows = []
    for one in combinations:
        outcome = outcomes[one.key]
        known = {**_identity(one, varied), **(outcome.measured or {}), "error": outcome.error, "key": one.key}
        known["built"] = json.dumps(list(outcome.built))
        rows.append({column: known.get(column) for column in columns})
    return rows


def _identity(one: Combination, varied: Sequence[str]) -> Row:
    config = one.config
    slots = {slot: getattr(config, slot) for slot in SLOTS}
    parted = [(column, *column.split(".", 1)) for column in varied]
    return {
        "object": one.object, **{slot: chosen.name for slot, chosen in slots.items()},
        "noise": config.touch.noise, "seed": config.seed, "count": one.count,
        **{column: slots[slot].options.get(option) for column, slot, option in parted},
    }  # fmt: skip


def table_of(rows: Sequence[Row]) -> pd.DataFrame:
    """Return rows as a table whose columns have the types that they always have, even when nothing succeeded.

    A column of an option has the type of its values; lists and mixtures are written as JSON.
    """
    import pandas as pd

    return pd.DataFrame({name: _column([row[name] for row in rows], name) for name in rows[0]})


def _column(values: Sequence[Any], name: str) -> pd.Series:
    import pandas as pd

    if name in TEXTS:
        return pd.Series(values, dtype=object)
    if name in WHOLE:
        return pd.Series(values, dtype="Int64")
    kind = "floating" if name in MEASURED else pd.api.types.infer_dtype(values, skipna=True)
    known = {"boolean": "boolean", "integer": "Int64", "floating": float, "mixed-integer-float": float}
    if kind in known:
        return pd.Series(values, dtype=known[kind])
    texts = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
    return pd.Series(texts, dtype=object)


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as CSV; what has no value is empty, truth is written as in JSON."""
    truths = table.select_dtypes("boolean").columns
    written = table.assign(**{name: table[name].map({True: "true", False: "false"}) for name in truths})
    return str(written.to_csv(index=False, lineterminator="\n"))


def write_parquet(path: Path, table: pd.DataFrame) -> Path:
    """Write a table as Parquet, atomically, and return the path. Raises OutputError."""
    from pyarrow import ArrowException

    try:
        return write_atomically(path, lambda temporary: table.to_parquet(temporary, engine="pyarrow", index=False))
    except ArrowException as error:
        raise OutputError(f"{path} cannot be written ({error})") from error


def require_tables() -> None:
    """Raise MissingLibraryError when there is nothing to write tables with."""
    try:
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            f"a sweep writes its tables with pandas and pyarrow, and {error.name} is not installed: "
            "pip install 'tactile-loc[sweep]'"
        ) from error
