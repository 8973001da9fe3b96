"""Base class for grids that combine a list of rotations from all of SO(3) with a plane lattice."""

import logging
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses, draw_rotations, make_transform
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.lattices import (
    compute_lattice_shape,
    find_reachable_translations,
    make_plane_lattice,
    require_spacing,
)
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.slots.grid import GridSampler

log = logging.getLogger(__name__)


MOST_DRAWN = 100_000  # largest number of rotations drawn at once
MOST_ROTATED = 1_000_000  # largest number of points rotated at once (24 MB)


class AllRotationsGrid(GridSampler):
    """Base class for grids of all rotations and all positions, for a touch anywhere on the object.

    A subclass lists the `rotations`. Its own Options derive from `AllRotationsGrid.Options`. Its `name` appears in
    messages.
    """

    name: ClassVar[str]

    class Options(GridSampler.Options):
        """Options for the grid's density and its largest size."""

        # Half the spacing gives 32 times as many poses. The default is therefore coarser than for a grid of one face.
        spacing_mm: float = Field(default=8.0, gt=0, description="mean distance between neighbouring poses, mm")
        max_poses: int = Field(default=2_000_000, ge=1, description="refuse a grid with more poses than this")

    @abstractmethod
    def rotations(self, obj: ObjectModel, spacing_m: float) -> Floats:
        """Return rotations R_sensor_object (K, 3, 3), about `spacing_m` metres of surface motion apart.

        Of rotations that are equal by symmetry, only one is returned.
        """

    @abstractmethod
    def least_poses(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Return an approximate lower bound on the number of poses that `sample` makes at a spacing in metres."""

    @abstractmethod
    def advice(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> str:
        """Return the advice, such as "take ...", for the message that a spacing, metres, gives too many poses."""

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return poses (N, 4, 4), metres, about `spacing_m` metres apart.

        Of poses that are equal by symmetry, only one is returned. The object's centroid lies on a square lattice with
        the pitch `spacing_m`, at z = 0. Raises GridError if the spacing is below a micrometre, or if the grid would
        have more than `max_poses` poses.
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
    def place_counts(obj: ObjectModel, R: Floats, geometry: SensorGeometry, spacing_m: float) -> Ints:
        """Return the number (N,) of positions, `spacing_m` metres apart, over the sensor for rotations R (N, 3, 3)."""
        shapes = compute_lattice_shape(*find_centroid_range(obj, R, geometry), spacing_m)
        return np.asarray(shapes.prod(axis=-1))

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly over all rotations and positions over the sensor; z is arbitrary.

        A rotation is drawn in proportion to the area of its positions, as in the grid.
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


def find_centroid_range(obj: ObjectModel, R: Floats, geometry: SensorGeometry) -> tuple[Floats, Floats]:
    """Return the least and the greatest x, y (N, 2), metres, of the object's centroid for rotations R (N, 3, 3).

    Between these limits, in the sensor frame, the rotated object's bounding box overlaps the sensing rectangle.
    Elsewhere, contact is impossible.
    """
    points = obj.mesh.hull_corners_m - obj.mesh.centroid_m
    low, high = np.empty((len(R), 2)), np.empty((len(R), 2))
    step = max(1, MOST_ROTATED // len(points))
    for s in range(0, len(R), step):
        rotated = points @ np.swapaxes(R[s : s + step], -1, -2)
        low[s : s + step], high[s : s + step] = find_reachable_translations(rotated, geometry.rectangle)
    return low, high


def draw_places(
    obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator, rotations: Callable[[int], Floats]
) -> Poses:
    """Draw poses (count, 4, 4), metres, uniformly over rotations and positions over the sensor; z is arbitrary.

    `rotations(n)` draws R_sensor_object (n, 3, 3) uniformly. A drawn rotation is kept with a probability in proportion
    to the area of its positions, as in a grid. Otherwise, rotations with few positions would be drawn too often.
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


def _place_centroids(obj: ObjectModel, R: Floats, xy_m: Floats) -> Poses:
    """Return poses (N, 4, 4), metres, with rotations R (N, 3, 3) and the centroid at x, y (N, 2), z = 0."""
    centroid_m = np.column_stack([xy_m, np.zeros(len(xy_m))])
    return make_transform(R, centroid_m - R @ obj.mesh.centroid_m)
