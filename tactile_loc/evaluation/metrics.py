"""Errors of estimated poses, in metres of object surface, and metrics of posteriors.

All errors take symmetry into account: see `core.poses.pose_errors`. The metrics of a posterior are likelihood, credible
level, entropy, spread and coverage.

The surface distance is the mean distance of the surface at the estimate from the surface at the true pose. It is ADD-S
with the nearest point of the surface instead of the nearest sampled point, so it is 0 for the true pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import Poses, invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.pose_errors import compute_adds, measure_pose_errors
from tactile_loc.core.poses.posterior import PosePosterior

POSTERIOR_METRICS = ("nll_nats", "credible_level", "entropy_nats", "expected_error_m", "spread_m")
LEVELS = (0.5, 0.8, 0.95)
SURFACE_POINTS = 10_000  # for ADD
METRICS = ("surface", "add", "mssd")  # of an answer
GAP_POINTS = 2000  # points of the surface, whose distances are averaged
STEP_M = 2e-5  # step along a continuous symmetry to find the nearest symmetric pose

Points = NDArray[np.float64]


def compute_surface_distances(obj: ObjectModel, T_estimates: Poses, T_true: Poses) -> NDArray[np.float64]:
    """Return the surface distances (K,), metres, of estimates (K, 4, 4) from the true pose (4, 4).

    The distance is the mean over GAP_POINTS points of the surface, which are always the same. Each point is
    compared with the nearest surface point at the true pose, or at the pose symmetric to it that is nearest to the
    estimate.
    """
    truths = np.broadcast_to(T_true, T_estimates.shape)
    truths = PoseMetric(obj).nearest_equivalents(truths, T_estimates, STEP_M)
    points_m = obj.mesh.sample(GAP_POINTS, np.random.default_rng(0))
    moves = (invert(truth) @ T for truth, T in zip(truths, T_estimates, strict=True))
    return np.array([_measure_gaps(obj.mesh, transform_points(move, points_m)).mean() for move in moves])


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

    def measure_errors(self, poses: Poses, T_true: Poses) -> NDArray[np.float64]:
        """Return the METRICS (K, M), metres, of poses (K, 4, 4) and the true pose (4, 4)."""
        errors = (
            compute_surface_distances(self.object, poses, T_true),
            compute_adds(self.object, self.points_m, poses, T_true),
            measure_pose_errors(self.object, poses, T_true),
        )
        return np.stack(errors, axis=1)


def _measure_gaps(mesh: TriangleMesh, points_m: Points) -> NDArray[np.float64]:
    """Return the distances (P,), metres, of points (P, 3) from a surface."""
    from open3d.core import Tensor

    points_mm = (1e3 * (points_m - mesh.centroid_m)).astype(np.float32)
    gaps_mm: NDArray[np.float32] = _build_scene(mesh).compute_distance(Tensor.from_numpy(points_mm)).numpy()
    return 1e-3 * gaps_mm.astype(float)


@lru_cache(maxsize=8)
def _build_scene(mesh: TriangleMesh) -> Any:
    """Return a mesh's search structure in mm about its centroid, because its numbers have single precision."""
    from open3d.core import Tensor
    from open3d.t.geometry import RaycastingScene

    scene = RaycastingScene()
    vertices_mm = (1e3 * (mesh.vertices_m - mesh.centroid_m)).astype(np.float32)
    scene.add_triangles(Tensor.from_numpy(vertices_mm), Tensor.from_numpy(mesh.faces.astype(np.uint32)))
    return scene


def measure_posterior(posterior: PosePosterior, T_true: Poses, rng: np.random.Generator) -> NDArray[np.float64]:
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


def compute_nees(metric: PoseMetric, T_estimate: Poses, covariance: NDArray[np.float64], T_true: Poses) -> float:
    """Return e^T C^-1 e (unitless) of an estimate (4, 4), metres, with its covariance C (6, 6), in ROS's order.

    e (6,) is the error of x, y, z and of the rotation vector, along the sensor's axes. The error is measured from the
    pose nearest to the estimate among the poses symmetric to the true pose (4, 4). The mean of e^T C^-1 e is 6
    (chi-squared) if the covariances are true and the errors Gaussian.
    """
    T = metric.nearest_equivalents(T_true[None], T_estimate[None], STEP_M)[0]
    rotation = Rotation.from_matrix(T[:3, :3] @ T_estimate[:3, :3].T).as_rotvec()
    e = np.concatenate([T[:3, 3] - T_estimate[:3, 3], rotation])
    return float(e @ np.linalg.solve(covariance, e))
