"""Pose sets and the metric between poses: a pose is `T_sensor_object`, a distance is metres of surface.

The mean squared distance between an object's surface points at two poses is exactly a Euclidean distance in R^12.
With centroid c and covariance C = L L^T of the surface, phi(T) = [R L, R c + t] gives
||phi(T1) - phi(T2)||^2 = mean_p ||T1 p - T2 p||^2, so a KD-tree over phi answers "nearest pose" exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel

SPACING_SAMPLE = 1000
LEAF = 32  # points: a tenth faster than 16


@dataclass(frozen=True, eq=False)
class PoseMetric:
    """Root mean square distance, in metres, between an object's surface at two poses."""

    object: ObjectModel

    @cached_property
    def _lever(self) -> NDArray[np.float64]:
        values, vectors = np.linalg.eigh(self.object.mesh.covariance_m2)
        return vectors * np.sqrt(np.clip(values, 0.0, None))

    def embed(self, T_sensor_object: Poses) -> NDArray[np.float64]:
        """Map poses (N, 4, 4) to points phi (N, 12) in metres; Euclidean distance there is the metric."""
        R, t = np.ascontiguousarray(T_sensor_object[..., :3, :3]), T_sensor_object[..., :3, 3]
        rotated = (R.reshape(-1, 3) @ self._lever).reshape(*R.shape[:-2], 9)  # one large product is faster
        return np.concatenate([rotated, R @ self.object.mesh.centroid_m + t], axis=-1)

    def embed_orbits(self, T_sensor_object: Poses) -> NDArray[np.float64]:
        """Map poses (N, 4, 4) to points (K, N, D), metres, one row for each of K equivalents by symmetry.

        The distance up to symmetry is the least over K between these and the first row of other poses. Without a
        continuous axis, these are phi (D = 12) of all equivalents. With one, all rotations about it are one point
        (D = 6): the least squared distance over them is that between [r R a, R c + t]. Here a is the unit axis, c the
        centroid and r^2 = (trace C + a^T C a) / 2. This is exact, because C is the same in all directions across the
        axis.
        """
        symmetry = self.object.symmetry
        if symmetry.continuous_axis is None:
            return self.embed(T_sensor_object[None] @ symmetry.list_elements()[:, None])
        a, C, centre = symmetry.continuous_axis, self.object.mesh.covariance_m2, symmetry.centre_m
        lever_m = np.sqrt(0.5 * (np.trace(C) + a @ C @ a))
        offset = a * (a @ (self.object.mesh.centroid_m - centre))
        R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
        columns = [(lever_m * R @ S @ a, R @ (centre + S @ offset) + t) for S in symmetry.rotations]
        return np.stack([np.concatenate(pair, axis=-1) for pair in columns])

    def distance(self, T1: Poses, T2: Poses) -> NDArray[np.float64]:
        """Return the distance (...,), metres, between poses (..., 4, 4), without symmetry."""
        return np.linalg.norm(self.embed(T1) - self.embed(T2), axis=-1)

    def equivalents(self, T_sensor_object: Poses, step_m: float) -> Poses:
        """Return the poses (K, N, 4, 4) that look the same as T (N, 4, 4) by symmetry.

        For a continuous symmetry, neighbouring equivalents are at most `step_m` metres apart.
        """
        lever_m = np.sqrt(np.trace(self.object.mesh.covariance_m2))
        S = self.object.symmetry.list_elements(max_step_rad=float(step_m / lever_m))
        return T_sensor_object[None] @ S[:, None]

    def nearest_equivalents(self, T_sensor_object: Poses, T_near: Poses, step_m: float = 1e-4) -> Poses:
        """Return, for each pose (N, 4, 4), the equivalent (N, 4, 4) that is nearest to T_near (N, 4, 4).

        A continuous symmetry is sampled at most `step_m` metres apart.
        """
        same = self.equivalents(T_sensor_object, step_m)
        far = np.linalg.norm(
            self.embed(same.reshape(-1, 4, 4)).reshape(*same.shape[:2], -1) - self.embed(T_near), axis=-1
        )
        return np.asarray(same[far.argmin(axis=0), np.arange(len(T_near))])

    def symmetric_distance(self, T1: Poses, T2: Poses) -> NDArray[np.float64]:
        """Return the distance (N,), metres, between poses (N, 4, 4): exactly the least over the symmetry group."""
        return np.linalg.norm(self.embed_orbits(T1) - self.embed_orbits(T2)[0], axis=-1).min(axis=0)


@keep_old_names(raised="raise_level", within="find_within")
@dataclass(frozen=True, eq=False)
class PoseGrid:
    """The discrete contact poses that are searched: `T_sensor_object` (N, 4, 4), metres. Raises GridError if empty."""

    T_sensor_object: Poses
    metric: PoseMetric
    _level: tuple[PoseGrid, float] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if len(self.T_sensor_object) == 0:
            raise GridError(
                f"no pose of {self.metric.object.name} is left in the grid; choose another face or a finer spacing"
            )

    def __len__(self) -> int:
        return len(self.T_sensor_object)

    def raise_level(self, height_m: float) -> PoseGrid:
        """Return the grid with all poses `height_m` metres farther along z; the search trees are shared."""
        if height_m == 0.0:
            return self
        T = self.T_sensor_object.copy()
        T[:, 2, 3] += height_m
        level, height = (self, 0.0) if self._level is None else self._level
        return PoseGrid(T, self.metric, (level, height + height_m))

    def _move_to_level(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points (..., D) of the metric's space to the level of the search trees."""
        if self._level is None:
            return points
        lowered = points.copy()
        lowered[..., -1] -= self._level[1]  # the last coordinate is the centroid's z
        return lowered

    @cached_property
    def phi(self) -> NDArray[np.float64]:
        """The grid in the metric's space, (N, 12) metres."""
        return self.metric.embed(self.T_sensor_object)

    @cached_property
    def _tree(self) -> Any:
        if self._level is not None:
            return self._level[0]._tree
        from scipy.spatial import cKDTree

        return cKDTree(self.phi, leafsize=LEAF)

    @cached_property
    def _orbit_tree(self) -> Any:
        if self._level is not None:
            return self._level[0]._orbit_tree
        from scipy.spatial import cKDTree

        if self.metric.object.symmetry.continuous_axis is None:
            return self._tree
        return cKDTree(self.metric.embed_orbits(self.T_sensor_object)[0], leafsize=LEAF)

    def nearest(
        self, T_sensor_object: Poses, within_m: float = np.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return distance (M,), metres, and index (M,) of the grid pose nearest to poses (M, 4, 4), up to symmetry.

        If none is nearer than `within_m` metres, the distance is inf and the index -1. A bound makes the search faster.
        """
        points = self._move_to_level(self.metric.embed_orbits(T_sensor_object))
        distances, indices = self._orbit_tree.query(points, distance_upper_bound=within_m)
        best = distances.argmin(axis=0)
        columns = np.arange(len(best))
        distance, index = distances[best, columns], indices[best, columns]
        return distance, np.where(np.isfinite(distance), index, -1)

    @cached_property
    def spacing_m(self) -> float:
        """Mean distance, metres, between neighbouring poses, up to symmetry; inf for a single pose.

        For a large grid, it is measured on some poses, evenly spread over its order.
        """
        if self._level is not None:
            return self._level[0].spacing_m
        some = np.linspace(0, len(self) - 1, min(len(self), SPACING_SAMPLE)).astype(int)
        points = self.metric.embed_orbits(self.T_sensor_object[some])[0]
        return float(self._orbit_tree.query(points, k=2)[0][:, 1].mean())

    def distances(self, T_sensor_object: Poses) -> NDArray[np.float64]:
        """Return the distances (N,), metres, of all grid poses from one pose (4, 4), up to symmetry."""
        same = self._move_to_level(self.metric.embed_orbits(T_sensor_object[None])[:, 0])
        return np.asarray(measure_distances(self._orbit_tree.data, same).min(axis=1))

    def neighbour_spacing(self, subset: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
        """Return each pose's distance (N,), metres, to its nearest other pose (of `subset` indices, or of all)."""
        points = self.phi if subset is None else self.phi[subset]
        distances: NDArray[np.float64] = self._tree.query(self._move_to_level(points), k=2)[0]
        return distances[:, 1]

    def find_within(self, radius_m: float, index: int) -> NDArray[np.int64]:
        """Return the indices (K,) of poses within `radius_m` metres of grid pose `index`, up to symmetry."""
        same = self.metric.embed_orbits(self.T_sensor_object[index : index + 1])[:, 0]
        found = self._orbit_tree.query_ball_point(self._move_to_level(same), radius_m)
        return np.unique(np.concatenate([np.asarray(f, np.int64) for f in found]))


def measure_distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Euclidean distances (A, B) between points (A, D) and (B, D), with a relative error of about 1e-8."""
    squared = (a * a).sum(axis=1)[:, None] - 2 * (a @ b.T) + (b * b).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def remove_equivalent(T_sensor_object: Poses, metric: PoseMetric, radius_m: float) -> NDArray[np.bool_]:
    """Mark (N,) which poses (N, 4, 4) to keep, so that no two of them are within `radius_m` metres, up to symmetry."""
    keep = np.ones(len(T_sensor_object), bool)
    if len(keep) == 0 or metric.object.symmetry.is_trivial:
        return keep
    grid = PoseGrid(T_sensor_object, metric)
    for i in range(len(keep)):
        if keep[i]:
            twins = grid.find_within(radius_m, i)
            keep[twins[twins > i]] = False
    return keep
