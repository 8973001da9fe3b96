"""The paper's protocol for one touch: how far the best poses are from the true one, beside what the grid allows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TouchError
from tactile_loc.core.localizer import Localizer
from tactile_loc.core.poses import Poses
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing import Touch
from tactile_loc.evaluation.metrics import symmetric_add

LINES = ("closest", "random", "best-1", "best-10", "reg-1")
SURFACE_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class SingleTouchErrors:
    """Symmetry-aware ADD (T,) in metres of each line of LINES for T touches, and seconds (T,) a stage.

    `closest` is the grid pose nearest to the truth, `random` a random grid pose; `scale_m` their mean random error, by
    which the paper normalises.
    """

    errors_m: dict[str, NDArray[np.float64]]
    seconds: dict[str, NDArray[np.float64]]

    @property
    def scale_m(self) -> float:
        """Mean error of a random contact pose, metres."""
        return float(self.errors_m["random"].mean())


def evaluate_single_touch(
    localizer: Localizer, touches: Sequence[Touch], rng: np.random.Generator, progress: Progress | None = None
) -> SingleTouchErrors:
    """Localise touches of known pose and measure every line of LINES, metres. `rng` draws points and poses."""
    points_m = localizer.object.mesh.sample(SURFACE_POINTS, rng)
    grid = localizer.model.grid
    localizer.best_pose(touches[0])  # loads libraries and builds the bank: not part of any stage's time
    rows, times = [], []
    with (progress or Progress()).task("localising touches", len(touches)) as advance:
        for touch in touches:
            guess = int(rng.integers(len(grid)))
            row, seconds = _one(localizer, touch, points_m, guess)
            rows.append(row)
            times.append(seconds)
            advance(1)
    return SingleTouchErrors(_columns(rows), _columns(times))


def _one(
    localizer: Localizer, touch: Touch, points_m: NDArray[np.float64], guess: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Errors (metres) and seconds of one touch; `guess` is a random pose's grid index."""
    truth = _truth(touch)
    poses = localizer.model.grid.T_sensor_object

    def error(T: Poses) -> float:
        return symmetric_add(localizer.object, points_m, T, truth)

    seconds: dict[str, float] = {}
    posterior = localizer.posterior(touch, seconds=seconds)
    top = posterior.top(10)
    start = time.perf_counter()
    refined = localizer.refine(touch, posterior, int(top[0]))
    seconds["refine"] = time.perf_counter() - start
    seconds["total"] = sum(seconds.values())
    best = [error(poses[i]) for i in top]
    closest = error(poses[localizer.model.grid.nearest(truth[None])[1][0]])
    lines = (closest, error(poses[guess]), best[0], min(best), error(refined.T_sensor_object))
    return dict(zip(LINES, lines, strict=True)), seconds


def _truth(touch: Touch) -> NDArray[np.float64]:
    if touch.T_sensor_object is None:
        raise TouchError(
            f"{touch.name} has no true pose to compare with; simulate it, or add T_sensor_object to its file"
        )
    return touch.T_sensor_object


def _columns(rows: Sequence[dict[str, float]]) -> dict[str, NDArray[np.float64]]:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
