"""What is measured of a posterior when the truth is known: likelihood, credible level, entropy, spread; coverage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior

POSTERIOR_METRICS = ("nll", "credible_level", "entropy", "expected_error", "spread")
LEVELS = (0.5, 0.8, 0.95)
STEP_M = 2e-5  # of a continuous symmetry, in finding the nearest of the poses that look the same


def posterior_metrics(posterior: PosePosterior, T_true: Poses, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the numbers (5,) of POSTERIOR_METRICS of a posterior whose true pose (4, 4), metres, is known.

    `nll`, nats: of the grid pose nearest to the truth. `credible_level`: the probability of the smallest credible set
    that holds that pose, drawn at random within its own share. `entropy`, nats. `expected_error` and `spread`, metres:
    the mean distance from the truth, and from the most probable pose, of poses drawn from the posterior; symmetry
    regarded.
    """
    p = posterior.probabilities
    truth = int(posterior.grid.nearest(T_true[None])[1][0])
    level = posterior.credible_level(truth, rng.random())
    best = posterior.grid.T_sensor_object[int(posterior.log_p.argmax())]
    expected, spread = (float(p @ posterior.grid.distances(T)) for T in (T_true, best))
    return np.array([-posterior.log_p[truth], level, posterior.entropy, expected, spread])


def normalised_error_squared(
    metric: PoseMetric, T_estimate: Poses, covariance: NDArray[np.float64], T_true: Poses
) -> float:
    """Return e^T C^-1 e (unitless) of an estimate (4, 4), metres, with its covariance C (6, 6), in ROS's order.

    e (6,) is the error of x, y, z and the rotation vector, along the sensor's axes, from the pose that looks like the
    true one (4, 4) and is nearest. With true covariances and Gaussian errors its mean is 6 (chi-squared).
    """
    T = metric.nearest_equivalents(T_true[None], T_estimate[None], STEP_M)[0]
    turned = Rotation.from_matrix(T[:3, :3] @ T_estimate[:3, :3].T).as_rotvec()
    e = np.concatenate([T[:3, 3] - T_estimate[:3, 3], turned])
    return float(e @ np.linalg.solve(covariance, e))


@dataclass(frozen=True)
class PosteriorSummary:
    """The metrics of many touches' posteriors, summed up: means over touches, lengths in metres, nll in nats.

    `coverage` are the shares of touches whose truth is in the credible set of each of LEVELS.
    """

    nll: float
    uniform_nll: float
    coverage: tuple[float, ...]
    entropy: float
    expected_error_m: float
    spread_m: float

    @classmethod
    def of(cls, metrics: NDArray[np.float64], grid_poses: int) -> PosteriorSummary:
        """Sum up metrics (T, 5) of posteriors over a grid of so many poses."""
        nll, level, entropy, expected_error_m, spread_m = metrics.T
        coverage = tuple(float((level <= sure).mean()) for sure in LEVELS)
        means = (float(v.mean()) for v in (entropy, expected_error_m, spread_m))
        return cls(float(nll.mean()), float(np.log(grid_poses)), coverage, *means)
