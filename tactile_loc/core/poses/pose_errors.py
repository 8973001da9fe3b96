"""Errors of poses, in metres. The pose error, MSSD, is the one distance of verdicts, tolerances and tables.

The pose error is the largest displacement of any surface point between two poses, the least over the object's
symmetries (MSSD; Hodan et al., ECCV 2020). The displacement is a convex function of the point, so a corner of the
convex hull has the largest one. ADD is the mean displacement (Hinterstoisser et al., ACCV 2012). ADD-S is the mean
distance to the nearest surface point, which ignores all differences of similar views.

About a continuous axis of symmetry, the best roll theta is searched. A surface point's squared displacement is a
sinusoid of the roll, a + b cos(theta) + c sin(theta). The minimum of the mean of these squares has a closed form.
Weiszfeld's iteration minimizes the mean displacement, ADD: in each round, it minimizes the mean of squares, each
weighted by one over the previous displacement.

The largest displacement has kinks and several minima. In an interval of rolls, its lower bound is the largest of the
sinusoids' minima. Intervals that could contain a better roll are halved, until none could be better by PRECISION_M.
"""

import math

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.compiled import njit, run_in_threads

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

RIGHT_M = 1e-3  # poses with pose errors up to this are right, if no other tolerance is given
TRIED_ROLLS, ROLL_POINTS = 64, 300  # rolls and points that are tried to find a start near the least mean distance
ROUNDS_FEW, ROUNDS_ALL = 12, 3  # rounds of Weiszfeld's iteration, with few points and with all points
COINCIDENT_M = 1e-9  # smaller distances count as this distance
PRECISION_M, INTERVALS = 1e-7, 24  # precision of the pose error; first number of intervals of rolls
HALVINGS = 60  # most halvings of one interval

FEW_SYMMETRIES = 8  # up to this number of symmetries, all are measured with all points
ALIKE = 1.25  # symmetries are tried up to this multiple of the least root mean square distance
TRIED, TRIED_POINTS, MEASURED = 24, 300, 2  # of many symmetries: tried ones, points per try, fully measured ones
AT_ONCE = 32  # transforms applied to all points at once


def compute_adds(obj: ObjectModel, points_m: Floats, T_estimates: Poses, T_true: Poses) -> Floats:
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


def measure_pose_errors(
    obj: ObjectModel, T: Poses, T_other: Poses, points_m: Floats | None = None, limit_m: float = 0.0
) -> Floats:
    """Return the pose errors (K,), metres, between poses T (K, 4, 4) and T_other, (K, 4, 4) or (4, 4).

    With `points_m` (P, 3), metres, in the object's frame, only these points count, not the whole surface. A positive
    `limit_m` saves time: an error is then only right in that it is or is not above `limit_m` metres.
    """
    T = np.ascontiguousarray(T, np.float64)
    others = np.ascontiguousarray(np.broadcast_to(T_other, T.shape), np.float64)
    corners_m = np.ascontiguousarray(obj.mesh.hull_corners_m if points_m is None else points_m, np.float64)
    symmetry, errors_m = obj.symmetry, np.empty(len(T))
    if symmetry.is_sphere:
        centre_m = symmetry.centre_m[None]
        return np.linalg.norm(transform_points(T, centre_m) - transform_points(others, centre_m), axis=-1)[:, 0]
    if symmetry.continuous_axis is None:
        same = np.ascontiguousarray(symmetry.list_elements())
        run_in_threads(_fill_errors, len(T), (T, others, same), corners_m, limit_m, errors_m)
        return errors_m
    flipped = np.ascontiguousarray(others[:, None] @ _list_flips(obj))
    run_in_threads(_fill_rolled_errors, len(T), (T, flipped), _find_frame(obj), corners_m, limit_m, errors_m)
    return errors_m


@njit(fast=True)
def _fill_errors(first, last, poses, points, limit, errors):
    """Fill `errors` (K,), metres, for points (P, 3). `poses` are T and others (K, 4, 4), and symmetries (E, 4, 4)."""
    T, others, same = poses
    moved = np.empty((3, 4))
    enough = limit * limit
    for k in range(first, last):
        best = np.inf
        for e in range(len(same)):
            for i in range(3):
                for j in range(4):
                    moved[i, j] = T[k, i, j]
                    for m in range(4):
                        moved[i, j] -= others[k, i, m] * same[e, m, j]
            worst = 0.0
            for p in range(len(points)):
                x, y, z = points[p, 0], points[p, 1], points[p, 2]
                squared = 0.0
                for i in range(3):
                    off = moved[i, 0] * x + moved[i, 1] * y + moved[i, 2] * z + moved[i, 3]
                    squared += off * off
                if squared > worst:
                    worst = squared
                    if worst >= best:
                        break
            best = min(best, worst)
            if best <= enough:
                break
        errors[k] = math.sqrt(best)


@njit(fast=True)
def _fill_rolled_errors(first, last, poses, frame, points, limit, errors):
    """Fill `errors` (K,) as `_fill_errors`, for all rolls about an axis.

    `poses` are T (K, 4, 4), and the others with flips (K, F, 4, 4). `frame` is the unit axis (3,) and a point (3,) of
    it, metres, in the object's frame.
    """
    T, flipped = poses
    waves = np.empty((len(points), 3))
    middles, halves = np.empty(INTERVALS + HALVINGS), np.empty(INTERVALS + HALVINGS)
    for k in range(first, last):
        best = np.inf
        for f in range(flipped.shape[1]):
            roll = _fit_waves(T[k], flipped[k, f], frame, points, waves)
            best = min(best, _find_largest(waves, roll))
            half, count = math.pi / INTERVALS, INTERVALS
            for i in range(INTERVALS):
                middles[i], halves[i] = (2 * i + 1) * half, half
            while count and best > limit:
                count -= 1
                middle, half = middles[count], halves[count]
                least = max(best - PRECISION_M, 0.0) if limit <= 0 else min(best - PRECISION_M, limit)
                if least <= 0 or _bound_largest(waves, middle, half, least * least) >= least * least:
                    continue
                best = min(best, _find_largest(waves, middle))
                if count + 2 <= len(middles):
                    middles[count], halves[count] = middle - half / 2, half / 2
                    middles[count + 1], halves[count + 1] = middle + half / 2, half / 2
                    count += 2
            if best <= limit:
                break
        errors[k] = best


@njit(fast=True)
def _fit_waves(T, other, frame, points, waves):
    """Fill `waves` (P, 3), a, b and c, m^2, of the squared displacements, and return the roll of their least mean."""
    axis, centre = frame
    U = np.empty((3, 3))  # rotation of the other pose after a quarter turn about the axis
    sums_b = sums_c = 0.0
    for i in range(3):
        r0, r1, r2 = other[i, 0], other[i, 1], other[i, 2]
        U[i, 0] = r1 * axis[2] - r2 * axis[1]
        U[i, 1] = r2 * axis[0] - r0 * axis[2]
        U[i, 2] = r0 * axis[1] - r1 * axis[0]
    for p in range(len(points)):
        o0, o1, o2 = points[p, 0] - centre[0], points[p, 1] - centre[1], points[p, 2] - centre[2]
        along = o0 * axis[0] + o1 * axis[1] + o2 * axis[2]
        q0, q1, q2 = o0 - along * axis[0], o1 - along * axis[1], o2 - along * axis[2]
        m0, m1, m2 = centre[0] + along * axis[0], centre[1] + along * axis[1], centre[2] + along * axis[2]
        a = b = c = 0.0
        for i in range(3):
            here = T[i, 0] * points[p, 0] + T[i, 1] * points[p, 1] + T[i, 2] * points[p, 2] + T[i, 3]
            fixed = here - (other[i, 0] * m0 + other[i, 1] * m1 + other[i, 2] * m2 + other[i, 3])
            cosine = other[i, 0] * q0 + other[i, 1] * q1 + other[i, 2] * q2
            sine = U[i, 0] * q0 + U[i, 1] * q1 + U[i, 2] * q2
            a += fixed * fixed + cosine * cosine
            b -= 2 * fixed * cosine
            c -= 2 * fixed * sine
        waves[p, 0], waves[p, 1], waves[p, 2] = a, b, c
        sums_b, sums_c = sums_b + b, sums_c + c
    return math.atan2(-sums_c, -sums_b)


@njit(fast=True)
def _find_largest(waves, roll):
    """Return the largest displacement, metres, at a roll, radians."""
    cosine, sine, largest = math.cos(roll), math.sin(roll), 0.0
    for p in range(len(waves)):
        largest = max(largest, waves[p, 0] + waves[p, 1] * cosine + waves[p, 2] * sine)
    return math.sqrt(largest)


@njit(fast=True)
def _bound_largest(waves, middle, half, enough):
    """Return a lower bound, m^2, of the largest squared displacement at rolls within `half` of `middle`, radians.

    A bound of at least `enough` is returned as soon as it is found.
    """
    c0, s0, c1, s1 = math.cos(middle - half), math.sin(middle - half), math.cos(middle + half), math.sin(middle + half)
    towards_c, towards_s, near = math.cos(middle), math.sin(middle), math.cos(half)
    largest = 0.0
    for p in range(len(waves)):
        a, b, c = waves[p, 0], waves[p, 1], waves[p, 2]
        swing = math.sqrt(b * b + c * c)
        if -(b * towards_c + c * towards_s) > near * swing:  # the sinusoid's minimum is inside the interval
            lowest = a - swing
        else:
            lowest = min(a + b * c0 + c * s0, a + b * c1 + c * s1)
        if lowest > largest:
            largest = lowest
            if largest >= enough:
                break
    return largest


def _measure_rms(obj: ObjectModel, T_estimates: Poses, same: Poses) -> Floats:
    """Return the root mean square surface distances (K, E), metres, between estimates (K, 4, 4) and poses (E, 4, 4)."""
    from scipy.spatial.distance import cdist

    metric = PoseMetric(obj)
    distances: Floats = cdist(metric.embed(T_estimates), metric.embed(same))
    return distances


def _choose_alike(rms_m: Floats) -> Ints:
    """Choose TRIED of the E symmetries for each estimate, spread evenly over those near the least distance."""
    order = np.argsort(rms_m, axis=1)
    least = np.take_along_axis(rms_m, order[:, :1], axis=1)
    count = (rms_m <= ALIKE * least).sum(axis=1)
    steps = np.linspace(0.0, 1.0, TRIED)[None] * (count[:, None] - 1)
    return np.take_along_axis(order, steps.astype(np.int64), axis=1)


def _measure_distances(points_m: Floats, difference: Poses) -> Floats:
    """Return the distances (D, P), metres, of points (P, 3) between poses whose matrices differ by (D, 4, 4)."""
    moved = difference[:, :3, :3] @ points_m.T + difference[:, :3, 3:]
    return np.sqrt(np.einsum("dip,dip->dp", moved, moved))


def _average_distances(points_m: Floats, difference: Poses) -> Floats:
    """Return mean distances (...,), metres, of points (P, 3) between poses whose matrices differ by (..., 4, 4)."""
    flat = difference.reshape(-1, 4, 4)
    means = [_measure_distances(points_m, flat[i : i + AT_ONCE]).mean(axis=1) for i in range(0, len(flat), AT_ONCE)]
    return np.concatenate(means).reshape(difference.shape[:-2])


def find_least_mean(obj: ObjectModel, points_m: Floats, T_estimate: Poses, T_true: Poses) -> float:
    """Return the least mean distance, metres, of points (P, 3) between a pose (4, 4) and the rolled true pose (4, 4).

    The least is over all rolls about the object's continuous axis of symmetry.
    """
    few_m = points_m[:: max(1, len(points_m) // ROLL_POINTS)]
    flipped = T_true @ _list_flips(obj)
    few, lowest = zip(*(_fit_sinusoids(obj, few_m, T_estimate, T) for T in flipped), strict=True)
    evenly = np.linspace(0.0, 2 * np.pi, TRIED_ROLLS, endpoint=False)
    tried = [np.append(evenly, roll) for roll in lowest]
    means_m = np.stack([_measure_rolled(f, rolls).mean(axis=1) for f, rolls in zip(few, tried, strict=True)])
    best, place = np.unravel_index(int(means_m.argmin()), means_m.shape)
    every, _ = _fit_sinusoids(obj, points_m, T_estimate, flipped[best])
    roll = _iterate_weiszfeld(every, _iterate_weiszfeld(few[best], tried[best][place], ROUNDS_FEW), ROUNDS_ALL)
    return float(_measure_rolled(every, roll).mean())


def _list_flips(obj: ObjectModel) -> Poses:
    """Return the symmetry's elements (F, 4, 4) without rolls: the identity, and perhaps half a turn across the axis."""
    return obj.symmetry.list_elements(np.pi)[::2]


def _find_frame(obj: ObjectModel) -> tuple[Floats, Floats]:
    """Return the unit direction (3,) of the continuous axis of symmetry, and a point (3,) of it, metres."""
    symmetry = obj.symmetry
    return np.ascontiguousarray(symmetry.continuous_axis, np.float64), np.ascontiguousarray(symmetry.centre_m)


def _fit_sinusoids(obj: ObjectModel, points_m: Floats, T_estimate: Poses, T_true: Poses) -> tuple[Floats, float]:
    """Return the sinusoids (P, 3), a, b and c, m^2, of the squared distances of points (P, 3) between poses (4, 4).

    Also return the roll, radians, of their least mean.
    """
    points_m, T, other = (np.ascontiguousarray(each, np.float64) for each in (points_m, T_estimate, T_true))
    waves = np.empty((len(points_m), 3))
    return waves, _fit_waves(T, other, _find_frame(obj), points_m, waves)


def _find_lowest(sinusoids: Floats) -> Floats:
    """Return the rolls (...,), radians, at the minima of sinusoids (..., 3)."""
    return np.asarray(np.arctan2(-sinusoids[..., 2], -sinusoids[..., 1]))


def _measure_rolled(sinusoids: Floats, rolls: Floats | float) -> Floats:
    """Return the distances (..., P), metres, whose squares are sinusoids (P, 3), at rolls (...,), radians."""
    waves = np.stack([np.ones_like(rolls), np.cos(rolls), np.sin(rolls)], axis=-1)
    return np.sqrt(np.maximum(waves @ sinusoids.T, 0.0))


def _iterate_weiszfeld(sinusoids: Floats, roll: Floats | float, rounds: int) -> Floats | float:
    """Return the roll, radians, after `rounds` of Weiszfeld's iteration for the mean distance.

    `sinusoids` (P, 3) are the squared distances.
    """
    for _ in range(rounds):
        roll = _find_lowest((1.0 / np.maximum(_measure_rolled(sinusoids, roll), COINCIDENT_M)) @ sinusoids)
    return roll
