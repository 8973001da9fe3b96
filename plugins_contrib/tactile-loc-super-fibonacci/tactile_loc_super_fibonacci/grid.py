"""The pose grid for a touch anywhere on the object: each super-Fibonacci rotation at each point of a planar lattice."""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import ObjectModel, SensorGeometry
from tactile_loc.plugin.helpers import AllRotationsGrid

from tactile_loc_super_fibonacci.spirals import fibonacci_directions, rotations_of_axis, super_fibonacci_rotations

Float = NDArray[np.float64]

SO3_VOLUME, SPHERE_AREA = 8 * np.pi**2, 4 * np.pi  # volume of all rotations, rad^3; area of all directions, rad^2


class SuperFibonacciGrid(AllRotationsGrid):
    """All of SO(3) times the plane. The number of rotations is given, or follows from the spacing."""

    name = "super-fibonacci"

    class Options(AllRotationsGrid.Options):
        """If `rotations` is given, `spacing_mm` applies only to the plane."""

        rotations: int | None = Field(
            default=None, ge=1, le=10_000_000, description="number of rotations before removing equivalent ones"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """Whether `spacing_mm` is a mean over all poses. If `rotations` is given, it applies only to the plane."""
        return self.options.rotations is None

    def rotations(self, obj: ObjectModel, spacing_m: float) -> Float:
        """Return rotations R_sensor_object (K, 3, 3). Unless `rotations` is given, the spacing is about `spacing_m`."""
        return spread_rotations(obj, self._count(obj, spacing_m))

    def least_poses(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Return the number of poses at a spacing in metres if each rotation has only one place."""
        return math.ceil(self._count(obj, spacing_m) / obj.symmetry.order)

    def advice(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> str:
        """Return advice for a spacing in metres that gives too many poses."""
        return "choose a larger spacing or fewer rotations"

    def _count(self, obj: ObjectModel, spacing_m: float) -> int:
        return self.options.rotations or rotations_for(obj, spacing_m)


def rotations_for(obj: ObjectModel, spacing_m: float) -> int:
    """Return the number of rotations for a spacing of about `spacing_m` metres on the surface, before symmetry.

    A small rotation about a principal axis moves the surface by the angle times the axis's lever. Therefore each
    rotation covers a volume spacing^3 / (product of the levers) of SO(3). With a continuous symmetry, directions of the
    symmetry axis are counted in the same way.
    """
    moments = np.linalg.eigvalsh(obj.mesh.covariance_m2)
    levers_m = np.sqrt(np.clip(moments.sum() - moments, 1e-18, None))
    if obj.symmetry.continuous_axis is None:
        return max(1, round(SO3_VOLUME * float(np.prod(levers_m / spacing_m))))
    axis, covariance = obj.symmetry.continuous_axis, obj.mesh.covariance_m2
    across_m2 = 0.5 * float(np.trace(covariance) + axis @ covariance @ axis)
    return max(1, round(SPHERE_AREA * across_m2 / spacing_m**2))


def spread_rotations(obj: ObjectModel, count: int) -> Float:
    """Return rotations R_sensor_object (K, 3, 3): `count` rotations without symmetric duplicates, but at least one.

    With a continuous symmetry, the rotations bring the symmetry axis to `count` directions.
    """
    axis = obj.symmetry.continuous_axis
    if axis is None:
        R = super_fibonacci_rotations(count)
        kept = R[obj.symmetry.is_representative(R)]
    else:
        R = rotations_of_axis(axis, fibonacci_directions(count))
        kept = R[obj.symmetry.is_representative(R, step_rad=2 * np.pi)]
    return kept if len(kept) else R[:1]
