"""Rolls about a continuous axis of symmetry that minimize the mean or the largest distance of two poses.

As a function of the roll theta, a surface point's squared distance is a sinusoid, a + b cos(theta) + c sin(theta). The
minimum of the mean of these squares has a closed form. Weiszfeld's iteration minimizes the mean distance, ADD: in each
round, it minimizes the mean of squares, each weighted by one over the previous distance.

The largest distance, MSSD, has kinks and several minima. In an interval of rolls, its lower bound is the largest of the
sinusoids' minima. Intervals that could contain a better roll are halved, until none could be better by PRECISION_M.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, rotation_about, transform_points
from tactile_loc.core.objects.mesh import ObjectModel

TRIED, TRIED_POINTS = 64, 300  # rolls and points that are tried to find a start near the least mean distance
ROUNDS_FEW, ROUNDS_ALL = 12, 3  # rounds of Weiszfeld's iteration, with few points and with all points
COINCIDENT_M = 1e-9  # smaller distances count as this distance
PRECISION_M, INTERVALS = 1e-7, 24  # precision of the largest distance; first number of intervals

Array = NDArray[np.float64]


def find_least_mean(obj: ObjectModel, points_m: Array, T_estimate: Poses, T_true: Poses) -> float:
    """Return the least mean distance, metres, of points (P, 3) between a pose (4, 4) and the rolled true pose (4, 4).

    The least is over all rolls about the object's continuous axis of symmetry.
    """
    few_m = points_m[:: max(1, len(points_m) // TRIED_POINTS)]
    few = [_fit_sinusoids(obj, few_m, T_estimate, T_true @ S) for S in _list_flips(obj)]
    evenly = np.linspace(0.0, 2 * np.pi, TRIED, endpoint=False)
    tried = [np.append(evenly, _find_lowest(f.mean(axis=0))) for f in few]
    means_m = np.stack([_measure_distances(f, rolls).mean(axis=1) for f, rolls in zip(few, tried, strict=True)])
    best, place = np.unravel_index(int(means_m.argmin()), means_m.shape)
    every = _fit_sinusoids(obj, points_m, T_estimate, T_true @ _list_flips(obj)[best])
    roll = _iterate_weiszfeld(every, _iterate_weiszfeld(few[best], tried[best][place], ROUNDS_FEW), ROUNDS_ALL)
    return float(_measure_distances(every, roll).mean())


def find_least_largest(obj: ObjectModel, corners_m: Array, T_estimate: Poses, T_true: Poses) -> float:
    """Return the least largest distance, metres, of points (P, 3) between a pose and the rolled true pose (4, 4).

    The least is over all rolls about the object's continuous axis of symmetry. The result is exact to PRECISION_M.
    """
    flips = [_fit_sinusoids(obj, corners_m, T_estimate, T_true @ S) for S in _list_flips(obj)]
    best_m = min(float(_measure_distances(s, _find_lowest(s.mean(axis=0))).max()) for s in flips)
    for sinusoids in flips:
        half = float(np.pi) / INTERVALS
        middles: Array = (2 * np.arange(INTERVALS, dtype=np.float64) + 1) * half
        while len(middles):
            best_m = min(best_m, float(_measure_distances(sinusoids, middles).max(axis=1).min()))
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


def _measure_distances(sinusoids: Array, rolls: Array | float) -> Array:
    """Return the distances (..., P), metres, whose squares are sinusoids (P, 3), at rolls (...,), radians."""
    waves = np.stack([np.ones_like(rolls), np.cos(rolls), np.sin(rolls)], axis=-1)
    return np.sqrt(np.maximum(waves @ sinusoids.T, 0.0))


def _bound_distances(sinusoids: Array, middles: Array, half: float) -> Array:
    """Return the least distances (I, P), metres, at rolls within `half` of `middles` (I,), radians."""
    ends = np.minimum(_measure_distances(sinusoids, middles - half), _measure_distances(sinusoids, middles + half))
    lowest = sinusoids[:, 0] - np.hypot(sinusoids[:, 1], sinusoids[:, 2])
    off = (_find_lowest(sinusoids) - middles[:, None] + np.pi) % (2 * np.pi) - np.pi
    return np.where(np.abs(off) < half, np.sqrt(np.maximum(lowest, 0.0)), ends)


def _iterate_weiszfeld(sinusoids: Array, roll: Array | float, rounds: int) -> Array | float:
    """Return the roll, radians, after `rounds` of Weiszfeld's iteration for the mean distance.

    `sinusoids` (P, 3) are the squared distances.
    """
    for _ in range(rounds):
        roll = _find_lowest((1.0 / np.maximum(_measure_distances(sinusoids, roll), COINCIDENT_M)) @ sinusoids)
    return roll
