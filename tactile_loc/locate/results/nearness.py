"""The probability that the first pose of a result is within a tolerance of the true pose.

Each hypothesis has a probability, and the covariance of its error. True poses are drawn from each hypothesis. The share
of those within the tolerance of the first pose is weighted by the hypotheses' probabilities. `calibrate` turns this
share into a probability, with numbers that were fitted to simulated touches of other objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.registration.twists import exponential

Float64 = NDArray[np.float64]

DRAWN = 64  # errors drawn from the covariance of a hypothesis
FAR = 3.0  # hypotheses farther from the first one than this many tolerances draw nothing
NEGLIGIBLE = 1e-3  # less probable hypotheses draw nothing
# The fit: docs/benchmarks/probabilities.md. If the true pose was found, the log odds of a right first pose are a broken
# line over those of the share: OFFSET at even odds, the SLOPE below them and the STEEP slope above. If the touches do
# not determine the pose, the line is flat above even odds. The log odds that the pose was found are greater than
# the search states by FOUND.
OFFSET, SLOPE, STEEP, FOUND = 0.89, 0.88, 1.35, 4.2
LEAST = 2e-3  # shares and probabilities are clipped to the range from LEAST to 1 - LEAST


def compute_share_within(
    T_sensor_object: Poses, probabilities: Float64, covariances: Sequence[Float64], obj: ObjectModel,
    tolerance: Tolerance,
) -> float:  # fmt: skip
    """Return the stated probability, 0 to 1, that the first of K poses (K, 4, 4), metres, is within a tolerance.

    `probabilities` (K,) and `covariances`, K arrays (6, 6) as in RefinedPose, are taken as they are.
    """
    near = tolerance.find_within(obj, T_sensor_object[0], T_sensor_object, FAR)
    counted = [k for k, p in enumerate(probabilities) if k == 0 or (p >= NEGLIGIBLE and near[k])]
    drawn = np.concatenate([draw_poses(T_sensor_object[k], covariances[k]) for k in counted])
    within = tolerance.find_within(obj, T_sensor_object[0], drawn)
    return float(min(1.0, within.reshape(len(counted), -1).mean(axis=1) @ probabilities[counted]))


def calibrate(share: float, elsewhere: float, undetermined: bool = False) -> float:
    """Return the fitted probability, 0 to 1, of a right first pose; it never decreases if `share` increases.

    `share`, 0 to 1, is the stated probability. `elsewhere`, below 1, is the stated probability that the search missed
    the true pose. `undetermined` states whether the touches leave poses beyond the tolerance of the first one open.
    """
    odds = _compute_log_odds(share / (1 - elsewhere))
    above = 0.0 if undetermined else STEEP
    right = OFFSET + (above if odds > 0 else SLOPE) * odds
    found = FOUND - _compute_log_odds(elsewhere)
    return float(np.clip(1 / ((1 + np.exp(-right)) * (1 + np.exp(-found))), LEAST, 1 - LEAST))


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
