"""A study of one object with one sensor and press: touches at random places, located alone and several together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Approach, Clearance, Localizer, PoseJudge, QueuedJob, resume_jobs
from tactile_loc.plugin import Poses, Progress, TactileLocError

from tactile_loc_touchability.locating import NOTHING, LocatingSets, Row, Rows, describe_all
from tactile_loc_touchability.presses import Presses, PressingSensor, draw_presses, list_approaches

RIGHT_M = 1e-3  # poses with pose errors up to this are right
PRESS_SHARE = 0.6  # of the sensor's deepest press, if no press is given
AT_ONCE = 20  # touches that one job locates
TOGETHER = (2, 3)  # numbers of touches that are located together


@dataclass(frozen=True)
class StudyOptions:
    """What a study simulates: the number of single `touches`, and of `sets` of several touches of each number.

    Presses are tilted from the surface's normal by at most `tilt_rad`. Touches have a `noise`, and are drawn by a
    `renderer`.
    """

    touches: int = 400
    sets: int = 40
    tilt_rad: float = np.radians(30.0)
    noise: str = "mild"
    renderer: str = "heightmap"
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SensorSetup:
    """What is studied: the localizer of an object and a sensor, the depth of presses, metres, and what it may hit."""

    localizer: Localizer
    press_m: float
    clearance: Clearance | None = None


@dataclass(frozen=True, eq=False)
class Study:
    """The results of an object with one sensor, pressed `press_m` metres deep.

    `rows` are those of `presses`, located alone. `together` has, for each number of touches, the rows of sets.
    """

    localizer: Localizer
    press_m: float
    options: StudyOptions
    presses: Presses
    rows: Sequence[Row]
    together: dict[int, Sequence[Row]]

    @property
    def name(self) -> str:
        """The sensor and the press in words."""
        return f"{self.localizer.config.sensor.name}, {1e3 * self.press_m:.2g} mm"

    @cached_property
    def certain(self) -> NDArray[np.bool_]:
        """Which presses (N,) end with the verdict certain."""
        return np.array([row["verdict"] == "certain" for row in self.rows])

    @cached_property
    def diameter_m(self) -> float:
        """The object's diameter, metres."""
        return PoseJudge(self.localizer.object).diameter_m

    @cached_property
    def errors_m(self) -> NDArray[np.float64]:
        """The pose errors (N,), metres. A press that shows nothing has the object's diameter as its error."""
        errors = [self.diameter_m if row["error_m"] is None else row["error_m"] for row in self.rows]
        return np.minimum(errors, self.diameter_m)

    def list_approaches(self) -> list[Approach]:
        """Return the presses as approaches in the object's frame, each named by its number."""
        return list_approaches(self.presses.T_sensor_object, self.press_m, 2 * self.diameter_m)

    def list_shares(self) -> list[dict[str, Any]]:
        """Return the shares that end certain, right, and without a feature, for each number of touches."""
        return [share_rows(1, self.rows), *(share_rows(n, rows) for n, rows in self.together.items())]


def share_rows(touches: int, rows: Sequence[Row]) -> dict[str, Any]:
    """Return the shares of rows that end certain, that are right, and whose presses show nothing, 0 to 1."""
    certain = np.array([row["verdict"] == "certain" for row in rows])
    right = np.array([row["error_m"] is not None and row["error_m"] <= RIGHT_M for row in rows])
    nothing = np.array([row["verdict"] == NOTHING for row in rows])
    shares = {"certain": certain, "right": right, "nothing": nothing, "wrong": certain & ~right}
    return {"touches": touches, "sets": len(rows), **{name: float(some.mean()) for name, some in shares.items()}}


def run_studies(
    setups: Sequence[SensorSetup], options: StudyOptions, out: Path, workers: Any, progress: Progress
) -> list[Study]:
    """Study an object with each of several setups in worker processes.

    Finished jobs are kept in `out`, and are not done again. Raises TactileLocError if a job fails.
    """
    queue, plans = [], []
    with progress.task("drawing presses", len(setups)) as advance:
        for setup in setups:
            localizer, press_m = setup.localizer, setup.press_m
            _ = localizer.places  # stored, so that no worker has to find them
            presses, sets = draw_sets(setup, options)
            jobs = [
                make_job(localizer, press_m, options, (options.seed, batch), some)
                for batch, some in enumerate(split_sets(sets))
            ]
            plans.append((localizer, press_m, presses, jobs))
            queue += [
                QueuedJob(job, localizer.object, localizer.object.name, {"touches": len(job.sets)}) for job in jobs
            ]
            advance(1)
    outcomes, _ = resume_jobs("locating touches", queue, out, workers, progress)
    studies = []
    for localizer, press_m, presses, jobs in plans:
        rows = list(zip((len(some) for job in jobs for some in job.sets), collect_rows(jobs, outcomes), strict=True))
        of = {n: [row for count, row in rows if count == n] for n in (1, *TOGETHER)}
        studies.append(Study(localizer, press_m, options, presses, of[1], {n: of[n] for n in TOGETHER if of[n]}))
    return studies


def collect_rows(jobs: Sequence[LocatingSets], outcomes: Mapping[str, Any]) -> list[Row]:
    """Return the rows of all sets of jobs, in their order. Raises TactileLocError if a job failed."""
    rows: list[Row] = []
    for job in jobs:
        outcome = outcomes[job.key]
        if outcome.error:
            raise TactileLocError(f"touches cannot be located: {outcome.error}")
        rows += outcome.measured["rows"]
    return rows


def draw_sets(setup: SensorSetup, options: StudyOptions) -> tuple[Presses, list[tuple[Rows, ...]]]:
    """Draw presses, and return them with the sets to locate: each alone, then random sets of several of them."""
    rng, geometry = np.random.default_rng([options.seed, 0]), setup.localizer.scene.geometry
    sensor = PressingSensor(geometry, setup.press_m, options.tilt_rad, setup.clearance)
    presses = draw_presses(setup.localizer.object, sensor, options.touches, rng)
    poses = [list_numbers(T) for T in presses.T_sensor_object]
    chosen = [rng.choice(len(poses), n, replace=False) for n in TOGETHER for _ in range(options.sets)]
    return presses, [*((pose,) for pose in poses), *(tuple(poses[k] for k in some) for some in chosen)]


def split_sets(sets: Sequence[tuple[Rows, ...]]) -> list[tuple[tuple[Rows, ...], ...]]:
    """Return the sets in batches of about AT_ONCE touches, for one job each."""
    batches: list[list[tuple[Rows, ...]]] = [[]]
    for some in sets:
        if sum(map(len, batches[-1])) + len(some) > AT_ONCE:
            batches.append([])
        batches[-1].append(some)
    return [tuple(batch) for batch in batches]


def list_numbers(T: Poses) -> Rows:
    """Return a pose (4, 4) as 16 numbers."""
    return tuple(T.round(9).ravel().tolist())


def make_job(
    localizer: Localizer,
    press_m: float,
    options: StudyOptions,
    seed: tuple[int, ...],
    sets: tuple[tuple[Rows, ...], ...],
) -> LocatingSets:
    """Return the job that locates sets of presses."""
    about, store = describe_all(localizer.object), localizer.store.root
    return LocatingSets(store, localizer.config, sets, press_m, options.noise, options.renderer, seed, about)
