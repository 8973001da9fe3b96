"""Errors of estimated poses, in metres of object surface, and metrics of posteriors.

All errors take symmetry into account: see `core.poses.pose_errors`. The metrics of a posterior are likelihood, credible
level, entropy, spread and coverage.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.pose_errors import compute_adds, measure_pose_errors
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.tolerance import measure_shape_distances

POSTERIOR_METRICS = ("nll_nats", "credible_level", "entropy_nats", "expected_error_m", "spread_m")
LEVELS = (0.5, 0.8, 0.95)
SURFACE_POINTS = 10_000  # for ADD
METRICS = ("mssd", "add", "shape")  # of an answer: pose error, ADD and shape distance
STEP_M = 2e-5  # step along a continuous symmetry to find the nearest symmetric pose

Points = Floats


@dataclass(frozen=True, eq=False)
class PoseJudge:
    """Measures poses of an object against its true pose."""

    object: ObjectModel

    @cached_property
    def points_m(self) -> Points:
        """The object's points (SURFACE_POINTS, 3), metres, for ADD; they are always the same."""
        return self.object.mesh.sample(SURFACE_POINTS, np.random.default_rng(0))

    @cached_property
    def diameter_m(self) -> float:
        """The largest distance of two points of the object's surface, metres."""
        corners_m = self.object.mesh.hull_corners_m
        return max(float(np.linalg.norm(corners_m - corner, axis=1).max()) for corner in corners_m)

    def measure_errors(self, poses: Poses, T_true: Poses) -> Floats:
        """Return the METRICS (K, M), metres, of poses (K, 4, 4) and the true pose (4, 4)."""
        errors = (
            measure_pose_errors(self.object, poses, T_true),
            compute_adds(self.object, self.points_m, poses, T_true),
            measure_shape_distances(self.object.mesh, poses, T_true),
        )
        return np.stack(errors, axis=1)


def measure_posterior(posterior: PosePosterior, T_true: Poses, rng: np.random.Generator) -> Floats:
    """Return the POSTERIOR_METRICS (5,) of a posterior with a known true pose (4, 4), metres.

    `nll_nats` is the negative log-likelihood of the grid pose nearest to the true pose. `credible_level`, 0 to 1, is
    the total probability of all poses likelier than this grid pose, plus a random share of its own probability.
    `expected_error_m` and `spread_m` are the mean distances of the posterior's poses from the true pose and from the
    most probable pose. Symmetric poses count as equal.
    """
    p = posterior.probabilities
    truth = int(posterior.grid.nearest(T_true[None])[1][0])
    level = posterior.credible_level(truth, rng.random())
    best = posterior.grid.T_sensor_object[int(posterior.log_p.argmax())]
    expected, spread = (float(p @ posterior.grid.distances(T)) for T in (T_true, best))
    return np.array([-posterior.log_p[truth], level, posterior.entropy, expected, spread])


def compute_nees(metric: PoseMetric, T_estimate: Poses, covariance: Floats, T_true: Poses) -> float:
    """Return e^T C^-1 e (unitless) of an estimate (4, 4), metres, with its covariance C (6, 6), in ROS's order.

    e (6,) is the error of x, y, z and of the rotation vector, along the sensor's axes. The error is measured from the
    pose nearest to the estimate among the poses symmetric to the true pose (4, 4). The mean of e^T C^-1 e is 6
    (chi-squared) if the covariances are true and the errors Gaussian.
    """
    T = metric.nearest_equivalents(T_true[None], T_estimate[None], STEP_M)[0]
    rotation = Rotation.from_matrix(T[:3, :3] @ T_estimate[:3, :3].T).as_rotvec()
    e = np.concatenate([T[:3, 3] - T_estimate[:3, 3], rotation])
    return float(e @ np.linalg.solve(covariance, e))
