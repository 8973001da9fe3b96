"""Errors of poses in metres of object surface: ADD, MSSD and ADD-S, each the least over the object's symmetries.

ADD is the mean distance of surface points (Hinterstoisser et al., ACCV 2012), MSSD the largest distance (Hodan et al.,
ECCV 2020). ADD-S is the mean distance to the nearest surface point, which ignores all differences of similar views.

About a continuous axis of symmetry, the best roll theta is searched. A surface point's squared distance is a sinusoid
of the roll, a + b cos(theta) + c sin(theta). The minimum of the mean of these squares has a closed form. Weiszfeld's
iteration minimizes the mean distance, ADD: in each round, it minimizes the mean of squares, each weighted by one over
the previous distance.

The largest distance, MSSD, has kinks and several minima. In an interval of rolls, its lower bound is the largest of the
sinusoids' minima. Intervals that could contain a better roll are halved, until none could be better by PRECISION_M.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, rotation_about, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric

TRIED_ROLLS, ROLL_POINTS = 64, 300  # rolls and points that are tried to find a start near the least mean distance
ROUNDS_FEW, ROUNDS_ALL = 12, 3  # rounds of Weiszfeld's iteration, with few points and with all points
COINCIDENT_M = 1e-9  # smaller distances count as this distance
PRECISION_M, INTERVALS = 1e-7, 24  # precision of the largest distance; first number of intervals

Array = NDArray[np.float64]
FEW_SYMMETRIES = 8  # up to this number of symmetries, all are measured with all points
ALIKE = 1.25  # symmetries are tried up to this multiple of the least root mean square distance
TRIED, TRIED_POINTS, MEASURED = 24, 300, 2  # of many symmetries: tried ones, points per try, fully measured ones
AT_ONCE = 32  # transforms applied to all points at once

Points = NDArray[np.float64]


def compute_adds(obj: ObjectModel, points_m: Points, T_estimates: Poses, T_true: Poses) -> NDArray[np.float64]:
    """Return ADD (K,), metres, of estimates (K, 4, 4): the least over the poses symmetric to the true pose (4, 4).

    If there are many symmetries, some with a small root mean square distance are selected. These symmetries are tried
    with a few of the points (P, 3), and the best are measured with all points. For a continuous axis, the best roll is
    searched. All points of a sphere move as its centre does.
    """
    if obj.symmetry.is_sphere:
        return PoseMetric(obj).symmetric_distance(T_estimates, T_true[None])
    if obj.symmetry.continuous_axis is not None:
        return np.array([find_least_mean(obj, points_m, T, T_true) for T in T_estimates])
    same = T_true @ obj.symmetry.list_elements()
    chosen = np.broadcast_to(np.arange(len(same)), (len(T_estimates), len(same)))
    if len(same) > FEW_SYMMETRIES:
        chosen = _choose_alike(_measure_rms(obj, T_estimates, same))
        few = points_m[:: max(1, len(points_m) // TRIED_POINTS)]
        best = np.argsort(_average_distances(few, T_estimates[:, None] - same[chosen]), axis=1)[:, :MEASURED]
        chosen = np.take_along_axis(chosen, best, axis=1)
    return _average_distances(points_m, T_estimates[:, None] - same[chosen]).min(axis=1)


def compute_mssd(obj: ObjectModel, corners_m: Points, T_estimates: Poses, T_true: Poses) -> NDArray[np.float64]:
    """Return MSSD (K,), metres: the largest surface distance between estimates (K, 4, 4) and the true pose (4, 4).

    MSSD is exact if `corners_m` (V, 3) are the hull's (`TriangleMesh.hull_corners_m`), since the distance is a convex
    function of the point. Symmetries are tried in order of root mean square distance, which is a lower bound of the
    largest distance. So no better symmetry is left out. For a continuous axis, the best roll is searched. All points of
    a sphere move as its centre does.
    """
    if obj.symmetry.is_sphere:
        return PoseMetric(obj).symmetric_distance(T_estimates, T_true[None])
    if obj.symmetry.continuous_axis is not None:
        return np.array([find_least_largest(obj, corners_m, T, T_true) for T in T_estimates])
    same = T_true @ obj.symmetry.list_elements()
    rms = _measure_rms(obj, T_estimates, same)
    return np.array([_find_least_largest(corners_m, T - same, r) for T, r in zip(T_estimates, rms, strict=True)])


def compute_add_s(points_m: Points, T_estimates: Poses, T_true: Poses, every: int = 1) -> NDArray[np.float64]:
    """Return ADD-S (ADI) (K,), metres, of estimates (K, 4, 4) and the true pose (4, 4).

    This is the mean distance from object points (P, 3) at the true pose to the nearest point at the estimate. The mean
    is over every `every`-th point, but any point can be the nearest.
    """
    from scipy.spatial import cKDTree

    tree, asked = cKDTree(points_m), points_m[::every]  # in the object's frame
    return np.array([tree.query(transform_points(np.linalg.solve(T, T_true), asked))[0].mean() for T in T_estimates])


def _measure_rms(obj: ObjectModel, T_estimates: Poses, same: Poses) -> NDArray[np.float64]:
    """Return the root mean square surface distances (K, E), metres, between estimates (K, 4, 4) and poses (E, 4, 4)."""
    from scipy.spatial.distance import cdist

    metric = PoseMetric(obj)
    distances: NDArray[np.float64] = cdist(metric.embed(T_estimates), metric.embed(same))
    return distances


def _choose_alike(rms_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Choose TRIED of the E symmetries for each estimate, spread evenly over those near the least distance."""
    order = np.argsort(rms_m, axis=1)
    least = np.take_along_axis(rms_m, order[:, :1], axis=1)
    count = (rms_m <= ALIKE * least).sum(axis=1)
    steps = np.linspace(0.0, 1.0, TRIED)[None] * (count[:, None] - 1)
    return np.take_along_axis(order, steps.astype(np.int64), axis=1)


def _measure_distances(points_m: Points, difference: Poses) -> NDArray[np.float64]:
    """Return the distances (D, P), metres, of points (P, 3) between poses whose matrices differ by (D, 4, 4)."""
    moved = difference[:, :3, :3] @ points_m.T + difference[:, :3, 3:]
    return np.sqrt(np.einsum("dip,dip->dp", moved, moved))


def _average_distances(points_m: Points, difference: Poses) -> NDArray[np.float64]:
    """Return mean distances (...,), metres, of points (P, 3) between poses whose matrices differ by (..., 4, 4)."""
    flat = difference.reshape(-1, 4, 4)
    means = [_measure_distances(points_m, flat[i : i + AT_ONCE]).mean(axis=1) for i in range(0, len(flat), AT_ONCE)]
    return np.concatenate(means).reshape(difference.shape[:-2])


def _find_least_largest(corners_m: Points, difference: Poses, rms_m: NDArray[np.float64]) -> float:
    """Return the least, over E differences of poses (E, 4, 4), of the largest distance of any corner (V, 3), metres."""
    order = np.argsort(rms_m)
    least = np.inf
    for start in range(0, len(order), AT_ONCE):
        some = order[start : start + AT_ONCE]
        if rms_m[some[0]] >= least:
            break
        least = min(least, float(_measure_distances(corners_m, difference[some]).max(axis=1).min()))
    return least


def find_least_mean(obj: ObjectModel, points_m: Array, T_estimate: Poses, T_true: Poses) -> float:
    """Return the least mean distance, metres, of points (P, 3) between a pose (4, 4) and the rolled true pose (4, 4).

    The least is over all rolls about the object's continuous axis of symmetry.
    """
    few_m = points_m[:: max(1, len(points_m) // ROLL_POINTS)]
    few = [_fit_sinusoids(obj, few_m, T_estimate, T_true @ S) for S in _list_flips(obj)]
    evenly = np.linspace(0.0, 2 * np.pi, TRIED_ROLLS, endpoint=False)
    tried = [np.append(evenly, _find_lowest(f.mean(axis=0))) for f in few]
    means_m = np.stack([_measure_rolled(f, rolls).mean(axis=1) for f, rolls in zip(few, tried, strict=True)])
    best, place = np.unravel_index(int(means_m.argmin()), means_m.shape)
    every = _fit_sinusoids(obj, points_m, T_estimate, T_true @ _list_flips(obj)[best])
    roll = _iterate_weiszfeld(every, _iterate_weiszfeld(few[best], tried[best][place], ROUNDS_FEW), ROUNDS_ALL)
    return float(_measure_rolled(every, roll).mean())


def find_least_largest(obj: ObjectModel, corners_m: Array, T_estimate: Poses, T_true: Poses) -> float:
    """Return the least largest distance, metres, of points (P, 3) between a pose and the rolled true pose (4, 4).

    The least is over all rolls about the object's continuous axis of symmetry. The result is exact to PRECISION_M.
    """
    flips = [_fit_sinusoids(obj, corners_m, T_estimate, T_true @ S) for S in _list_flips(obj)]
    best_m = min(float(_measure_rolled(s, _find_lowest(s.mean(axis=0))).max()) for s in flips)
    for sinusoids in flips:
        half = float(np.pi) / INTERVALS
        middles: Array = (2 * np.arange(INTERVALS, dtype=np.float64) + 1) * half
        while len(middles):
            best_m = min(best_m, float(_measure_rolled(sinusoids, middles).max(axis=1).min()))
            hopeful = _bound_distances(sinusoids, middles, half).max(axis=1) < best_m - PRECISION_M
            half /= 2
            middles = (middles[hopeful, None] + np.array([-half, half])).ravel()
    return best_m


def _list_flips(obj: ObjectModel) -> Poses:
    """Return the symmetry's elements (F, 4, 4) without rolls: the identity, and perhaps half a turn across the axis."""
    return obj.symmetry.list_elements(np.pi)[::2]


def _fit_sinusoids(obj: ObjectModel, points_m: Array, T_estimate: Poses, T_true: Poses) -> Array:
    """Return the sinusoids (P, 3), a, b and c, m^2, of the squared distances of points (P, 3) between poses (4, 4)."""
    axis = np.asarray(obj.symmetry.continuous_axis)
    offset = points_m - obj.symmetry.centre_m
    along = (offset @ axis)[:, None] * axis
    R = T_true[:3, :3]
    fixed = transform_points(T_estimate, points_m) - transform_points(T_true, obj.symmetry.centre_m + along)
    cosine, sine = (offset - along) @ R.T, offset @ (R @ rotation_about(axis, np.pi / 2) - R @ np.outer(axis, axis)).T
    constant = np.einsum("pi,pi->p", fixed, fixed) + np.einsum("pi,pi->p", cosine, cosine)
    return np.column_stack([constant, *(-2 * np.einsum("pi,pi->p", fixed, wave) for wave in (cosine, sine))])


def _find_lowest(sinusoids: Array) -> Array:
    """Return the rolls (...,), radians, at the minima of sinusoids (..., 3)."""
    return np.asarray(np.arctan2(-sinusoids[..., 2], -sinusoids[..., 1]))


def _measure_rolled(sinusoids: Array, rolls: Array | float) -> Array:
    """Return the distances (..., P), metres, whose squares are sinusoids (P, 3), at rolls (...,), radians."""
    waves = np.stack([np.ones_like(rolls), np.cos(rolls), np.sin(rolls)], axis=-1)
    return np.sqrt(np.maximum(waves @ sinusoids.T, 0.0))


def _bound_distances(sinusoids: Array, middles: Array, half: float) -> Array:
    """Return the least distances (I, P), metres, at rolls within `half` of `middles` (I,), radians."""
    ends = np.minimum(_measure_rolled(sinusoids, middles - half), _measure_rolled(sinusoids, middles + half))
    lowest = sinusoids[:, 0] - np.hypot(sinusoids[:, 1], sinusoids[:, 2])
    off = (_find_lowest(sinusoids) - middles[:, None] + np.pi) % (2 * np.pi) - np.pi
    return np.where(np.abs(off) < half, np.sqrt(np.maximum(lowest, 0.0)), ends)


def _iterate_weiszfeld(sinusoids: Array, roll: Array | float, rounds: int) -> Array | float:
    """Return the roll, radians, after `rounds` of Weiszfeld's iteration for the mean distance.

    `sinusoids` (P, 3) are the squared distances.
    """
    for _ in range(rounds):
        roll = _find_lowest((1.0 / np.maximum(_measure_rolled(sinusoids, roll), COINCIDENT_M)) @ sinusoids)
    return roll
