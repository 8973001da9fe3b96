"""The probability that the first pose of a result is within a tolerance of the true pose.

Each hypothesis has a probability, and the covariance of its error. True poses are drawn from each hypothesis. The share
of those within the tolerance of the first pose is weighted by the hypotheses' probabilities. `calibrate` turns this
share, and how much worse other poses explain the touches, into a probability. Its numbers were fitted to simulated
touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.lie import exponential
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.tolerance import Tolerance

Float64 = NDArray[np.float64]

DRAWN = 64  # errors drawn from the covariance of a hypothesis
FAR = 3.0  # hypotheses farther from the first one than this many tolerances draw nothing
NEGLIGIBLE = 1e-3  # less probable hypotheses draw nothing
# The fit: docs/benchmarks/probabilities.md. The log odds of a right first pose are a sum: BASE; LOW or HIGH times the
# log odds of the share, below and above even odds; FOUND times the log odds that the search found the true pose; and
# GAP times the logarithm of the rivals' gap, to which LEAST_GAP is added.
BASE, LOW, HIGH, FOUND, GAP, LEAST_GAP = 4.07, 0.64, 0.86, 0.18, 1.24, 0.03
NATS_PER_IOU = 30.0  # nats of a prior, or of an error of a sensor pose, that count as much as an imprint IoU of 1
MOST_UNDETERMINED = 0.89  # largest probability of an undetermined pose, and of a share of at most a half: not certain
LEAST = 2e-3  # shares and probabilities are clipped to the range from LEAST to 1 - LEAST


def compute_share_within(
    T_sensor_object: Poses,
    probabilities: Float64,
    covariances: Sequence[Float64],
    obj: ObjectModel,
    tolerance: Tolerance,
) -> float:
    """Return the stated probability, 0 to 1, that the first of K poses (K, 4, 4), metres, is within a tolerance.

    `probabilities` (K,) and `covariances`, K arrays (6, 6) as in RefinedPose, are taken as they are.
    """
    near = tolerance.find_within(obj, T_sensor_object[0], T_sensor_object, FAR)
    counted = [k for k, p in enumerate(probabilities) if k == 0 or (p >= NEGLIGIBLE and near[k])]
    drawn = np.concatenate([draw_poses(T_sensor_object[k], covariances[k]) for k in counted])
    within = tolerance.find_within(obj, T_sensor_object[0], drawn)
    return float(min(1.0, within.reshape(len(counted), -1).mean(axis=1) @ probabilities[counted]))


class Nearness(NamedTuple):
    """The observations from which the probability of a right first pose is computed.

    `share`, 0 to 1, is the stated probability that it is within the tolerance. `elsewhere`, below 1, is the stated
    probability that the search missed the true pose. `gap`, 0 to 1, is how much more imprint IoU the pose has than the
    best pose beyond the tolerance. `undetermined` states whether the touches leave such poses open.
    """

    share: float
    elsewhere: float
    gap: float
    undetermined: bool = False


def calibrate(nearness: Nearness) -> float:
    """Return the fitted probability, 0 to 1, of a right first pose.

    It never decreases if the share or the gap increases.
    """
    right, most = _compute_right(nearness)
    return float(np.clip(right, LEAST, most))


def is_limited(nearness: Nearness) -> bool:
    """Return whether a limit, not the observations, decides what `calibrate` returns. Then it is no probability."""
    right, most = _compute_right(nearness)
    return not LEAST < right < most


def _compute_right(nearness: Nearness) -> tuple[float, float]:
    """Return the probability of a right first pose by the fit, and the largest probability that may be returned."""
    share, elsewhere, gap, undetermined = nearness
    odds = _compute_log_odds(share / (1 - elsewhere))
    above = 0.0 if undetermined else HIGH
    right = BASE + (above if odds > 0 else LOW) * odds - FOUND * _compute_log_odds(elsewhere)
    right += GAP * np.log(max(gap, 0.0) + LEAST_GAP)
    return float(1 / (1 + np.exp(-right))), MOST_UNDETERMINED if undetermined or odds <= 0 else 1 - LEAST


def _compute_log_odds(p: float) -> float:
    clipped = np.clip(p, LEAST, 1 - LEAST)
    return float(np.log(clipped / (1 - clipped)))


def draw_poses(T: Poses, covariance: Float64) -> Poses:
    """Return DRAWN true poses (D, 4, 4), metres, given an estimate T (4, 4) and its covariance (6, 6).

    The same input always gives the same poses. The covariance is as in RefinedPose.
    """
    values, vectors = np.linalg.eigh(covariance)
    errors = _draw_normals() * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(exponential(np.roll(errors, 3, axis=1), T[:3, 3]) @ T)


@lru_cache(maxsize=1)
def _draw_normals() -> Float64:
    """Return normal numbers (DRAWN, 6). Each column has equal steps of probability, in an order of its own."""
    from scipy.special import ndtri  # scipy takes a while to import

    steps = np.asarray(ndtri((np.arange(DRAWN) + 0.5) / DRAWN))
    return np.random.default_rng(0).permuted(np.tile(steps[:, None], 6), axis=0)
