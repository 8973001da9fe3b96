"""A whole sweep: what is missing is evaluated, every finished row kept, and the results written."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.progress import Progress
from tactile_loc.store.files import require_writable
from tactile_loc.sweeps.combinations import Combination, combine, in_running_order
from tactile_loc.sweeps.kept import KeptRows
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.table import Row, require_parquet, rows_of
from tactile_loc.sweeps.work import Job, Outcome

log = logging.getLogger(__name__)


class Workers(Protocol):
    """Whoever does jobs: `LocalWorkers` or `DaskWorkers`."""

    def outcomes(self, jobs: Sequence[Job], objects: Mapping[str, ObjectModel]) -> Generator[Outcome, None, None]:
        """Yield the outcome of every job as it ends; `objects` holds each job's object by the job's key."""
        ...


@dataclass(frozen=True, eq=False)
class Sweep:
    """A plan's combinations and what became of each; `done` of them were evaluated now, the others before."""

    plan: Plan
    combinations: Sequence[Combination]
    outcomes: Mapping[str, Outcome]
    done: int

    @property
    def rows(self) -> list[Row]:
        """The table: a row for each combination."""
        return rows_of(self.plan, self.combinations, self.outcomes)

    @property
    def failed(self) -> int:
        """How many combinations ended with an error."""
        return sum(bool(outcome.error) for outcome in self.outcomes.values())

    @property
    def built(self) -> dict[str, int]:
        """How many artifacts of each stage the sweep's processes have built."""
        stages = Counter(name.split()[0] for outcome in self.outcomes.values() for name in outcome.built)
        return dict(sorted(stages.items()))


def run_sweep(
    plan: Plan, out: Path, store: Path, workers: Workers, progress: Progress | None = None
) -> Sweep:  # fmt: skip
    """Evaluate every combination of `plan` that `out` has no row of, and keep each row there as soon as it ends.

    A combination that fails is a row with its error; such rows are tried again. `store` is the stage store's folder,
    which all workers share. Raises TactileLocError, before anything runs, for whatever is wrong with the plan or `out`.
    """
    require_parquet()
    combinations, objects = combine(plan)
    require_writable(out)
    kept = KeptRows(out)
    outcomes = finished(combinations, kept)
    missing = [one for one in in_running_order(combinations) if one.key not in outcomes]
    if missing:
        outcomes |= _run(missing, objects, store, workers, kept, progress or Progress(), len(outcomes))
    return Sweep(plan, combinations, outcomes, len(missing))


def finished(combinations: Sequence[Combination], kept: KeptRows) -> dict[str, Outcome]:
    """Return the outcomes, by key, of the combinations that were evaluated without an error before."""
    found = {one.key: kept.read(one.key) for one in combinations}
    return {key: outcome for key, outcome in found.items() if outcome is not None and not outcome.error}


def _run(
    missing: Sequence[Combination], objects: Mapping[str, ObjectModel], store: Path, workers: Workers, kept: KeptRows,
    progress: Progress, before: int,
) -> dict[str, Outcome]:  # fmt: skip
    by_key = {one.key: one for one in missing}
    jobs = [Job(one.key, one.config, one.count, store) for one in missing]
    outcomes: dict[str, Outcome] = {}
    running = workers.outcomes(jobs, {one.key: objects[one.object] for one in missing})
    with progress.task("sweep", before + len(jobs)) as advance, closing(running):
        advance(before)
        for outcome in running:
            kept.keep(by_key[outcome.key], outcome)
            outcomes[outcome.key] = outcome
            _show(progress, advance, by_key[outcome.key], outcomes)
    return outcomes


def _show(
    progress: Progress, advance: Callable[[int], None], last: Combination, outcomes: Mapping[str, Outcome]
) -> None:  # fmt: skip
    """Advance the bar, with the combination that ended last and how many have failed."""
    failed = sum(bool(outcome.error) for outcome in outcomes.values())
    names = [last.object, last.config.encoder.name, last.config.refiner.name]
    text = " ".join([*names, *([f"({failed} failed)"] if failed else [])])
    log.info("%d combinations are done; the last was %s.", len(outcomes), text)
    progress.note(text)
    advance(1)
