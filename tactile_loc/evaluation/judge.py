"""Localises one touch of known pose and measures every line of the protocol."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.progress import StageTimes
from tactile_loc.core.sensing import Touch
from tactile_loc.evaluation.belief import belief
from tactile_loc.evaluation.metrics import add_s, hull_corners, mssd, symmetric_adds
from tactile_loc.evaluation.oracle import true_pose
from tactile_loc.locate.localizer import Localizer

LINES = ("best-1", "best-10", "best-50", "reg-1", "chosen", "reg-10", "closest", "oracle", "random", "random-10")
METRICS = ("add", "mssd", "add-s")
STAGES = ("encode", "match", "fuse", "refine")
SURFACE_POINTS = 10_000
ASKED_EVERY = 10  # of the surface points, for ADD-S
MOST, FEW = 50, 10  # poses that best-50, and that best-10, chosen, reg-10 and random-10 choose from
NEAR = 32  # nearest grid poses by root mean square distance, among which the nearest by ADD is looked for
NEAR_STEP_M = 1e-3  # of a continuous symmetry, in looking for them


def surface_points(obj: ObjectModel) -> NDArray[np.float64]:
    """Return the points (SURFACE_POINTS, 3) of an object, metres, over which ADD is taken: always the same."""
    return obj.mesh.sample(SURFACE_POINTS, np.random.default_rng(0))


@dataclass(frozen=True, eq=False)
class Judge:
    """Knows the truth of touches on a localizer's object."""

    localizer: Localizer

    def judge(
        self, touch: Touch, oracle: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], Poses, NDArray[np.float64], NDArray[np.float64]]:
        """Localise a touch of known pose: errors (L, M) and poses (L, 4, 4) of LINES in metres, seconds (S,) of STAGES,
        and numbers (B,) of BELIEF.

        `oracle` is the grid index of the oracle's pose; `rng` draws the random poses. The refinement's time is that of
        one pose. Raises TouchError without a true pose.
        """
        truth = true_pose(touch)
        times = StageTimes()
        posterior = self.localizer.posterior(touch, times=times)
        top = posterior.top(MOST)
        top = top[np.isfinite(posterior.log_p[top])]
        guesses = rng.integers(len(posterior.grid), size=FEW)
        refined, times.seconds["refine"] = self._refine(touch, posterior, top[:FEW])
        chosen = int(self.localizer.scene.explained(refined, touch).argmax())
        poses = self._lines(truth, top, guesses, oracle, refined, chosen)
        seconds = np.array([times.seconds[stage] for stage in STAGES])
        return self._measure(poses, truth), poses, seconds, belief(posterior, truth, rng)

    def _refine(self, touch: Touch, posterior: PosePosterior, top: NDArray[np.int64]) -> tuple[Poses, float]:
        """Refine the grid poses `top` (K,), and say how long the first took, seconds."""
        start = time.perf_counter()
        (first,) = self.localizer.refine(touch, posterior, [int(top[0])])
        seconds = time.perf_counter() - start
        others = self.localizer.refine(touch, posterior, [int(index) for index in top[1:]])
        return np.stack([pose.T_sensor_object for pose in (first, *others)]), seconds

    def _lines(
        self, T_true: Poses, top: NDArray[np.int64], guesses: NDArray[np.int64], oracle: int, refined: Poses,
        chosen: int,
    ) -> Poses:  # fmt: skip
        """The pose (L, 4, 4) of each line: of those it may choose from, the one nearest to the truth by ADD."""
        on_grid = np.concatenate([top, guesses, [oracle], self._near(T_true)])
        poses = np.concatenate([self.localizer.model.grid.T_sensor_object[on_grid], refined])
        errors = symmetric_adds(self.localizer.object, self._points_m, poses, T_true)
        k, n = len(top), len(on_grid)
        choices = {
            "best-1": (0, 1), "best-10": (0, min(FEW, k)), "best-50": (0, k), "reg-1": (n, n + 1),
            "chosen": (n + chosen, n + chosen + 1), "reg-10": (n, len(poses)), "closest": (0, n),
            "oracle": (k + FEW, k + FEW + 1), "random": (k, k + 1), "random-10": (k, k + FEW),
        }  # fmt: skip
        return np.stack([poses[a + errors[a:b].argmin()] for a, b in (choices[line] for line in LINES)])

    def _near(self, T_true: Poses) -> NDArray[np.int64]:
        """Indices of the grid poses with the least root mean square distance to the truth, symmetry regarded."""
        distances = self.localizer.model.grid.distances(T_true, NEAR_STEP_M)
        return np.argsort(distances, kind="stable")[:NEAR]

    def _measure(self, poses: Poses, T_true: Poses) -> NDArray[np.float64]:
        """Errors (L, M) in metres of poses (L, 4, 4); equal poses are measured once."""
        obj = self.localizer.object
        distinct, where = np.unique(poses.reshape(len(poses), 16), axis=0, return_inverse=True)
        distinct = distinct.reshape(-1, 4, 4)
        errors = (
            symmetric_adds(obj, self._points_m, distinct, T_true),
            mssd(obj, self._corners_m, distinct, T_true),
            add_s(self._points_m, distinct, T_true, ASKED_EVERY),
        )
        return np.stack(errors, axis=1)[where.ravel()]

    @cached_property
    def _points_m(self) -> NDArray[np.float64]:
        return surface_points(self.localizer.object)

    @cached_property
    def _corners_m(self) -> NDArray[np.float64]:
        return hull_corners(self.localizer.object.mesh)
