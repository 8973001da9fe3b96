"""Refined poses of the checks for refiners: how they are compared, and which mistakes explain a difference."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Poses, invert, make_transform
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.slots.refiner import Refiner
from tactile_loc.testing.contract import name_cause, require
from tactile_loc.testing.problems import PressedBlock

TOLERANCE_PX = 0.25  # allowed difference between equivalent problems, pixels of the sensing surface
LEFT_OVER = 0.8  # offsets of 0.7 to 1 mm must shrink to at most this share on average
LEAVES = 0.01  # poses whose error changes by less than this share are left where they were
EXPLAINS = 0.5  # a mistake explains an error if undoing it leaves at most this share of the error

Mend = Callable[[Poses, Poses], Poses]
# Mistakes, and what undoes them: from the returned pose T and the candidate's pose C to the pose that would be right.
WRONG_POSES: dict[str, Mend] = {
    "the rotation is transposed": lambda T, C: make_transform(T[:3, :3].T, T[:3, 3]),
    "the pose is inverted; return T_sensor_object": lambda T, C: invert(T),
    "the matrix is transposed, as for row vectors": lambda T, C: T.T,
    "the translation is in millimetres": lambda T, C: scale_step(T, 1e-3),
}
WRONG_MOTIONS: dict[str, Mend] = {
    "the motion turns the wrong way": lambda T, C: _reverse_turn(T @ invert(C)) @ C,
    "the motion is inverted; return motion @ T_sensor_object": lambda T, C: C @ invert(T) @ C,
    "the motion is on the object's side; return motion @ T_sensor_object": lambda T, C: invert(C) @ T @ C,
    "the motion's translation is in millimetres": lambda T, C: scale_step(T @ invert(C), 1e-3) @ C,
    "the step is in millimetres": lambda T, C: make_transform(T[:3, :3], C[:3, 3] + (T[:3, 3] - C[:3, 3]) / 1e3),
}


@dataclass(frozen=True, eq=False)
class Refined:
    """A candidate of a problem, and the result that a refiner returned for it."""

    problem: PressedBlock
    candidate: Candidate
    result: RefinedPose

    @classmethod
    def by(cls, refiner: Refiner, problem: PressedBlock, candidate: Candidate) -> Refined:
        """Refine a copy of the candidate. Raises ContractError unless the result has the form of a result."""
        return cls(problem, candidate, take(refiner.refine(problem.touch, copy_candidate(candidate), problem.scene)))

    @property
    def T(self) -> Poses:  # noqa: N802 - a transform's name
        """The refined pose (4, 4), metres."""
        return self.result.T_sensor_object

    @property
    def before_m(self) -> float:
        """The candidate's error, metres."""
        return self.problem.measure_error_m(self.candidate)

    def measure_m(self, T: Poses) -> float:
        """Return the error, metres, of a pose (4, 4)."""
        return measure_m(self.problem, T, self.problem.truth)

    def undo(self, mend: Mend) -> Poses:
        """Return the pose (4, 4) without a mistake."""
        return mend(self.T, self.candidate.T_sensor_object)


def take(result: RefinedPose) -> RefinedPose:
    """Return a result of `refine`. Raises ContractError unless it is a RefinedPose with one matrix."""
    require(isinstance(result, RefinedPose), f"refine must return a RefinedPose, not {type(result).__name__}")
    form = np.shape(result.T_sensor_object)
    require(form == (4, 4), f"the refined pose must have shape (4, 4), not {form}")
    return result


def copy_candidate(candidate: Candidate) -> Candidate:
    """Return a copy with its own memory, because a refiner may wrongly write to it."""
    return dataclasses.replace(candidate, T_sensor_object=candidate.T_sensor_object.copy())


def require_kept(one: Refined) -> None:
    """Raise ContractError unless a candidate at the true pose stays there, to TOLERANCE_PX."""
    pitch_m = one.problem.touch.geometry.pixel_pitch_m

    def explains(mend: Mend) -> bool:
        return one.measure_m(one.undo(mend)) <= TOLERANCE_PX * pitch_m

    moved_px = one.measure_m(one.T) / pitch_m
    often = (
        "its measure of fit is not best at the true pose, poses are rounded, or the candidate's contact is not cut "
        "like that of the touch"
    )
    require(
        moved_px <= TOLERANCE_PX,
        f"the true pose must stay; it moved by {moved_px:.2g} pixels",
        lambda: name_cause(WRONG_POSES, explains, often),
    )


def require_related(plain: Refined, other: Refined, back: Callable[[Poses], Poses], sentence: str, often: str) -> None:
    """Raise ContractError unless `back` turns the other answer into the plain answer, to TOLERANCE_PX."""

    def apart_px(T: Poses, T_other: Poses) -> float:
        return measure_m(plain.problem, T, back(T_other)) / plain.problem.touch.geometry.pixel_pitch_m

    def explains(mend: Mend) -> bool:
        T = plain.undo(mend)
        near = plain.measure_m(T) <= min(LEFT_OVER * plain.before_m, EXPLAINS * plain.measure_m(plain.T))
        return near and apart_px(T, other.undo(mend)) <= TOLERANCE_PX

    apart = apart_px(plain.T, other.T)
    require(
        apart <= TOLERANCE_PX,
        f"{sentence}; the answers are {apart:.3g} pixels apart, allowed {TOLERANCE_PX:g}",
        lambda: name_cause({**WRONG_POSES, **WRONG_MOTIONS}, explains, often),
    )


def require_shrunk(tried: Sequence[Refined], share: float, sentence: str) -> None:
    """Raise ContractError unless refinement leaves at most this share of the candidates' mean error."""
    before_m, after_m = np.mean([one.before_m for one in tried]), np.mean([one.measure_m(one.T) for one in tried])

    def explains(mend: Mend) -> bool:
        left_m = np.mean([one.measure_m(one.undo(mend)) for one in tried])
        return bool(left_m <= min(LEFT_OVER * before_m, EXPLAINS * after_m))

    leaves = abs(after_m - before_m) <= LEAVES * before_m
    small = "a step or a limit of distances is too small; a refiner that leaves poses declares refines=False"
    require(
        after_m <= share * before_m,
        f"{sentence}; their mean error went from {before_m * 1e3:.2f} to {after_m * 1e3:.2f} mm",
        lambda: name_cause(
            {**WRONG_POSES, **WRONG_MOTIONS},
            explains,
            small if leaves else "points are paired wrongly, or a rotation is about a wrong centre",
        ),
    )


def require_same(plain: Refined, again: Refined, other: RefinedPose, sentence: str, tolerance_px: float) -> None:
    """Raise ContractError unless another result has the plain pose, to a tolerance. `again` repeats `plain`."""
    pitch_m = plain.problem.touch.geometry.pixel_pitch_m
    apart_px, noise_px = (measure_m(plain.problem, plain.T, T) / pitch_m for T in (other.T_sensor_object, again.T))
    require(
        apart_px <= tolerance_px,
        f"{sentence}; the answers are {apart_px:.3g} pixels apart, allowed {tolerance_px:g}",
        name_cause({"the same candidate gives another pose each time": noise_px > tolerance_px}),
    )


def measure_m(problem: PressedBlock, T: Poses, other: Poses) -> float:
    """Return the root mean square distance, metres, of the object's surface points at two poses (4, 4)."""
    return float(PoseMetric(problem.scene.object).distance(T, other))


def scale_step(motion: Poses, factor: float) -> Poses:
    """Return a motion (4, 4) whose translation is multiplied by a factor."""
    return make_transform(motion[:3, :3], factor * motion[:3, 3])


def _reverse_turn(motion: Poses) -> Poses:
    return make_transform(motion[:3, :3].T, motion[:3, 3])
