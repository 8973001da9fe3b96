"""A sweep: it evaluates the missing combinations, keeps every finished row, and makes the table of all rows."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

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
from tactile_loc.evaluation.text_tables import require_parquet
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import require_writable

Row = dict[str, Any]

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
MEASURED = (*ERRORS, *COVERAGES, "nll_nats", *TIMES, "model_s")
NAMED = ("encoder", "refiner")  # the slots that labels name if no slot varies


class ChoiceMedian(NamedTuple):
    """The median error, mm, and time per touch, ms, of one object, noise and choice of components, as means over seeds.

    Both are NaN if a combination failed. `choices` has the index of each slot's choice in the plan. `label` names the
    choices of slots that vary.
    """

    object: str
    noise: str
    choices: tuple[int, ...]
    label: str
    error_mm: float
    time_ms: float


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

    def compute_medians(self, line: str) -> list[ChoiceMedian]:
        """Return the median error of `line` for each object, noise and choice of components, in the plan's order."""
        labels, named = name_choices(self.plan), find_varying_slots(self.plan) or NAMED
        found: dict[tuple[Any, ...], list[list[float]]] = {}
        for one, row in zip(self.combinations, self.rows, strict=True):
            values = (row[f"{line}_median_mm"], row["total_ms"])
            key = one.object, one.config.touch.noise, one.place[1:-2]
            found.setdefault(key, []).append([math.nan if value is None else value for value in values])
        return [
            ChoiceMedian(
                name,
                noise,
                choices,
                " + ".join(labels[slot][k] for slot, k in zip(SLOTS, choices, strict=True) if slot in named),
                *np.mean(values, axis=0).tolist(),
            )
            for (name, noise, choices), values in found.items()
        ]

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
    require_parquet("a sweep")
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


def list_columns(plan: Plan) -> list[str]:
    """Return the names of a plan's columns, in their order."""
    results = ("grid_poses", *ERRORS, *COVERAGES, "nll_nats", "error", "key", *MOMENTARY)
    return [*IDENTITY, *list_varied_columns(plan), *results]


def list_varied_columns(plan: Plan) -> list[str]:
    """Return "slot.option" for each option that differs between choices of one component."""
    return [f"{slot}.{option}" for slot, choices in plan.slots.items() for option in find_varied_options(choices)]


def make_rows(plan: Plan, combinations: Iterable[Combination], outcomes: Mapping[str, JobOutcome]) -> list[Row]:
    """Return a row with all columns for each combination, as JSON values; missing values are None."""
    columns, varied = list_columns(plan), [column.split(".", 1) for column in list_varied_columns(plan)]
    rows = []
    for one in combinations:
        outcome, config = outcomes[one.key], one.config
        slots = {slot: getattr(config, slot) for slot in SLOTS}
        known = {
            "object": one.object,
            **{slot: chosen.name for slot, chosen in slots.items()},
            "noise": config.touch.noise,
            "seed": config.seed,
            "count": one.count,
            **{f"{slot}.{option}": slots[slot].options.get(option) for slot, option in varied},
            **(outcome.measured or {}),
            "error": outcome.error,
            "key": one.key,
            "built": json.dumps(list(outcome.built)),
        }
        rows.append({column: known.get(column) for column in columns})
    return rows
