"""A sweep: it evaluates the missing combinations, and keeps every finished row."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.evaluation.jobs import JobOutcome, QueuedJob, Workers, resume_jobs
from tactile_loc.evaluation.sweep.combination import (
    COVERAGES,
    ERRORS,
    IDS,
    TIMES,
    TOUCHES,
    Combination,
    CombinationJob,
    combine,
    name_time,
    order_for_running,
)
from tactile_loc.evaluation.sweep.plan import Plan, find_varied_options, find_varying_slots, name_choices
from tactile_loc.evaluation.sweep.uncertainty import ComparedMedian
from tactile_loc.evaluation.text_tables import Row
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import require_writable

FAILED, BASE, UNPAIRED = "failed", "base", "other touches"  # why a combination is not compared with the base
VERDICTS = (("better", "worse"), ("faster", "slower"))  # of a smaller, and a larger error; and time
EVALUATION = "evaluation"  # the stage of a combination's results

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
MEASURED = (*ERRORS, *COVERAGES, "nll_nats", *TIMES, "model_s")
NAMED = ("encoder", "refiner")  # the slots that labels name if no slot varies


@dataclass(frozen=True, eq=False)
class ChoiceMedian:
    """The median error, mm, and time per touch, ms, of one object, noise and choice of components, as means over seeds.

    Error and time are of the same line of the protocol. Both are NaN if a combination failed. Their base is the first
    choice of each slot. `choices` has the index of each slot's choice in the plan. `label` names the choices of slots
    that vary.
    """

    object: str
    noise: str
    choices: tuple[int, ...]
    label: str
    error: ComparedMedian
    time: ComparedMedian

    @property
    def error_mm(self) -> float:
        """The median error."""
        return self.error.median.value


@dataclass(frozen=True, eq=False)
class Sweep:
    """A plan's combinations and their outcomes.

    `done` has the keys of the combinations whose rows this call made; the other rows were there before.
    """

    plan: Plan
    combinations: Sequence[Combination]
    outcomes: Mapping[str, JobOutcome]
    done: Sequence[str]

    @cached_property
    def rows(self) -> list[Row]:
        """A row of JSON values for each combination."""
        return make_rows(self.plan, self.combinations, self.outcomes)

    def compute_medians(self, line: str) -> list[ChoiceMedian]:
        """Return the median error of `line` for each object, noise and choice of components, in the plan's order."""
        labels, named = name_choices(self.plan), find_varying_slots(self.plan) or NAMED
        grouped: dict[tuple[Any, ...], list[tuple[Combination, Row]]] = {}
        for one, row in zip(self.combinations, self.rows, strict=True):
            grouped.setdefault((one.object, one.config.touch.noise, one.place[1:-2]), []).append((one, row))
        found: dict[tuple[Any, ...], ChoiceMedian] = {}
        touches = {key: [row["touches_id"] for _, row in group] for key, group in grouped.items()}
        for (name, noise, choices), group in grouped.items():
            label = " + ".join(labels[slot][k] for slot, k in zip(SLOTS, choices, strict=True) if slot in named)
            values = (
                np.array([self.list_touches(one, column) for one, _ in group])
                for column in (f"{line}_mm", name_time(line))
            )
            key = name, noise, (0,) * len(choices)
            base = found.get(key)
            failed = any(row["error"] for each in (group, grouped[key]) for _, row in each)
            paired = touches[key] == touches[name, noise, choices]
            without = FAILED if failed else BASE if base is None else UNPAIRED
            known = (
                (None, None)
                if without == FAILED or base is None or not paired
                else (base.error.values, base.time.values)
            )
            error, time = (
                ComparedMedian.of(some, other, *words, without)
                for some, other, words in zip(values, known, VERDICTS, strict=True)
            )
            found[name, noise, choices] = ChoiceMedian(name, noise, choices, label, error, time)
        return list(found.values())

    def list_touches(self, one: Combination, column: str) -> Floats:
        """Return a value for each touch (T,) of a combination; NaN if it failed."""
        measured = self.outcomes[one.key].measured or {}
        return np.array(measured.get(TOUCHES, {}).get(column, [math.nan] * one.count), dtype=np.float64)

    def find_changed(self) -> dict[str, tuple[str, ...]]:
        """Return the slots that by their nature change more than the method: each with "grid", "touches", or both.

        Rows that differ in such a slot are not equal in all else.
        """
        found = {}
        for slot in find_varying_slots(self.plan):
            place = 1 + SLOTS.index(slot)
            groups: dict[Any, list[Row]] = {}
            for one, row in zip(self.combinations, self.rows, strict=True):
                groups.setdefault((*one.place[:place], *one.place[place + 1 :]), []).append(row)
            changed = (
                name for name in IDS if any(len({r[name] for r in rows} - {None}) > 1 for rows in groups.values())
            )
            if names := tuple(name.removesuffix("_id") for name in changed):
                found[slot] = names
        return found

    @property
    def failed(self) -> int:
        """The number of combinations that ended with an error."""
        return sum(bool(outcome.error) for outcome in self.outcomes.values())

    @property
    def evaluated(self) -> int:
        """The number of combinations whose evaluation was built or failed in this call; others are in the store."""
        outcomes = (self.outcomes[key] for key in self.done)
        return sum(bool(one.error) or any(name.split()[0] == EVALUATION for name in one.built) for one in outcomes)

    @property
    def built(self) -> dict[str, int]:
        """The number of artifacts of each stage that were built for the rows, in this call or before."""
        return self._count_built(self.outcomes)

    @property
    def built_now(self) -> dict[str, int]:
        """The number of artifacts of each stage that were built for the rows which this call made."""
        return self._count_built(self.done)

    def _count_built(self, keys: Iterable[str]) -> dict[str, int]:
        stages = Counter(name.split()[0] for key in keys for name in self.outcomes[key].built)
        return dict(sorted(stages.items()))


def run_sweep(plan: Plan, out: Path, store: Path, workers: Workers, progress: Progress | None = None) -> Sweep:
    """Evaluate every combination of `plan` that has no row in `out`; write each row there when it is finished.

    The row of a failed combination states the error, and the next call tries the combination again. All workers share
    the stage store in the folder `store`. Raises TactileLocError for a bad plan or `out`, before anything runs.
    """
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
    results = ("grid_poses", *IDS, *ERRORS, *COVERAGES, "nll_nats", "error", "key", *MOMENTARY)
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
