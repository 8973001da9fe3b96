"""Errors of estimated poses, in metres of object surface, and metrics of posteriors.

All errors take symmetry into account: an estimate is compared with every pose that is symmetric to the true one. ADD is
the mean distance of surface points (Hinterstoisser et al., ACCV 2012), MSSD the largest distance (Hodan et al., ECCV
2020). ADD-S is the mean distance to the nearest surface point, which ignores all differences between similar views. The
metrics of a posterior are likelihood, credible level, entropy, spread and coverage.

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
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.rolls import find_least_largest, find_least_mean

FEW_SYMMETRIES = 8  # up to this number of symmetries, all are measured with all points
ALIKE = 1.25  # symmetries are tried up to this multiple of the least root mean square distance
TRIED, TRIED_POINTS, MEASURED = 24, 300, 2  # of many symmetries: tried ones, points per try, fully measured ones
AT_ONCE = 32  # transforms applied to all points at once
POSTERIOR_METRICS = ("nll_nats", "credible_level", "entropy_nats", "expected_error_m", "spread_m")
LEVELS = (0.5, 0.8, 0.95)
SURFACE_POINTS = 10_000  # for ADD
METRICS = ("surface", "add", "mssd")  # of an answer
GAP_POINTS = 2000  # points of the surface, whose distances are averaged
STEP_M = 2e-5  # step along a continuous symmetry to find the nearest symmetric pose

Points = NDArray[np.float64]


def compute_add(points_m: Points, T1: Poses, T2: Poses) -> NDArray[np.float64]:
    """Return ADD without symmetry (...,): mean distance, metres, of object points (P, 3) at two poses (..., 4, 4)."""
    return np.linalg.norm(transform_points(T1, points_m) - transform_points(T2, points_m), axis=-1).mean(axis=-1)


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
            compute_mssd(self.object, self.object.mesh.hull_corners_m, poses, T_true),
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
