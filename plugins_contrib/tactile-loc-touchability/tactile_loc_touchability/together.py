"""The best two or three touches together: chosen for the rivals that they separate, then located as `run` does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import PoseModes, QueuedJob, choose_next_touch, resume_jobs
from tactile_loc.plugin import ConfigError, Poses, Progress
from tactile_loc.plugin.helpers import exponential

from tactile_loc_touchability.locating import Row
from tactile_loc_touchability.rivals import choose_marks
from tactile_loc_touchability.study import Study, collect_rows, list_numbers, make_job, share_rows, split_sets

Floats = NDArray[np.float64]

FIRST, NEXT = 3, 3  # first presses, and next presses to each, that are located
MOST = 3  # touches together
REPEATED, CONFIRMED = 4, 12  # sets of each choice, and of the best, with other noise and other errors of the presses
SHIFT_M, TURN_RAD = 1e-3, np.radians(3.0)  # standard deviation of a press's place and direction
HOPE = 0.3  # of a certain touch: the worth of a probability that the first pose is right
LEAST_RIGHT = 0.3  # probability of the true pose among the modes if a touch states less
FACING = 4.0  # how much less a touch counts whose surface faces elsewhere
SMOOTH = 0.08  # share of the diameter: distance over which results of touches are averaged


@dataclass(frozen=True, eq=False)
class BestTouches:
    """The best presses that were found, by their numbers, and the shares of repeated sets: see `share_rows`."""

    presses: tuple[int, ...]
    shares: dict[str, Any]


def find_best_touches(study: Study, out: Path, workers: Any, progress: Progress) -> list[BestTouches]:
    """Return the best press, the best two presses together, and the best three.

    The first presses are those around which most touches ended certain. The next ones are those with the most
    information about the poses that the first one leaves, by `choose_next_touch`. Every choice is then located REPEATED
    times, with noise and with errors of the presses, and the one that most often ends certain is kept. The shares are
    those of CONFIRMED further sets, because the best of many choices is often best by chance.
    """
    chosen: list[tuple[int, ...]] = []
    for first in _choose_first(study):
        others = _choose_next(study, first)
        chosen += [(first, *more) for n in range(MOST) for more in itertools.combinations(others, n)]
    chosen.sort(key=len)
    sets = [presses for presses in chosen for _ in range(REPEATED)]
    tried = _rate(chosen, _locate(study, sets, out, workers, progress))
    of = {n: [one for one in tried if len(one.presses) == n] for n in range(1, 1 + MOST)}
    kept = [max(some, key=lambda one: (one.shares["certain"], one.shares["right"])) for some in of.values() if some]
    best = [one.presses for one in kept]
    sets = [presses for presses in best for _ in range(CONFIRMED)]
    return _rate(best, _locate(study, sets, out, workers, progress))


def average_nearby(study: Study, values: Floats, places_m: Floats, normals: Floats) -> Floats:
    """Return the mean (P,) of values (N,) of the presses near each of P places (P, 3), metres, weighted by distance.

    Presses count less where the surface has another normal than the normals (P, 3) of the places.
    """
    apart = np.linalg.norm(places_m[:, None] - study.presses.places_m[None], axis=-1) / (SMOOTH * study.diameter_m)
    turned = 1 - normals @ study.presses.normals.T
    weights = np.exp(-np.minimum(0.5 * apart**2 + FACING * turned, 80.0))
    return np.asarray(weights @ values / weights.sum(axis=1))


def _choose_first(study: Study) -> Sequence[int]:
    """Return a few presses, far apart, around which most touches ended certain or, if none did, right."""
    right = np.array([row["right"] for row in study.rows])
    nearby = average_nearby(study, study.certain + HOPE * right, study.presses.places_m, study.presses.normals)
    worth = nearby + HOPE * right
    return choose_marks(study.presses.places_m, worth >= np.quantile(worth, 0.95), FIRST)


def _choose_next(study: Study, first: int) -> Sequence[int]:
    """Return the presses with the most information about the poses that the press `first` leaves, far apart."""
    row = study.rows[first]
    poses = np.stack([np.eye(4), *(np.reshape(one["motion"], (4, 4)) for one in row["rivals"])])
    p = np.array([max(LEAST_RIGHT, row["right"]), *(one["probability"] for one in row["rivals"])])
    obj, geometry = study.localizer.object, study.localizer.scene.geometry
    modes = PoseModes((obj,) * len(p), poses, p / p.sum(), geometry, study.press_m)
    try:
        ranked = choose_next_touch(modes, study.list_approaches()).ranked
    except ConfigError:  # no approach is within reach
        return []
    numbers = [int(one.approach.name) for one in ranked[: 1 + len(ranked) // 20]]
    marked = np.isin(np.arange(len(study.presses)), [n for n in numbers if n != first])
    return choose_marks(study.presses.places_m, marked, NEXT)


def _rate(chosen: Sequence[tuple[int, ...]], rows: Sequence[Row]) -> list[BestTouches]:
    """Return the shares of choices, each with equally many of the rows, in their order."""
    each = len(rows) // len(chosen)
    located = (rows[k * each : (k + 1) * each] for k in range(len(chosen)))
    return [BestTouches(some, share_rows(len(some), of)) for some, of in zip(chosen, located, strict=True)]


def _locate(study: Study, chosen: Sequence[tuple[int, ...]], out: Path, workers: Any, progress: Progress) -> list[Row]:
    """Locate sets of presses, given by their numbers, and return their rows."""
    seed = (study.options.seed, 1, len(chosen))
    rng, poses = np.random.default_rng(seed), study.presses.T_sensor_object
    sets = [tuple(list_numbers(disturb(study, poses[k], rng)) for k in some) for some in chosen]
    jobs = [
        make_job(study.localizer, study.press_m, study.options, (*seed, batch), some)
        for batch, some in enumerate(split_sets(sets))
    ]
    obj = study.localizer.object
    queue = [QueuedJob(job, obj, obj.name, {"sets": len(job.sets)}) for job in jobs]
    outcomes, _ = resume_jobs("locating the best touches", queue, out, workers, progress)
    return collect_rows(jobs, outcomes)


def disturb(study: Study, T_sensor_object: Poses, rng: np.random.Generator) -> Poses:
    """Return a press (4, 4) with an error of its place and direction, brought to contact and pressed again."""
    scene = study.localizer.scene
    twist = np.concatenate([rng.normal(0, TURN_RAD, 3), rng.normal(0, SHIFT_M, 3)])
    T, touching = scene.bring_to_contact((exponential(twist, scene.geometry.gel_middle_m) @ T_sensor_object)[None])
    if not touching[0]:
        return T_sensor_object
    T[0, 2, 3] -= study.press_m
    return np.asarray(T[0])
