"""Refinement of poses to several touches by a refiner of single touches.

Each touch refines the poses alone, and the results are combined by their information: see `estimates`. A touch alone
leaves some motions open, and there its result keeps the error of its start. So each touch refines the combined pose
again, until it stays or ROUNDS are done.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, invert
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.estimates import Estimates, PoseFusion
from tactile_loc.core.registration.joint_registration import ROUGHLY, scale
from tactile_loc.core.registration.observations import MILLI
from tactile_loc.core.sensing.scene import NATS_PER_IOU, Scene, View
from tactile_loc.core.sensing.touch import Touch

ROUNDS = 4  # most rounds; three bring ICP from 2 mm to some micrometres of the true pose of clean touches
SETTLED_M = 1e-5  # a pose that a round moves less is not refined again
STILL_M = 1e-9  # a pose that a round moves less has not moved
LEVER_M = 1e-2  # a rotation counts as the motion of a point at this distance from its axis
Alone = Sequence[Sequence[RefinedPose]]  # K refined poses for each of N touches, in the frame of its own sensor
RefineMany = Callable[[Touch, Sequence[Candidate], Scene], Sequence[RefinedPose]]


def alternate(
    views: Sequence[View], candidates: Sequence[Candidate], refine_many: RefineMany, prior: Prior | None = None
) -> list[RefinedPose]:
    """Refine K candidates, given as poses in the first sensor's frame, against N views, one touch at a time.

    `refine_many` refines candidates in the frame of a touch's own sensor against this touch: see `Refiner`. A pose that
    would explain the touches worse after refinement is returned unchanged and marked not converged. A `prior` over
    poses in the first sensor's frame decides where the touches leave a pose open. It does not count in the covariances.
    """
    if not candidates:
        return []
    T = np.stack([candidate.T_sensor_object for candidate in candidates])
    seen = np.stack([view.T_sensor_first @ T for view in views], axis=1)
    explained = _explain(views, seen)
    poses = [RefinedPose(one.copy(), float(iou), False, 0) for one, iou in zip(T, explained[0], strict=True)]
    left, steps = np.arange(len(T)), np.zeros(len(T), int)
    for _ in range(ROUNDS):
        alone = []
        for number, view in enumerate(views):
            starts = [replace(candidates[int(k)], T_sensor_object=seen[k, number]) for k in left]
            alone.append(refine_many(view.touch, starts, view.scene))
        found = _combine(views, T[left], alone, prior)
        good = found.explained[1] >= explained[1, left] - ROUGHLY
        moved_m = _measure_moves_m(T[left], found.T_reported)
        for n, k in enumerate(left.tolist()):
            own = [refined[n] for refined in alone]
            steps[k] += sum(one.iterations for one in own)
            if good[n]:
                settled = bool(found.explained[0, n] > 0 and any(one.converged for one in own))
                contact, imprint = found.explained[:, n].tolist()
                kept = poses[k].T_sensor_object if moved_m[n] < STILL_M else found.poses[n].T_sensor_object
                poses[k] = replace(
                    found.poses[n], T_sensor_object=kept, contact_iou=contact, imprint_iou=imprint, converged=settled
                )
        T[left[good]], seen[left[good]] = found.T_reported[good], found.seen[good]
        explained[:, left] = np.maximum(explained[:, left], found.explained)
        left = left[good & (moved_m > SETTLED_M)]
        if not len(left):
            break
    return [replace(pose, iterations=int(count)) for pose, count in zip(poses, steps, strict=True)]


@dataclass(frozen=True, eq=False)
class _Combined:
    """K combined poses, and how well they explain N touches.

    `T_reported` (K, 4, 4), metres, are the poses relative to the reported pose of the first sensor. `seen` (K, N, 4,
    4), metres, are in the frames of the sensors. `explained` (2, K) are the mean contact IoUs and imprint IoUs.
    """

    poses: list[RefinedPose]
    T_reported: Poses
    seen: Poses
    explained: Floats


def _combine(views: Sequence[View], T_first_object: Poses, alone: Alone, prior: Prior | None) -> _Combined:
    """Combine the results of each touch alone. A touch's own result is taken if it explains all touches far better.

    The combination starts at the poses (K, 4, 4), metres, in the first sensor's frame.
    """
    problem = PoseFusion.of(views, Estimates.of(views, alone))
    T_mm = problem.solve(T_first_object, prior)
    seen_mm, nats = problem.see(T_mm)
    T, seen = (scale(of, 1 / MILLI) for of in (T_mm, seen_mm))
    explained = _explain(views, seen)
    explained[1] -= nats.mean(axis=1) / NATS_PER_IOU
    found = _Combined(problem.describe(T_mm), T, seen, explained)
    doubted = np.flatnonzero(explained[1] < 1 - ROUGHLY)
    for view, refined in zip(views, alone, strict=True):
        own = np.array([refined[int(k)].T_sensor_object for k in doubted]).reshape(-1, 4, 4)
        own = invert(view.T_sensor_first) @ own
        own_seen = np.stack([other.T_sensor_first @ own for other in views], axis=1)
        fit = _explain(views, own_seen)
        for n, k in enumerate(doubted.tolist()):
            if fit[1, n] > explained[1, k] + ROUGHLY:
                found.poses[k] = RefinedPose(own[n].copy(), 0.0, False, 0)
                T[k], seen[k], explained[:, k] = own[n], own_seen[n], fit[:, n]
    return found


def _measure_moves_m(before: Poses, after: Poses) -> Floats:
    """Return how far poses (K, 4, 4) moved, metres; a rotation counts as the motion of a point at LEVER_M."""
    moves = np.abs(after - before)[:, :3]
    return np.asarray((moves * [LEVER_M, LEVER_M, LEVER_M, 1.0]).max(axis=(1, 2), initial=0.0))


def _explain(views: Sequence[View], T_sensors_object: Poses) -> Floats:
    """Return the mean contact IoUs and imprint IoUs (2, K), over N touches, of poses (K, N, 4, 4) in their frames."""
    if not len(T_sensors_object):
        return np.empty((2, 0))
    each = [view.scene.compare_imprints(T_sensors_object[:, n], view.touch)[:2] for n, view in enumerate(views)]
    return np.asarray(np.mean(each, axis=0))
