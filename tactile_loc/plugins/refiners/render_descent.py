"""Levenberg-Marquardt over pictures: finite differences, several dampings tried at once, many poses side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import PoseMetric, Poses
from tactile_loc.plugins.refiners.render_pictures import Float32, Floats, Pictures

DAMPINGS = np.array([0.1, 1.0, 10.0])  # that are tried, times the last that was good
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-4, 30.0
STIFFER = 30.0  # the damping grows by this when none was good
FARTHEST = 4.0  # steps that a pose may move at once
TINY = 1e-9  # of curvature: directions that no picture shows are left alone
SEEN = 0.02  # shares of the press: pixels that are pressed in


@dataclass(frozen=True, eq=False)
class Descent:
    """Moves poses (K, 4, 4), metres, until their pictures are alike the touch's, `wanted` (P,).

    Differences much beyond `tolerance` (a share of the press) are taken for errors of the touch: Geman and McClure's
    kernel. `hold` (unitless) weighs the squared distance from where each pose was to begin with, `start` (K, 12) in the
    metric's space, against the touch's noise, so that noise does not move what the touch hardly shows.
    """

    pictures: Pictures
    wanted: Float32
    tolerance: float
    metric: PoseMetric
    start: Floats
    hold: float

    def run(self, T: Poses, most: int, settled: float) -> tuple[Poses, NDArray[np.bool_], NDArray[np.int64]]:
        """Return the poses, which of them have settled (K,), and the iterations (K,) of at most `most`.

        A pose has settled when it moves by less than `settled` steps, or no damping makes it better.
        """
        picture, T = self.pictures.of_poses(T.copy())
        still, iterations = np.zeros(len(T), bool), np.zeros(len(T), np.int64)
        damping = np.full(len(T), FIRST_DAMPING)
        for _ in range(most):
            k = np.flatnonzero(~still)
            if len(k) == 0:
                break
            T[k], picture[k], damping[k], moved = self._step(T[k], picture[k], damping[k], self.start[k])
            iterations[k] += 1
            still[k] = (moved < settled) | (damping[k] > MOST_DAMPING)
        return T, still, iterations

    def _step(
        self, T: Poses, picture: Float32, damping: Floats, start: Floats
    ) -> tuple[Poses, Float32, Floats, Floats]:
        """Poses, pictures and dampings after one iteration, and by how many steps (K,) each moved (inf: not at all)."""
        A, b, hold = self._normal_equations(T, picture, start)
        tried = damping[:, None] * DAMPINGS
        moves = _solve(A, b, tried) @ self.pictures.directions
        seen, there = self._draw(T, moves)
        cost = self._cost(seen, there, start[:, None], hold[:, None])
        best, k = cost.argmin(axis=1), np.arange(len(T))
        better = cost[k, best] < self._cost(picture, T, start, hold)
        T = np.where(better[:, None, None], there[k, best], T)
        picture = np.where(better[:, None], seen[k, best], picture)
        damping = np.where(better, np.maximum(tried[k, best], LEAST_DAMPING), STIFFER * damping)
        return T, picture, damping, np.where(better, np.abs(moves[k, best]).max(axis=1), np.inf)

    def _draw(self, T: Poses, moves: Floats) -> tuple[Float32, Poses]:
        """Pictures (K, M, P) of poses (K, 4, 4) after each of their moves (K, M, 6), and these poses (K, M, 4, 4)."""
        count, many = moves.shape[:2]
        seen, there = self.pictures.of_poses(self.pictures.moved(np.repeat(T, many, axis=0), moves.reshape(-1, 6)))
        return seen.reshape(count, many, -1), there.reshape(count, many, 4, 4)

    def _normal_equations(self, T: Poses, picture: Float32, start: Floats) -> tuple[Floats, Floats, Floats]:
        """A (K, D, D) and b (K, D) of Gauss-Newton's A move = -b, in steps, and the weight (K,) of the distance."""
        directions = self.pictures.directions
        both = np.broadcast_to(np.concatenate([directions, -directions]), (len(T), 2 * len(directions), 6))
        seen, there = self._draw(T, both)
        J, J_start = _central(seen), _central(self.metric.embed(there))
        r = picture - self.wanted
        w = 1.0 / (1.0 + (r / np.float32(self.tolerance)) ** 2) ** 2
        hold = self._hold(r, w, picture)
        JW = J * w[:, None]
        away = self.metric.embed(T) - start
        A = (JW @ J.swapaxes(1, 2)).astype(float) + hold[:, None, None] * (J_start @ J_start.swapaxes(1, 2))
        b = (JW @ r[..., None])[..., 0].astype(float) + hold[:, None] * (J_start @ away[..., None])[..., 0]
        return A, b, hold

    def _hold(self, r: Float32, w: Float32, picture: Float32) -> Floats:
        """The weight (K,), per square metre, of the distance from the start: `hold` times the noise's variance."""
        pressed = (np.maximum(picture, self.wanted) > SEEN).sum(axis=1)
        variance = (w * r * r).sum(axis=1) / np.maximum(pressed, 1)
        return np.asarray(self.hold * variance / self.pictures.pixel_m**2, float)

    def _cost(self, picture: Float32, T: Poses, start: Floats, hold: Floats) -> Floats:
        """What is minimised (...), of pictures (..., P) and their poses (..., 4, 4)."""
        squared = (picture - self.wanted) ** 2
        robust = (squared / (1.0 + squared / np.float32(self.tolerance**2))).sum(axis=-1)
        away = ((self.metric.embed(T) - start) ** 2).sum(axis=-1)
        return np.asarray(robust + hold * away, float)


def _central(both: NDArray[np.floating]) -> NDArray[np.floating]:
    """Central differences (K, D, ...) of what is (K, 2 D, ...) after steps ahead and steps back."""
    half = both.shape[1] // 2
    return 0.5 * (both[:, :half] - both[:, half:])


def _solve(A: Floats, b: Floats, dampings: Floats) -> Floats:
    """Moves (K, M, D), none farther than FARTHEST, of A (K, D, D) and b (K, D) at dampings (K, M)."""
    count = A.shape[1]
    ridge = np.trace(A, axis1=1, axis2=2)[:, None] / count * dampings + TINY
    damped = A[:, None] + ridge[..., None, None] * np.eye(count)
    moves = -np.linalg.solve(damped, b[:, None, :, None])[..., 0]
    longest = np.abs(moves).max(axis=-1, keepdims=True)
    return np.asarray(moves * np.minimum(1.0, FARTHEST / np.maximum(longest, FARTHEST)), float)
