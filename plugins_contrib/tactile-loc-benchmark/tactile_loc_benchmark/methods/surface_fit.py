"""Registration of touched points to an object's surface by point-to-plane ICP, for many poses at once, and its score.

ICP with planes is that of Chen and Medioni (1992). The score is that of MSAC (Torr and Zisserman, 2000): a point counts
less, the farther it is from the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation
from tactile_loc.plugin import ComponentOptions, ObjectModel, Poses, TouchError
from tactile_loc.plugin.helpers import (
    PoseMetric,
    SurfaceField,
    group_ties,
    invert,
    make_transform,
    merge_modes,
    rank_poses,
)

from tactile_loc_benchmark.interfaces import ScoredPoses
from tactile_loc_benchmark.methods.touched_points import TouchedPoints

REACH_M, CELL_M = 15e-3, 1e-3  # distance from the surface at which nearest points are known, and size of its cells
LEAST_COSINE = 0.5  # normals of corresponding points differ by at most 60 degrees
DAMPING = 1e-4  # share of the mean diagonal that is added to the diagonal
APART_M = 1e-3  # listed poses differ by at least this much (RMS distance of surface points)
TIE = 1e-6  # score; the rounding of another processor changes scores by less
LISTED = 10  # most poses of an answer
MOST_MERGED = 200  # poses that are compared with better poses
START_REACH_M, MIDDLE_REACH_M = 10e-3, 2e-3  # largest distances of corresponding points, at the start and half-way
COARSE_POINTS, COARSE_STEPS, FINE_STEPS = 60, 15, 15

Floats = NDArray[np.float64]


class FitOptions(ComponentOptions):
    """Options of methods that fit touched points to a surface."""

    points: int = Field(default=300, ge=3, description="most points of all touches together")
    inlier_mm: float = Field(default=0.5, gt=0, description="distance at which a point no longer supports a pose, mm")
    kept: int = Field(default=40, ge=1, description="number of poses that are registered to the end")


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """Fits touched points to the surface of an object."""

    object: ObjectModel
    field: SurfaceField
    options: FitOptions

    @classmethod
    def of(cls, obj: ObjectModel, options: FitOptions) -> SurfaceFit:
        """Build the field of nearest surface points."""
        return cls(obj, SurfaceField.of(obj.mesh, REACH_M, CELL_M), options)

    def find_best(self, T_first_object: Poses, points: TouchedPoints, reach_m: float = START_REACH_M) -> ScoredPoses:
        """Register poses (K, 4, 4), metres, that are wrong by about `reach_m`, and return the best in the base frame.

        All poses are registered with few points. The best `kept` of them are then registered with all points. Raises
        TouchError if no pose brings any point onto the surface.
        """
        few = points.thin(COARSE_POINTS)
        T = self.register(T_first_object, few, shrink(reach_m, MIDDLE_REACH_M, COARSE_STEPS))
        best = np.argsort(-self.score(T, few, MIDDLE_REACH_M), kind="stable")[: self.options.kept]
        T = self.register(T[best], points, shrink(MIDDLE_REACH_M, self.inlier_m, FINE_STEPS))
        scores = self.score(T, points, self.inlier_m)
        if scores.max(initial=0.0) <= 0:
            raise TouchError("no pose found: no pose brings the touched points onto the object's surface")
        return list_best(points.T_base_first @ T, scores, self.object)

    def sample_surface(self, count: int) -> tuple[Floats, Floats]:
        """Return points (count, 3), metres, of the object's surface, which are always the same, and their normals."""
        points_m = self.object.mesh.sample(count, np.random.default_rng(0))
        return points_m, self.field.triangles.normals[self.field.find_closest(points_m)[1]]

    @property
    def inlier_m(self) -> float:
        """The distance, metres, at which a point no longer supports a pose."""
        return 1e-3 * float(self.options.inlier_mm)

    def register(self, T_first_object: Poses, points: TouchedPoints, reaches_m: Floats) -> Poses:
        """Return poses (K, 4, 4), metres, after one step of ICP for each of `reaches_m` (S,).

        A point counts if the surface is nearer than the reach, metres, and if the normals agree.
        """
        T = invert(T_first_object)
        for reach_m in reaches_m:
            T = self._step(T, points, reach_m)
        return invert(T)

    def score(self, T_first_object: Poses, points: TouchedPoints, inlier_m: float) -> Floats:
        """Return scores (K,), 0 to 1, of poses (K, 4, 4), metres: the mean of 1 - (distance / `inlier_m`)^2."""
        x, nearest, _, agree = self._find_nearest(invert(T_first_object), points)
        squared = np.where(agree, np.sum((x - nearest) ** 2, axis=-1), np.inf)
        return np.asarray(np.maximum(0.0, 1.0 - squared / inlier_m**2) @ points.weights)

    def _step(self, T_object_first: Poses, points: TouchedPoints, reach_m: float) -> Poses:
        """Return the poses after a step of Gauss and Newton, in which the nearest surface points are planes."""
        x, nearest, normals, agree = self._find_nearest(T_object_first, points)
        off = np.einsum("kpi,kpi->kp", x - nearest, normals)
        near = agree & (np.sum((x - nearest) ** 2, axis=-1) < reach_m**2)
        w = np.where(near, points.weights, 0.0)
        middle = (w[..., None] * x).sum(axis=1) / np.maximum(w.sum(axis=1), 1e-12)[:, None]
        lever_m = np.sqrt(np.maximum((w * np.sum((x - middle[:, None]) ** 2, axis=-1)).sum(axis=1), 1e-8))
        arms = np.cross((x - middle[:, None]) / lever_m[:, None, None], normals)
        J = np.concatenate([arms, normals], axis=-1)
        A = np.swapaxes(J * w[..., None], -1, -2) @ J
        b = -np.einsum("kpi,kp->ki", J, w * off)
        A += (DAMPING * np.trace(A, axis1=-2, axis2=-1)[:, None, None] + 1e-9) * np.eye(6)
        moved = np.linalg.solve(A, b[..., None])[..., 0]
        R = Rotation.from_rotvec(moved[:, :3] / lever_m[:, None]).as_matrix()
        t = middle + moved[:, 3:] - (R @ middle[..., None])[..., 0]
        return np.asarray(make_transform(R, t) @ T_object_first)

    def _find_nearest(
        self, T_object_first: Poses, points: TouchedPoints
    ) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
        """Return the points (K, P, 3) in the object frame, the nearest surface points, their normals, and agreement.

        Points out of reach are their own nearest points, and do not agree.
        """
        R, t = T_object_first[:, :3, :3], T_object_first[:, None, :3, 3]
        x = points.points_m @ np.swapaxes(R, -1, -2) + t
        nearest, which = (found.reshape(*x.shape[:2], -1) for found in self.field.find_closest(x.reshape(-1, 3)))
        within = which[..., 0] >= 0
        normals = self.field.triangles.normals[which[..., 0]]
        turned = points.normals @ np.swapaxes(R, -1, -2)
        agree = within & (np.einsum("kpi,kpi->kp", turned, normals) > LEAST_COSINE)
        return x, np.where(within[..., None], nearest, x), normals, agree


def list_best(T_base_object: Poses, scores: Floats, obj: ObjectModel) -> ScoredPoses:
    """Return the poses (K, 4, 4), metres, with the highest scores (K,), without near copies of better poses.

    Scores that differ by at most TIE are equal, and listed so. The order of equal poses does not depend on rounding.
    """
    metric = PoseMetric(obj)
    order = rank_poses(group_ties(scores, TIE), T_base_object, metric)[:MOST_MERGED]
    merged = merge_modes(T_base_object[order], metric, APART_M, LISTED)
    kept = order[np.unique(merged[merged >= 0])]
    return ScoredPoses(T_base_object[kept], np.minimum.accumulate(scores[kept]))


def shrink(first_m: float, last_m: float, count: int) -> Floats:
    """Return lengths (count,), metres, that shrink by equal factors from the first to the last."""
    return np.geomspace(first_m, last_m, count)
