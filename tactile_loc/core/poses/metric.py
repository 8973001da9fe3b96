"""Pose grids, and the metric between poses: the root mean square distance, metres, of the object's surface points.

The mean squared distance between an object's surface points at two poses is exactly a squared Euclidean distance in
R^12. With centroid c and covariance C = L L^T of the surface, phi(T) = [R L, R c + t] gives
||phi(T1) - phi(T2)||^2 = mean_p ||T1 p - T2 p||^2. A KD-tree over phi therefore finds nearest poses exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Floats, Ints, Poses, make_transform, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import GridError

SPACING_SAMPLE = 1000
LEAF = 32  # points in a leaf of a search tree; a tenth faster than 16
FEW_PAIRS = 10_000  # pairs of poses; only with more of them, a search tree is worth its import and construction


@dataclass(frozen=True, eq=False)
class PoseMetric:
    """The root mean square distance, metres, between an object's surface points at two poses.

    No rotation of a sphere about its centre counts, even where other symmetries are ignored.
    """

    object: ObjectModel

    @cached_property
    def _lever(self) -> Floats:
        if self.object.symmetry.is_sphere:
            return np.zeros((3, 3))
        values, vectors = np.linalg.eigh(self.object.mesh.covariance_m2)
        return vectors * np.sqrt(np.clip(values, 0.0, None))

    def embed(self, T_sensor_object: Poses) -> Floats:
        """Map poses (N, 4, 4) to points phi (N, 12), metres. The Euclidean distance of two points is the metric."""
        R, t = np.ascontiguousarray(T_sensor_object[..., :3, :3]), T_sensor_object[..., :3, 3]
        rotated = (R.reshape(-1, 3) @ self._lever).reshape(*R.shape[:-2], 9)  # one large product is faster
        return np.concatenate([rotated, R @ self.object.mesh.centroid_m + t], axis=-1)

    def embed_orbits(self, T_sensor_object: Poses) -> Floats:
        """Map poses (N, 4, 4) to points (K, N, D), metres, one row for each of K equivalents by symmetry.

        To compare two poses up to symmetry, take the first point of one pose and all K points of the other. The least
        Euclidean distance between them is the distance of the poses.

        Without a continuous axis of symmetry, the points are phi (D = 12) of all equivalents. With a continuous axis,
        all rotations about it have one point (D = 6), [r R a, R c + t]. Here a is the unit axis, c the centroid, C the
        surface's covariance and r^2 = (trace C + a^T C a) / 2. The distance of two such points is exactly the least
        over these rotations, because C is isotropic perpendicular to the axis.
        """
        symmetry = self.object.symmetry
        if symmetry.is_sphere:
            return self.embed(T_sensor_object)[None]
        if symmetry.continuous_axis is None:
            return self.embed(T_sensor_object[None] @ symmetry.list_elements()[:, None])
        a, C, centre = symmetry.continuous_axis, self.object.mesh.covariance_m2, symmetry.centre_m
        lever_m = np.sqrt(0.5 * (np.trace(C) + a @ C @ a))
        offset = a * (a @ (self.object.mesh.centroid_m - centre))
        R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
        columns = [(lever_m * R @ S @ a, R @ (centre + S @ offset) + t) for S in symmetry.rotations]
        return np.stack([np.concatenate(pair, axis=-1) for pair in columns])

    def distance(self, T1: Poses, T2: Poses) -> Floats:
        """Return the distances (...), metres, between poses T1 and T2 (..., 4, 4), ignoring symmetry."""
        return np.linalg.norm(self.embed(T1) - self.embed(T2), axis=-1)

    def equivalents(self, T_sensor_object: Poses, step_m: float) -> Poses:
        """Return the K poses (K, N, 4, 4) that look the same as each pose (N, 4, 4) by symmetry.

        For a continuous symmetry, neighbouring equivalents are at most `step_m` metres apart.
        """
        lever_m = np.sqrt(np.trace(self.object.mesh.covariance_m2))
        S = self.object.symmetry.list_elements(max_step_rad=float(step_m / lever_m))
        return T_sensor_object[None] @ S[:, None]

    def nearest_equivalents(self, T_sensor_object: Poses, T_near: Poses, step_m: float = 1e-4) -> Poses:
        """Return, for each pose (N, 4, 4), the equivalent (N, 4, 4) that is nearest to T_near (N, 4, 4).

        A continuous symmetry is sampled at most `step_m` metres apart. The equivalent of a sphere is exact.
        """
        symmetry = self.object.symmetry
        if symmetry.is_sphere:
            centres_m = transform_points(T_sensor_object, symmetry.centre_m[None])[:, 0]
            return make_transform(T_near[:, :3, :3], centres_m - T_near[:, :3, :3] @ symmetry.centre_m)
        same = self.equivalents(T_sensor_object, step_m)
        far = np.linalg.norm(
            self.embed(same.reshape(-1, 4, 4)).reshape(*same.shape[:2], -1) - self.embed(T_near), axis=-1
        )
        return np.asarray(same[far.argmin(axis=0), np.arange(len(T_near))])

    def symmetric_distance(self, T1: Poses, T2: Poses) -> Floats:
        """Return the exact distances (N,), metres, between poses T1 and T2 (N, 4, 4), up to symmetry."""
        return np.linalg.norm(self.embed_orbits(T1) - self.embed_orbits(T2)[0], axis=-1).min(axis=0)


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
        """Return the grid with all poses moved `height_m` metres along z. Both grids share their search trees."""
        if height_m == 0.0:
            return self
        T = self.T_sensor_object.copy()
        T[:, 2, 3] += height_m
        level, height = (self, 0.0) if self._level is None else self._level
        return PoseGrid(T, self.metric, (level, height + height_m))

    def _move_to_level(self, points: Floats) -> Floats:
        """Map points (..., D) of the metric's space to the level of the search trees."""
        if self._level is None:
            return points
        lowered = points.copy()
        lowered[..., -1] -= self._level[1]  # the last coordinate is the centroid's z
        return lowered

    @cached_property
    def phi(self) -> Floats:
        """The points (N, 12), metres, of the grid's poses in the metric's space."""
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
        return cKDTree(self._orbit_points, leafsize=LEAF)

    @cached_property
    def _orbit_points(self) -> Floats:
        """The points of `_orbit_tree`."""
        if self._level is not None:
            return self._level[0]._orbit_points
        return self.metric.embed_orbits(self.T_sensor_object)[0]

    def nearest(self, T_sensor_object: Poses, within_m: float = np.inf) -> tuple[Floats, Ints]:
        """Return the distance (M,), metres, and the index (M,) of the grid pose nearest to each pose (M, 4, 4).

        Distances are up to symmetry. If no grid pose is nearer than `within_m` metres, the distance is inf and the
        index is -1. A small `within_m` makes the search faster.
        """
        points = self._move_to_level(self.metric.embed_orbits(T_sensor_object))
        if len(T_sensor_object) * len(self) <= FEW_PAIRS:
            whole = np.linalg.norm(points[..., None, :] - self._orbit_points, axis=-1)
            indices, distances = whole.argmin(axis=-1), whole.min(axis=-1)
            distances[distances >= within_m] = np.inf
        else:
            distances, indices = self._orbit_tree.query(points, distance_upper_bound=within_m)
        best = distances.argmin(axis=0)
        columns = np.arange(len(best))
        distance, index = distances[best, columns], indices[best, columns]
        return distance, np.where(np.isfinite(distance), index, -1)

    @cached_property
    def spacing_m(self) -> float:
        """The mean distance, metres, between neighbouring poses, up to symmetry; inf for a single pose.

        In a large grid, it is measured on SPACING_SAMPLE poses at equal steps of the index.
        """
        if self._level is not None:
            return self._level[0].spacing_m
        if len(self) <= SPACING_SAMPLE:  # a tree would only take longer
            points = self._orbit_points
            distances_m = measure_distances(points, points)
            np.fill_diagonal(distances_m, np.inf)
            return float(distances_m.min(axis=1).mean())
        some = np.linspace(0, len(self) - 1, SPACING_SAMPLE).astype(int)
        points = self.metric.embed_orbits(self.T_sensor_object[some])[0]
        return float(self._orbit_tree.query(points, k=2)[0][:, 1].mean())

    def distances(self, T_sensor_object: Poses) -> Floats:
        """Return the distances (N,), metres, of all grid poses from one pose (4, 4), up to symmetry."""
        same = self._move_to_level(self.metric.embed_orbits(T_sensor_object[None])[:, 0])
        return np.asarray(measure_distances(self._orbit_points, same).min(axis=1))

    def neighbour_spacing(self, subset: Ints | None = None) -> Floats:
        """Return the distance (N,), metres, between each pose and the nearest other pose of the grid.

        Symmetry is ignored. If `subset` (N,) is given, only the poses with these indices get a distance.
        """
        points = self.phi if subset is None else self.phi[subset]
        distances: Floats = self._tree.query(self._move_to_level(points), k=2)[0]
        return distances[:, 1]

    def find_within(self, radius_m: float, index: int) -> Ints:
        """Return the indices (K,) of poses within `radius_m` metres of grid pose `index`, up to symmetry."""
        same = self.metric.embed_orbits(self.T_sensor_object[index : index + 1])[:, 0]
        found = self._orbit_tree.query_ball_point(self._move_to_level(same), radius_m)
        return np.unique(np.concatenate([np.asarray(f, np.int64) for f in found]))


def measure_distances(a: Floats, b: Floats) -> Floats:
    """Return the Euclidean distances (A, B) between points (A, D) and (B, D), with a relative error of about 1e-8."""
    squared = (a * a).sum(axis=1)[:, None] - 2 * (a @ b.T) + (b * b).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def remove_equivalent(T_sensor_object: Poses, metric: PoseMetric, radius_m: float) -> Bools:
    """Return which poses (N, 4, 4) to keep (N,), so that no two kept poses are equal by symmetry.

    Poses within `radius_m` metres of each other, up to symmetry, count as equal. If the object has no symmetry, all
    poses are kept.
    """
    keep = np.ones(len(T_sensor_object), bool)
    if len(keep) == 0 or metric.object.symmetry.is_trivial:
        return keep
    grid = PoseGrid(T_sensor_object, metric)
    for i in range(len(keep)):
        if keep[i]:
            twins = grid.find_within(radius_m, i)
            keep[twins[twins > i]] = False
    return keep
