"""A sweep: it evaluates the missing combinations, keeps every finished row, and makes the table of all rows."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.runtime.errors import MissingLibraryError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.evaluation.jobs import JobOutcome, QueuedJob, Workers, resume_jobs
from tactile_loc.evaluation.sweep.combination import (
    COVERAGES,
    ERRORS,
    TIMES,
    Combination,
    CombinationJob,
    combine,
    order_for_running,
)
from tactile_loc.evaluation.sweep.plan import Plan, find_varied_options, find_varying_slots, name_choices
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import require_writable

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
MEASURED = (*ERRORS, *COVERAGES, "nll_nats", *TIMES, "model_s")
WHOLE = ("seed", "count", "grid_poses")
TEXTS = ("object", *SLOTS, "noise", "error", "key", "built")
NAMED = ("encoder", "refiner")  # the slots that labels name if no slot varies


@dataclass(frozen=True, eq=False)
class Sweep:
    """A plan's combinations and their outcomes.

    `done` is the number of combinations that this call evaluated; the others were evaluated before.
    """

    plan: Plan
    combinations: Sequence[Combination]
    outcomes: Mapping[str, JobOutcome]
    done: int

    @cached_property
    def rows(self) -> list[Row]:
        """A row of JSON values for each combination."""
        return make_rows(self.plan, self.combinations, self.outcomes)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The rows as a table."""
        return make_table(self.rows)

    def compute_medians(self, line: str) -> pd.DataFrame:
        """Return a row for each object, noise and choice of components, in the plan's order, as means over seeds.

        `error_mm` is the median error of `line`, and `time_ms` the median time for a touch. Both are NaN if a
        combination failed. A slot's column has the index of the choice. `label` names the choices of slots that vary.
        """
        labels, named = name_choices(self.plan), find_varying_slots(self.plan) or NAMED
        known = {"error_mm": self.table[f"{line}_median_mm"], "time_ms": self.table["total_ms"]}
        found = self.table[["object", "noise"]].assign(**known)
        for position, slot in enumerate(SLOTS, start=1):
            found[slot] = [one.place[position] for one in self.combinations]
        names = [found[slot].map(labels[slot].__getitem__) for slot in SLOTS if slot in named]
        found["label"] = names[0].str.cat(names[1:], sep=" + ")
        grouped = found.groupby(["object", "noise", *SLOTS, "label"], sort=False)
        return grouped.agg(average_all).reset_index()

    @property
    def failed(self) -> int:
        """The number of combinations that ended with an error."""
        return sum(bool(outcome.error) for outcome in self.outcomes.values())

    @property
    def built(self) -> dict[str, int]:
        """The number of artifacts of each stage that the sweep has built."""
        stages = Counter(name.split()[0] for outcome in self.outcomes.values() for name in outcome.built)
        return dict(sorted(stages.items()))


def run_sweep(plan: Plan, out: Path, store: Path, workers: Workers, progress: Progress | None = None) -> Sweep:
    """Evaluate every combination of `plan` that has no row in `out`; write each row there when it is finished.

    The row of a failed combination states the error, and the next call tries the combination again. All workers share
    the stage store in the folder `store`. Raises TactileLocError for a bad plan or `out`, before anything runs.
    """
    require_tables()
    combinations, objects = combine(plan)
    require_writable(out)
    queue = [
        QueuedJob(
            CombinationJob(one.key, one.config, one.count, store),
            objects[one.object],
            f"{one.object} {one.config.encoder.name} {one.config.refiner.name}",
            {"object": one.object, "configuration": one.describe()},
        )
        for one in order_for_running(combinations)
    ]
    return Sweep(plan, combinations, *resume_jobs("sweep", queue, out, workers, progress))


def average_all(values: pd.Series) -> float:
    """Return the mean of values; NaN if any value is NaN."""
    return float(values.mean(skipna=False))


def list_columns(plan: Plan) -> list[str]:
    """Return the names of a plan's columns, in their order."""
    results = ("grid_poses", *ERRORS, *COVERAGES, "nll_nats", "error", "key", *MOMENTARY)
    return [*IDENTITY, *list_varied_columns(plan), *results]


def list_varied_columns(plan: Plan) -> list[str]:
    """Return "slot.option" for each option that differs between choices of one component."""
    return [f"{slot}.{option}" for slot, choices in plan.slots.items() for option in find_varied_options(choices)]


def make_rows(plan: Plan, combinations: Iterable[Combination], outcomes: Mapping[str, JobOutcome]) -> list[Row]:
    """Return a row with all columns for each combination, as JSON values; missing values are None."""
    columns, varied = list_columns(plan), list_varied_columns(plan)
    rows = []
    for one in combinations:
        outcome = outcomes[one.key]
        known = {**_identify(one, varied), **(outcome.measured or {}), "error": outcome.error, "key": one.key}
        known["built"] = json.dumps(list(outcome.built))
        rows.append({column: known.get(column) for column in columns})
    return rows


def _identify(one: Combination, varied: Sequence[str]) -> Row:
    config = one.config
    slots = {slot: getattr(config, slot) for slot in SLOTS}
    parted = [(column, *column.split(".", 1)) for column in varied]
    return {
        "object": one.object, **{slot: chosen.name for slot, chosen in slots.items()},
        "noise": config.touch.noise, "seed": config.seed, "count": one.count,
        **{column: slots[slot].options.get(option) for column, slot, option in parted},
    }  # fmt: skip


def make_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return rows as a table whose column types are fixed, even if no combination succeeded.

    The column of an option has the type of its values. Lists and mixed types are written as JSON.
    """
    import pandas as pd

    return pd.DataFrame({name: _make_column([row[name] for row in rows], name) for name in rows[0]})


def _make_column(values: Sequence[Any], name: str) -> pd.Series:
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


def require_tables(what: str = "a sweep", extra: str = "sweep") -> None:
    """Raise MissingLibraryError if a library for writing tables is missing; `what` needs it, `extra` installs it."""
    try:
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            f"{what} needs {error.name}, which is not installed: pip install 'tactile-loc[{extra}]'"
        ) from error
