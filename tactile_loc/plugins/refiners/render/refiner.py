"""Render and compare: moves a pose until its rendered picture matches the touch.

Registration compares touch and object only where both are in contact. Here, every pixel counts, including pixels
without contact. Pictures are drawn exactly, triangle by triangle, not by the scene's renderer. With a renderer whose
edges are inexact, the cost would have steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat

from tactile_loc.plugin import Candidate, ComponentOptions, Poses, RefinedPose, Refiner, Scene, Touch
from tactile_loc.plugin.helpers import PoseMetric
from tactile_loc.plugins.refiners.render.pictures import Float32, Floats, Pictures, keep_within_reach

DAMPINGS = np.array([0.1, 1.0, 10.0])  # factors of the last good damping to try
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-4, 30.0
STIFFER = 30.0  # factor of the damping when no tried damping lowers the cost
FARTHEST = 4.0  # largest move in an iteration, steps
TINY = 1e-9  # least curvature: keeps directions without information in place
SEEN = 0.02  # least indentation of a pressed pixel, share of the press depth


@dataclass(frozen=True, eq=False)
class Descent:
    """Moves poses (K, 4, 4), metres, until their pictures match `wanted` (P,), the picture of the touch.

    Differences much larger than `tolerance`, a share of the press depth, hardly count (Geman and McClure's kernel).
    They are taken as errors of the touch. `start` (K, 12) are the start poses in the metric's space. `hold` (unitless)
    is the weight of the squared distance from the start, relative to the touch's noise. This term prevents noise from
    moving a pose along directions that the touch hardly determines.
    """

    pictures: Pictures
    wanted: Float32
    tolerance: float
    metric: PoseMetric
    start: Floats
    hold: float

    def run(self, T: Poses, most: int, settled: float) -> tuple[Poses, NDArray[np.bool_], NDArray[np.int64]]:
        """Return the poses, whether each converged (K,), and the iterations (K,) of at most `most`.

        A pose has converged when it moves by less than `settled` steps, or when no damping improves it.
        """
        picture, T = self.pictures.draw_poses(T.copy())
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
        """Do one iteration. Return the new poses, pictures and dampings, and the moves (K,) in steps.

        The move is inf for a pose that no damping improved.
        """
        A, b, hold = self._build_equations(T, picture, start)
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
        """Return pictures (K, M, P) of poses (K, 4, 4) after their moves (K, M, 6), and these poses (K, M, 4, 4)."""
        count, many = moves.shape[:2]
        seen, there = self.pictures.draw_poses(self.pictures.move(np.repeat(T, many, axis=0), moves.reshape(-1, 6)))
        return seen.reshape(count, many, -1), there.reshape(count, many, 4, 4)

    def _build_equations(self, T: Poses, picture: Float32, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Return A (K, D, D) and b (K, D) of the Gauss-Newton equations A move = -b, and the distance weights (K,).

        Moves are in steps.
        """
        directions = self.pictures.directions
        both = np.broadcast_to(np.concatenate([directions, -directions]), (len(T), 2 * len(directions), 6))
        seen, there = self._draw(T, both)
        J, J_start = _difference_centrally(seen), _difference_centrally(self.metric.embed(there))
        r = picture - self.wanted
        w = 1.0 / (1.0 + (r / np.float32(self.tolerance)) ** 2) ** 2
        hold = self._hold(r, w, picture)
        JW = J * w[:, None]
        away = self.metric.embed(T) - start
        A = (JW @ J.swapaxes(1, 2)).astype(float) + hold[:, None, None] * (J_start @ J_start.swapaxes(1, 2))
        b = (JW @ r[..., None])[..., 0].astype(float) + hold[:, None] * (J_start @ away[..., None])[..., 0]
        return A, b, hold

    def _hold(self, r: Float32, w: Float32, picture: Float32) -> Floats:
        """Return the weights (K,), per m^2, of the squared distance from the start: `hold` times the noise variance."""
        pressed = (np.maximum(picture, self.wanted) > SEEN).sum(axis=1)
        variance = (w * r * r).sum(axis=1) / np.maximum(pressed, 1)
        return np.asarray(self.hold * variance / self.pictures.pixel_m**2, float)

    def _cost(self, picture: Float32, T: Poses, start: Floats, hold: Floats) -> Floats:
        """Return the cost (...) of pictures (..., P) and their poses (..., 4, 4)."""
        squared = (picture - self.wanted) ** 2
        robust = (squared / (1.0 + squared / np.float32(self.tolerance**2))).sum(axis=-1)
        away = ((self.metric.embed(T) - start) ** 2).sum(axis=-1)
        return np.asarray(robust + hold * away, float)


def _difference_centrally(both: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return central differences (K, D, ...) of values (K, 2 D, ...) after steps forward and steps back."""
    half = both.shape[1] // 2
    return 0.5 * (both[:, :half] - both[:, half:])


def _solve(A: Floats, b: Floats, dampings: Floats) -> Floats:
    """Return the moves (K, M, D) that solve A move = -b with dampings (K, M), for A (K, D, D) and b (K, D).

    Moves are limited to FARTHEST steps.
    """
    count = A.shape[1]
    ridge = np.trace(A, axis1=1, axis2=2)[:, None] / count * dampings + TINY
    damped = A[:, None] + ridge[..., None, None] * np.eye(count)
    moves = -np.linalg.solve(damped, b[:, None, :, None])[..., 0]
    longest = np.abs(moves).max(axis=-1, keepdims=True)
    return np.asarray(moves * np.minimum(1.0, FARTHEST / np.maximum(longest, FARTHEST)), float)


ON_THE_WAY, SETTLED = 0.25, 0.1  # largest move at convergence, steps: before the last descent, and in the last descent
BLURRED_TOLERANCE = 0.25  # increase of the tolerance per mm of blur
ROUGHLY = 0.02  # loss of contact IoU that is within the error of counting pixels
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]


class RenderRefiner(Refiner):
    """Compares blurred pictures first, which have a wide basin of attraction, and sharp pictures last.

    z is free until the last descent, in which z follows from contact. If z follows from contact, the cost has folds,
    because the point that touches first jumps when the object tilts.
    """

    class Options(ComponentOptions):
        """Sharpness of the pictures, and tolerance to errors of the touch."""

        image_px: int = Field(default=200, ge=16, description="approximate longer image side after thinning, pixels")
        widths_mm: tuple[NonNegativeFloat, ...] = Field(
            default=(1.5, 0.5, 0.0), min_length=1, description="blur (standard deviation) of each descent, mm"
        )
        tolerance: float = Field(
            default=0.1, gt=0, description="difference of indentation beyond which a pixel hardly counts, press shares"
        )
        max_iterations: int = Field(default=8, ge=1, description="most iterations in each descent")
        patch_mm: float = Field(
            default=3.0, ge=0, description="correlation length of the touch's errors, mm; 0 ignores noise"
        )
        spread_mm: float = Field(default=2.0, gt=0, description="usual error of candidates, mm")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the pose (4, 4), metres, near the candidate's pose whose picture matches the touch best.

        The candidate's own pose is returned if it explains the touch better than the refined pose.
        """
        return self.refine_many(touch, [candidate], scene)[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine all candidates of one touch together, each as `refine` does."""
        if len(candidates) == 0:
            return []
        before = np.stack([candidate.T_sensor_object for candidate in candidates])
        start, touching = Scene(scene.object, touch.geometry, scene.renderer).bring_to_contact(before)
        after, settled, iterations = before.copy(), np.zeros(len(before), bool), np.zeros(len(before), np.int64)
        if touching.any():
            found = self._descend(touch, start[touching], scene)
            after[touching], settled[touching], iterations[touching] = found
        return self._choose_better(touch, scene, before, after, settled, iterations)

    def _choose_better(
        self, touch: Touch, scene: Scene, before: Poses, after: Poses, settled: Flags, iterations: Counts
    ) -> list[RefinedPose]:
        """Return, for each candidate, the better of its poses before and after refinement (K, 4, 4)."""
        scores = [scene.compare_imprints(T, touch) for T in (before, after)]
        contact, imprint = (np.stack([one[k] for one in scores]) for k in (0, 1))
        good = (imprint[1] >= imprint[0]) & (contact[1] >= contact[0] - ROUGHLY)
        T = np.where(good[:, None, None], after, before)
        contact_iou = np.where(good, contact[1], contact[0])
        rows = zip(T, contact_iou, good & settled, iterations, strict=True)
        return [RefinedPose(pose.copy(), float(fit), bool(ok), int(count)) for pose, fit, ok, count in rows]

    def _descend(self, touch: Touch, T: Poses, scene: Scene) -> tuple[Poses, Flags, Counts]:
        """Return the poses (K, 4, 4) after all descents, whether each converged (K,), and the total iterations (K,)."""
        options, metric = self.options, PoseMetric(scene.object)
        geometry, wanted = touch.thin(options.image_px)
        still, iterations = np.zeros(len(T), bool), np.zeros(len(T), np.int64)
        if not (wanted.contact & geometry.observed_mask).any():
            return T, still, iterations
        mesh = keep_within_reach(scene.object.mesh, geometry, T)
        start, hold = metric.embed(T), (options.patch_mm / options.spread_mm) ** 2
        for number, width_mm in enumerate(options.widths_mm, start=1):
            last = number == len(options.widths_mm)
            pictures = Pictures.blurred(mesh, geometry, wanted, width_mm * 1e-3, last)
            tolerance = options.tolerance + BLURRED_TOLERANCE * width_mm
            descent = Descent(pictures, pictures.draw_touch(), tolerance, metric, start, hold)
            T, still, done = descent.run(T, options.max_iterations, SETTLED if last else ON_THE_WAY)
            iterations += done
        return T, still, iterations
