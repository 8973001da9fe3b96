"""The pose grid for a touch anywhere on the object: super-Fibonacci rotations times a lattice of the plane."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry import random_rotations
from tactile_loc.core.interfaces import GridSampler
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

from tactile_loc_super_fibonacci.plane import lattice, lattice_counts, reachable, with_centroid_at
from tactile_loc_super_fibonacci.spirals import fibonacci_directions, rotations_of_axis, super_fibonacci_rotations

Float = NDArray[np.float64]

SMALLEST_SPACING_M = 1e-6
SO3_VOLUME, SPHERE_AREA = 8 * np.pi**2, 4 * np.pi  # in radians: cubed, of all rotations; squared, of all directions
_MOST_DRAWN = 100_000  # rotations drawn at once


class SuperFibonacciGrid(GridSampler):
    """All of SO(3) times the plane: as many rotations as the spacing needs, or as were asked for."""

    class Options(GridSampler.Options):
        """With `rotations`, `spacing_mm` is that of the plane alone."""

        # Every halving makes 32 times as many poses, so this cannot be as fine as a grid of one face.
        spacing_mm: float = Field(default=8.0, gt=0, description="mean distance between neighbouring poses, mm")
        rotations: int | None = Field(
            default=None, ge=1, le=10_000_000, description="take so many rotations, before equivalent ones are left out"
        )
        max_poses: int = Field(default=2_000_000, ge=1, description="refuse a grid of more poses than this")

    @property
    def spacing_is_mean(self) -> bool:
        """With a number of rotations, these are what they are, and the spacing is that of the plane."""
        return self.options.rotations is None

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return poses (N, 4, 4), about `spacing_m` metres of surface apart, one for each class that looks the same.

        The centroid is on a square lattice of that pitch, at z = 0. Raises GridError when the spacing is below a
        micrometre, or when there would be more than `max_poses`, before any are made.
        """
        if not (np.isfinite(spacing_m) and spacing_m >= SMALLEST_SPACING_M):
            raise GridError(f"the grid's spacing is {spacing_m * 1e3:g} mm; give one of at least 0.001 mm")
        count = self.options.rotations or rotations_for(obj, spacing_m)
        self._refuse_too_many(count / obj.symmetry.order, obj, spacing_m)
        R = spread_rotations(obj, count)
        low, high = reachable(obj, R, geometry)
        places = lattice_counts(low, high, spacing_m).prod(axis=-1)
        self._refuse_too_many(int(places.sum()), obj, spacing_m)
        xy = np.concatenate([lattice(a, b, spacing_m) for a, b in zip(low, high, strict=True)])
        return with_centroid_at(obj, np.repeat(R, places, axis=0), xy)

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly over all rotations and places where the boxes overlap; z is free.

        A rotation is drawn as often as its region is large, as the grid has it.
        """
        drawn = list(_draw(obj, geometry, count, rng))
        return np.concatenate([np.empty((0, 4, 4)), *drawn])[:count]

    def _refuse_too_many(self, count: float, obj: ObjectModel, spacing_m: float) -> None:
        if count <= self.options.max_poses:
            return
        raise GridError(
            f"the super-fibonacci grid of {obj.name} at a spacing of {spacing_m * 1e3:.3g} mm needs at least "
            f"{count:,.0f} poses, over the limit of {self.options.max_poses:,}; take a greater spacing or fewer "
            "rotations, raise max_poses, or choose the face grid if the face that touches is known"
        )


def rotations_for(obj: ObjectModel, spacing_m: float) -> int:
    """Return how many rotations of an object are about `spacing_m` metres of surface apart, before symmetry.

    A small turn about a principal axis moves the surface by the angle times that axis' lever, so each rotation may
    stand for a volume of spacing^3 / (the levers' product) of SO(3); of directions alike, if a continuous symmetry
    leaves nothing else of a rotation.
    """
    moments = np.linalg.eigvalsh(obj.mesh.covariance_m2)
    levers_m = np.sqrt(np.clip(moments.sum() - moments, 1e-18, None))
    if obj.symmetry.continuous_axis is None:
        return max(1, round(SO3_VOLUME * float(np.prod(levers_m / spacing_m))))
    axis, covariance = obj.symmetry.continuous_axis, obj.mesh.covariance_m2
    across_m2 = 0.5 * float(np.trace(covariance) + axis @ covariance @ axis)
    return max(1, round(SPHERE_AREA * across_m2 / spacing_m**2))


def spread_rotations(obj: ObjectModel, count: int) -> Float:
    """Return R_sensor_object (K, 3, 3): those of `count` rotations that stand for their equivalents by symmetry.

    With a continuous symmetry, of `count` directions of its axis; one always stays.
    """
    axis = obj.symmetry.continuous_axis
    if axis is None:
        R = super_fibonacci_rotations(count)
        kept = R[obj.symmetry.is_representative(R)]
    else:
        R = rotations_of_axis(axis, fibonacci_directions(count))
        kept = R[obj.symmetry.is_representative(R, step_rad=2 * np.pi)]
    return kept if len(kept) else obj.symmetry.canonical(R[:1])


def _draw(obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Iterator[Poses]:
    """Yield batches of random poses, at least `count` in all: a rotation is kept by the area of its region."""
    x0, x1, y0, y1 = geometry.rectangle
    longest_m = float(np.linalg.norm(obj.mesh.extents_m))
    bound_m2 = (x1 - x0 + longest_m) * (y1 - y0 + longest_m)
    while count > 0:
        R = random_rotations(min(max(2 * count, 64), _MOST_DRAWN), rng)
        low, high = reachable(obj, R, geometry)
        kept = rng.random(len(R)) * bound_m2 < (high - low).prod(axis=-1)
        xy = rng.uniform(low[kept], high[kept])
        yield with_centroid_at(obj, R[kept], xy)
        count -= int(kept.sum())
