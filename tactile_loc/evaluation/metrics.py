"""How far an estimated pose is from the true one, in metres of object surface.

All regard symmetry: a pose is compared with every pose that looks the same as the true one. ADD is the mean distance
of surface points (Hinterstoisser et al., ACCV 2012), MSSD the largest (Hodan et al., ECCV 2020), ADD-S the mean
distance to whichever surface point is nearest, which forgives all that looks alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, rotation_angle, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.evaluation.rolls import least_largest, least_mean

FEW_SYMMETRIES = 8  # up to which all are measured with all points
ALIKE = 1.25  # of the least root mean square distance: symmetries within it may have the least mean distance
TRIED, TRIED_POINTS, MEASURED = 24, 300, 2  # of many symmetries: tried with few points, measured with all
AT_ONCE = 32  # transforms applied to all points at once

Points = NDArray[np.float64]


def add(points_m: Points, T1: Poses, T2: Poses) -> NDArray[np.float64]:
    """Mean distance (...,) in metres between object points (P, 3) at poses T1 and T2 (..., 4, 4): ADD.

    Symmetry is not regarded.
    """
    return np.linalg.norm(transform_points(T1, points_m) - transform_points(T2, points_m), axis=-1).mean(axis=-1)


def symmetric_add(obj: ObjectModel, points_m: Points, T_estimate: Poses, T_true: Poses) -> float:
    """ADD in metres of one estimate (4, 4), the least over the true poses (4, 4) that look the same by symmetry."""
    return float(symmetric_adds(obj, points_m, T_estimate[None], T_true)[0])


def symmetric_adds(obj: ObjectModel, points_m: Points, T_estimates: Poses, T_true: Poses) -> NDArray[np.float64]:
    """ADD (K,) in metres of estimates (K, 4, 4), each the least over the true poses (4, 4) that look the same.

    Of many symmetries, those near the least root mean square distance, which is cheap, are tried with few of the points
    (P, 3), and the best of them measured with all; a continuous axis is searched for the best roll.
    """
    if obj.symmetry.continuous_axis is not None:
        return np.array([least_mean(obj, points_m, T, T_true) for T in T_estimates])
    same = T_true @ obj.symmetry.elements()
    chosen = np.broadcast_to(np.arange(len(same)), (len(T_estimates), len(same)))
    if len(same) > FEW_SYMMETRIES:
        chosen = _alike(_rms(obj, T_estimates, same))
        few = points_m[:: max(1, len(points_m) // TRIED_POINTS)]
        best = np.argsort(_mean_distances(few, T_estimates[:, None] - same[chosen]), axis=1)[:, :MEASURED]
        chosen = np.take_along_axis(chosen, best, axis=1)
    return _mean_distances(points_m, T_estimates[:, None] - same[chosen]).min(axis=1)


def pose_differences(
    obj: ObjectModel, T_estimates: Poses, T_true: Poses
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far off the centroid (K,), metres, and the rotation (K,), radians, of estimates (K, 4, 4) are.

    They are compared with whichever pose looks like the true one (K, 4, 4) and is nearest, root mean square distance of
    the surface.
    """
    nearest = PoseMetric(obj).nearest_equivalents(T_true, T_estimates)
    centroids_m = (nearest - T_estimates)[:, :3] @ [*obj.mesh.centroid_m, 1.0]
    turned = rotation_angle(nearest[:, :3, :3] @ np.swapaxes(T_estimates[:, :3, :3], 1, 2))
    return np.linalg.norm(centroids_m, axis=-1), turned


def mssd(obj: ObjectModel, corners_m: Points, T_estimates: Poses, T_true: Poses) -> NDArray[np.float64]:
    """Largest distance (K,) in metres of surface at estimates (K, 4, 4) from the true pose (4, 4): MSSD.

    Exact over the whole surface when `corners_m` (V, 3) are its hull's (`TriangleMesh.hull_corners_m`): the distance is
    a convex function of the point. Symmetries are tried by rising root mean square distance, which bounds the largest
    from below, so that none that could be better is left out; rolls about a continuous axis likewise.
    """
    if obj.symmetry.continuous_axis is not None:
        return np.array([least_largest(obj, corners_m, T, T_true) for T in T_estimates])
    same = T_true @ obj.symmetry.elements()
    rms = _rms(obj, T_estimates, same)
    return np.array([_least_largest(corners_m, T - same, r) for T, r in zip(T_estimates, rms, strict=True)])


def add_s(points_m: Points, T_estimates: Poses, T_true: Poses, every: int = 1) -> NDArray[np.float64]:
    """Mean distance (K,) in metres from object points (P, 3) at the true pose (4, 4) to the nearest of them at the
    estimates (K, 4, 4): ADD-S, also called ADI. The mean is over every `every`-th point, the nearest is of all."""
    from scipy.spatial import cKDTree

    tree, asked = cKDTree(points_m), points_m[::every]  # in the object's frame: rigid motions keep distances
    return np.array([tree.query(transform_points(np.linalg.solve(T, T_true), asked))[0].mean() for T in T_estimates])


def _rms(obj: ObjectModel, T_estimates: Poses, same: Poses) -> NDArray[np.float64]:
    """Root mean square distance (K, E) of surface between estimates (K, 4, 4) and poses (E, 4, 4), metres."""
    from scipy.spatial.distance import cdist

    metric = PoseMetric(obj)
    distances: NDArray[np.float64] = cdist(metric.embed(T_estimates), metric.embed(same))
    return distances


def _alike(rms_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Choose TRIED of the symmetries (K, E) of each estimate, evenly among those near the least distance."""
    order = np.argsort(rms_m, axis=1)
    least = np.take_along_axis(rms_m, order[:, :1], axis=1)
    count = (rms_m <= ALIKE * least).sum(axis=1)
    steps = np.linspace(0.0, 1.0, TRIED)[None] * (count[:, None] - 1)
    return np.take_along_axis(order, steps.astype(np.int64), axis=1)


def _distances(points_m: Points, difference: Poses) -> NDArray[np.float64]:
    """How far points (P, 3) move, (D, P) metres, between poses whose matrices differ by (D, 4, 4)."""
    moved = difference[:, :3, :3] @ points_m.T + difference[:, :3, 3:]
    return np.sqrt(np.einsum("dip,dip->dp", moved, moved))


def _mean_distances(points_m: Points, difference: Poses) -> NDArray[np.float64]:
    """The mean (...,) of the distances that differences of poses (..., 4, 4) move points (P, 3) by, metres."""
    flat = difference.reshape(-1, 4, 4)
    means = [_distances(points_m, flat[i : i + AT_ONCE]).mean(axis=1) for i in range(0, len(flat), AT_ONCE)]
    return np.concatenate(means).reshape(difference.shape[:-2])


def _least_largest(corners_m: Points, difference: Poses, rms_m: NDArray[np.float64]) -> float:
    """The least over differences of poses (E, 4, 4) of the largest distance they move a corner (V, 3) by, metres."""
    order = np.argsort(rms_m)
    least = np.inf
    for start in range(0, len(order), AT_ONCE):
        some = order[start : start + AT_ONCE]
        if rms_m[some[0]] >= least:
            break
        least = min(least, float(_distances(corners_m, difference[some]).max(axis=1).min()))
    return least
