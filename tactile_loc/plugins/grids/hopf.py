"""The pose grid for a touch anywhere on the object: all of SO(3) times the plane, evenly in metres of surface."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry import make_transform, random_rotations
from tactile_loc.core.interfaces import GridSampler
from tactile_loc.core.lattices import lattice_shape, plane_lattice, reachable_translations
from tactile_loc.core.objects import LARGEST_M, ObjectModel, TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.plugins.grids.hopf_rotations import rotation_grid

Float = NDArray[np.float64]
SMALLEST_SPACING_M = 1e-6
_CHUNK = 100_000
_SAMPLE = 4096
_log = logging.getLogger(__name__)


def extreme_points(mesh: TriangleMesh) -> Float:
    """Return the vertices (V, 3) in metres that bound the surface from every side: those of its convex hull."""
    from scipy.spatial import ConvexHull, QhullError

    used: Float = mesh.vertices_m[np.unique(mesh.faces)]
    try:
        hull: Float = used[ConvexHull(used).vertices]
    except QhullError:  # a flat surface has no hull
        return used
    return hull


def centroid_range(obj: ObjectModel, R: Float, geometry: SensorGeometry) -> tuple[Float, Float]:
    """Return low and high (N, 2) in metres of the centroid's x, y in the sensor frame for R_sensor_object (N, 3, 3).

    Between them, the turned object's bounding box overlaps the sensing rectangle; beyond, there can be no contact.
    """
    points = extreme_points(obj.mesh) - obj.mesh.centroid_m
    low, high = np.empty((len(R), 2)), np.empty((len(R), 2))
    step = max(1, 1_000_000 // len(points))
    for s in range(0, len(R), step):
        turned = points @ np.swapaxes(R[s : s + step], -1, -2)
        low[s : s + step], high[s : s + step] = reachable_translations(turned, geometry.rectangle)
    return low, high


class HopfGrid(GridSampler):
    """All of SO(3) times the plane: for a touch anywhere on the object."""

    class Options(GridSampler.Options):
        """With a `level`, `spacing_mm` is that of the plane alone."""

        # Every halving makes 32 times as many poses, so this cannot be as fine as a grid of one face.
        spacing_mm: float = Field(default=8.0, gt=0, description="mean distance between neighbouring poses, mm")
        level: int | None = Field(
            default=None, ge=0, le=8, description="take 72 * 8^level rotations instead of those that meet the spacing"
        )
        max_poses: int = Field(default=2_000_000, ge=1, description="refuse a grid of more poses than this")

    @property
    def spacing_is_mean(self) -> bool:
        """With a level, the rotations are what they are, and the spacing is that of the plane."""
        return self.options.level is None

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return poses (N, 4, 4), about `spacing_m` metres of surface apart, one for each class that looks the same.

        The centroid is on a square lattice of that pitch, at z = 0. Raises GridError when the spacing is below a
        micrometre, or when there would be more than `max_poses`, before any are made.
        """
        if not (np.isfinite(spacing_m) and spacing_m >= SMALLEST_SPACING_M):
            raise GridError(f"the grid's spacing is {spacing_m * 1e3:g} mm; give one of at least 0.001 mm")
        self._refuse_too_many(self._count(obj, geometry, spacing_m), obj, geometry, spacing_m)
        R = rotation_grid(obj, spacing_m, self.options.level).all_representatives()
        low, high = centroid_range(obj, R, geometry)
        counts = lattice_shape(low, high, spacing_m).prod(axis=-1)
        self._refuse_too_many(int(counts.sum()), obj, geometry, spacing_m)
        _log.info("hopf grid of %s: %d rotations, %d poses before contact", obj.name, len(R), counts.sum())
        xy = np.concatenate([plane_lattice(a, b, spacing_m) for a, b in zip(low, high, strict=True)])
        return _poses_with_centroid_at(obj, np.repeat(R, counts, axis=0), xy)

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly over all rotations and places where the boxes overlap; z is free.

        A rotation is drawn as often as its region is large, as the grid has it.
        """
        x0, x1, y0, y1 = geometry.rectangle
        longest = float(np.linalg.norm(obj.mesh.extents_m))
        bound = (x1 - x0 + longest) * (y1 - y0 + longest)
        drawn = list(_draw(obj, geometry, count, bound, rng))
        return np.concatenate([np.empty((0, 4, 4)), *drawn])[:count]

    def _count(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Count the poses; of a big grid, only those at some of its rotations, in proportion."""
        rotations = rotation_grid(obj, spacing_m, self.options.level)
        total = len(rotations)
        some = np.arange(total) if total <= _SAMPLE else np.random.default_rng(0).integers(total, size=_SAMPLE)
        low, high = centroid_range(obj, rotations.representatives(some), geometry)
        return round(float(lattice_shape(low, high, spacing_m).prod(axis=-1).sum()) * total / len(some))

    def _refuse_too_many(self, count: int, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> None:
        limit, level = self.options.max_poses, self.options.level
        if count <= limit:
            return
        change = "take a lower level or a greater spacing"
        if level is None:
            change = f"take a spacing of {self._smallest_spacing_mm(obj, geometry, spacing_m):g} mm or more"
        raise GridError(
            f"the hopf grid of {obj.name} at a spacing of {spacing_m * 1e3:.3g} mm needs {count:,} poses, over the "
            f"limit of {limit:,}; {change}, raise max_poses, or choose the face grid if the face that touches is known"
        )

    def _smallest_spacing_mm(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> float:
        """Find a spacing, in millimetres of two digits, that keeps the limit: any of a dozen poses can be kept."""
        while spacing_m < LARGEST_M and self._count(obj, geometry, spacing_m) > 0.95 * self.options.max_poses:
            spacing_m = float(f"{1.1 * spacing_m:.1e}")
        return spacing_m * 1e3


def _draw(
    obj: ObjectModel, geometry: SensorGeometry, count: int, bound_m2: float, rng: np.random.Generator
) -> Iterator[Poses]:
    """Yield batches of random poses, at least `count` in all: rotations kept by area of their region over the bound."""
    while count > 0:
        R = random_rotations(min(max(2 * count, 64), _CHUNK), rng)
        low, high = centroid_range(obj, R, geometry)
        keep = rng.random(len(R)) * bound_m2 < (high - low).prod(axis=-1)
        xy = rng.uniform(low[keep], high[keep])
        yield _poses_with_centroid_at(obj, R[keep], xy)
        count -= int(keep.sum())


def _poses_with_centroid_at(obj: ObjectModel, R: Float, xy_m: Float) -> Poses:
    """Return poses (N, 4, 4) of rotations (N, 3, 3) whose centroid is at (x, y, 0) for `xy_m` (N, 2), sensor frame."""
    centroid = np.concatenate([xy_m, np.zeros((len(xy_m), 1))], axis=1)
    return make_transform(R, centroid - R @ obj.mesh.centroid_m)
