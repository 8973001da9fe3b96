"""Base class for grids that combine a list of rotations from all of SO(3) with a plane lattice."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.deprecation import make_getattr
from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry.rigid import Poses, draw_rotations, make_transform
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.lattices import (
    compute_lattice_shape,
    find_reachable_translations,
    make_plane_lattice,
    require_spacing,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.slots.grid import GridSampler

log = logging.getLogger(__name__)

Float = NDArray[np.float64]

MOST_DRAWN = 100_000  # rotations drawn at once
MOST_ROTATED = 1_000_000  # points rotated at once: 24 MB


class AllRotationsGrid(GridSampler):
    """All of SO(3) times the plane, for a touch anywhere on the object; a subclass lists the `rotations`.

    A subclass's options derive from this class's, and its `name` appears in messages.
    """

    name: ClassVar[str]

    class Options(GridSampler.Options):
        """How dense the grid is, and when it is too large."""

        # Half the spacing gives 32 times as many poses, so it cannot be as fine as that of a grid of one face.
        spacing_mm: float = Field(default=8.0, gt=0, description="mean distance between neighbouring poses, mm")
        max_poses: int = Field(default=2_000_000, ge=1, description="refuse a grid with more poses than this")

    @abstractmethod
    def rotations(self, obj: ObjectModel, spacing_m: float) -> Float:
        """Return R_sensor_object (K, 3, 3), about `spacing_m` metres of surface apart, one of each equivalent set."""

    @abstractmethod
    def least_poses(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Return a lower bound, which may be approximate, on the poses from `sample` at a spacing in metres."""

    @abstractmethod
    def advice(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> str:
        """Return advice for a message, "take ...", if a spacing in metres makes too many poses."""

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return poses (N, 4, 4), about `spacing_m` metres of surface apart, one of each set that looks the same.

        The centroids are on square lattices of that pitch, at z = 0. Raises GridError, before any pose is made, for a
        spacing below a micrometre or more than `max_poses` poses.
        """
        require_spacing(spacing_m)
        self._refuse_too_many(self.least_poses(obj, geometry, spacing_m), obj, geometry, spacing_m)
        R = self.rotations(obj, spacing_m)
        low, high = find_centroid_range(obj, R, geometry)
        counts = self.place_counts(obj, R, geometry, spacing_m)
        self._refuse_too_many(int(counts.sum()), obj, geometry, spacing_m)
        log.info("%s grid of %s: %d rotations, %d poses before contact", self.name, obj.name, len(R), counts.sum())
        xy = np.concatenate([make_plane_lattice(a, b, spacing_m) for a, b in zip(low, high, strict=True)])
        return _place_centroids(obj, np.repeat(R, counts, axis=0), xy)

    @staticmethod
    def place_counts(obj: ObjectModel, R: Float, geometry: SensorGeometry, spacing_m: float) -> NDArray[np.int64]:
        """Return how many places (N,), `spacing_m` metres apart, rotations R (N, 3, 3) have over the sensor."""
        shapes = compute_lattice_shape(*find_centroid_range(obj, R, geometry), spacing_m)
        return np.asarray(shapes.prod(axis=-1))

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly over all rotations and places where the boxes overlap; z is free.

        A rotation is drawn in proportion to the area of its places, as in the grid.
        """
        return draw_places(obj, geometry, count, rng, lambda n: draw_rotations(n, rng))

    def _refuse_too_many(self, count: int, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> None:
        limit = self.options.max_poses
        if count > limit:
            raise GridError(
                f"the {self.name} grid of {obj.name} at a spacing of {spacing_m * 1e3:.3g} mm needs {count:,} poses or "
                f"more, over the limit of {limit:,}; {self.advice(obj, geometry, spacing_m)}, raise max_poses, or "
                "choose the face grid if you know the face that touches"
            )


def find_centroid_range(obj: ObjectModel, R: Float, geometry: SensorGeometry) -> tuple[Float, Float]:
    """Return low and high (N, 2), metres, of the centroid's x, y in the sensor frame for R_sensor_object (N, 3, 3).

    Between them, the rotated object's bounding box overlaps the sensing rectangle. Outside, contact is impossible.
    """
    points = obj.mesh.hull_corners_m - obj.mesh.centroid_m
    low, high = np.empty((len(R), 2)), np.empty((len(R), 2))
    step = max(1, MOST_ROTATED // len(points))
    for s in range(0, len(R), step):
        rotated = points @ np.swapaxes(R[s : s + step], -1, -2)
        low[s : s + step], high[s : s + step] = find_reachable_translations(rotated, geometry.rectangle)
    return low, high


def draw_places(
    obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator,
    rotations: Callable[[int], Float],
) -> Poses:  # fmt: skip
    """Draw poses (count, 4, 4), metres, uniformly over rotations and the places where the boxes overlap; z is free.

    `rotations(n)` draws R_sensor_object (n, 3, 3) uniformly. Each is kept in proportion to the area of its places, as
    in a grid; otherwise rotations with few places would be drawn too often.
    """
    x0, x1, y0, y1 = geometry.rectangle
    longest_m = float(np.linalg.norm(obj.mesh.extents_m))
    bound_m2 = (x1 - x0 + longest_m) * (y1 - y0 + longest_m)
    found = [np.empty((0, 4, 4))]
    while (missing := count - sum(map(len, found))) > 0:
        R = rotations(min(max(2 * missing, 64), MOST_DRAWN))
        low, high = find_centroid_range(obj, R, geometry)
        keep = rng.random(len(R)) * bound_m2 < (high - low).prod(axis=-1)
        found.append(_place_centroids(obj, R[keep], rng.uniform(low[keep], high[keep])))
    return np.concatenate(found)[:count]


def _place_centroids(obj: ObjectModel, R: Float, xy_m: Float) -> Poses:
    """Return poses (N, 4, 4), metres, of rotations (N, 3, 3) with centroids at x, y (N, 2) and z = 0."""
    centroid_m = np.column_stack([xy_m, np.zeros(len(xy_m))])
    return make_transform(R, centroid_m - R @ obj.mesh.centroid_m)


__getattr__ = make_getattr(__name__)
