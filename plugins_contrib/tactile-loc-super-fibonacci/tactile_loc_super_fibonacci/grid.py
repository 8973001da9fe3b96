"""The pose grid for a touch anywhere on the object: super-Fibonacci rotations times a lattice of the plane."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import AllRotationsGrid, ObjectModel, SensorGeometry

from tactile_loc_super_fibonacci.spirals import fibonacci_directions, rotations_of_axis, super_fibonacci_rotations

Float = NDArray[np.float64]

SO3_VOLUME, SPHERE_AREA = 8 * np.pi**2, 4 * np.pi  # in radians: cubed, of all rotations; squared, of all directions


class SuperFibonacciGrid(AllRotationsGrid):
    """All of SO(3) times the plane: as many rotations as the spacing needs, or as were asked for."""

    name = "super-fibonacci"

    class Options(AllRotationsGrid.Options):
        """With `rotations`, `spacing_mm` is that of the plane alone."""

        rotations: int | None = Field(
            default=None, ge=1, le=10_000_000, description="take so many rotations, before equivalent ones are left out"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """With a number of rotations, these are what they are, and the spacing is that of the plane."""
        return self.options.rotations is None

    def rotations(self, obj: ObjectModel, spacing_m: float) -> Float:
        """Return R_sensor_object (K, 3, 3), about `spacing_m` metres of surface apart unless their number is given."""
        return spread_rotations(obj, self._count(obj, spacing_m))

    def least_poses(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Return how many poses there are at a spacing in metres if each rotation has one place."""
        return math.ceil(self._count(obj, spacing_m) / obj.symmetry.order)

    def advice(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> str:
        """Say what to choose where a spacing in metres makes too many poses."""
        return "take a greater spacing or fewer rotations"

    def _count(self, obj: ObjectModel, spacing_m: float) -> int:
        return self.options.rotations or rotations_for(obj, spacing_m)


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
    return kept if len(kept) else obj.symmetry.find_canonical(R[:1])
