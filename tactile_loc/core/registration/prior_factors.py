"""The factors of a prior on poses in registration: the prior's local quadratic model, fitted to its values.

Near a pose, the log-weight of a prior is about -e^T L e / 2 plus a constant. The twist e (6,) leads from the pose to
the local peak of the prior, and L is the information. Where touches leave a pose open, the factor decides.
"""

from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.lie import exponential
from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.core.poses.priors import Prior

STEPS = np.array([5e-3] * 3 + [1e-4] * 3)  # of finite differences: rad, then m
MOST = np.array([1.0] * 3 + [5e-2] * 3)  # largest twist from a pose to the peak of its factor: rad, then m
NEWTON_STEPS = 2
FLAT = 1e-3  # nats at the largest twist MOST, below which a direction of the prior is flat
ROUNDING = 1e-6  # nats; a peak that seems less probable than its pose by less may be the pose itself


class PriorFactors(NamedTuple):
    """Factors of a prior on K poses: peaks `T` (K, 4, 4), and the `information` (K, 6, 6) about twists from the peaks.

    Lengths are in metres; the registration converts them. A twist is a rotation vector (rad), then a translation, about
    the object's centre, along the axes of the poses' frame. A factor without information has no effect.
    """

    T: Poses
    information: Floats


def fit_prior_factors(prior: Prior, T: Poses, middle_m: Floats) -> PriorFactors:
    """Fit the factors of a `prior` on poses T (K, 4, 4), metres, of an object with the centre `middle_m` (3,), metres.

    Only values of the prior are used, so any function of poses serves. A factor is zero where the prior is flat,
    where it excludes a neighbouring pose, or where the peak of the quadratic model is no better than the pose.
    """
    peaks, information = T.copy(), np.zeros((len(T), 6, 6))
    if not len(T):
        return PriorFactors(peaks, information)
    here = np.asarray(prior(T), float)
    for _ in range(NEWTON_STEPS):
        twists, fitted = _fit_quadratic(prior, peaks, middle_m)
        moved = exponential(twists, _find_centres(peaks, middle_m)) @ peaks
        there = np.asarray(prior(moved), float)
        better = np.isfinite(there) & (there >= here - ROUNDING)
        peaks[better], here[better] = moved[better], there[better]
        information[better] = fitted[better]
    return PriorFactors(peaks, information)


def draw_around(factor: PriorFactors, count: int, middle_m: Floats) -> Poses:
    """Draw poses (count, 4, 4), metres, from a single factor. The same factor gives the same poses.

    Directions in which the prior is flat are left out. The first pose is the peak.
    """
    values, vectors = np.linalg.eigh(factor.information[0] * np.outer(MOST, MOST))
    std = np.where(values > FLAT, 1 / np.sqrt(np.maximum(values, FLAT)), 0.0)
    drawn = np.random.default_rng(0).normal(size=(count, 6))
    drawn[0] = 0.0
    twists = np.clip((drawn * std) @ vectors.T, -1.0, 1.0) * MOST
    return np.asarray(exponential(twists, _find_centres(factor.T, middle_m)) @ factor.T)


def _find_centres(T: Poses, middle_m: Floats) -> Floats:
    return np.asarray(T[:, :3, :3] @ middle_m + T[:, :3, 3])


def _fit_quadratic(prior: Prior, T: Poses, middle_m: Floats) -> tuple[Floats, Floats]:
    """Return twists (K, 6) from poses to the peaks of the quadratic model, and its information (K, 6, 6).

    The model has finite differences of the prior's values. Directions in which it is flat or convex are left out.
    """
    first, second = np.triu_indices(6, 1)
    unit = np.eye(6)
    twists = np.concatenate([np.zeros((1, 6)), unit, -unit, unit[first] + unit[second]]) * STEPS
    moved = exponential(twists, _find_centres(T, middle_m)[:, None]) @ T[:, None]
    values = np.asarray(prior(moved.reshape(-1, 4, 4)), float).reshape(len(T), len(twists))
    known = np.isfinite(values).all(axis=1)
    values[~known] = 0.0
    middle, up, down, both = values[:, :1], values[:, 1:7], values[:, 7:13], values[:, 13:]
    gradient = (up - down) / 2
    hessian = np.zeros((len(T), 6, 6))
    hessian[:, range(6), range(6)] = up - 2 * middle + down
    hessian[:, first, second] = hessian[:, second, first] = both - up[:, first] - up[:, second] + middle
    # in units of MOST, so that rotations and translations can be compared
    scale = MOST / STEPS
    curvatures, vectors = np.linalg.eigh(-hessian * np.outer(scale, scale))
    along = (vectors.swapaxes(1, 2) @ (gradient * scale)[..., None])[..., 0]
    curved = curvatures > FLAT
    steps = np.where(curved, along / np.where(curved, curvatures, 1.0), 0.0)
    twists = (vectors @ steps[..., None])[..., 0]
    twists /= np.maximum(1.0, np.abs(twists).max(axis=1, keepdims=True))
    information = (vectors * np.where(curved, curvatures, 0.0)[:, None]) @ vectors.swapaxes(1, 2)
    return twists * MOST, information / np.outer(MOST, MOST)
