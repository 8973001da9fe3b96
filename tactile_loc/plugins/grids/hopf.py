"""The pose grid for a touch anywhere on the object: all rotations times the plane, evenly spaced in surface motion.

The method follows A. Yershova, S. Jain, S. M. LaValle and J. C. Mitchell, "Generating Uniform Incremental Grids on
SO(3) Using the Hopf Fibration", IJRR 2010, and K. M. Gorski et al., "HEALPix", ApJ 2005. A rotation consists of a spin
about z and of the direction to which z is rotated. A spin is a point of the circle S^1, and a direction is a point of
the sphere S^2. HEALPix divides the sphere into 12 nside^2 cells of equal area, where nside is any positive integer.
With `n_psi` spins, there are 12 nside^2 n_psi cells of equal volume. These are 72 * 8^level cells for nside = 2^level
and n_psi = 6 nside. Cells are numbered by (base pixel, x, y, spin).

A rotation by a small angle about an axis through the centroid moves the surface by this angle times a lever. The lever
is the surface's root mean square distance from the axis. The spin axis is the object's most distinct principal axis.
The steps of spins and of directions are the angles that move the surface by one spacing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import ObjectModel, SensorGeometry
from tactile_loc.plugin.helpers import AllRotationsGrid, align_to_z, quaternion_to_rotation

Float = NDArray[np.float64]
Int = NDArray[np.int64]

LARGEST_SPACING_M = 1.0  # largest suggested spacing: the largest size of an object
_SAMPLE = 4096  # rotations whose poses are counted in a large grid
_CHUNK = 100_000  # rotations made at once

BASE_PIXELS = 12
SPHERE_STEP_RAD = float(np.sqrt(4 * np.pi / BASE_PIXELS))  # width of a cell for nside = 1


class HopfGrid(AllRotationsGrid):
    """All rotations times the plane, for a touch anywhere on the object."""

    name = "hopf"

    class Options(AllRotationsGrid.Options):
        """With a `level`, `spacing_mm` applies to the plane only."""

        level: int | None = Field(
            default=None, ge=0, le=8, description="use 72 * 8^level rotations instead of a number from the spacing"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """False if `level` is given, because the spacing then applies to the plane only."""
        return self.options.level is None

    def rotations(self, obj: ObjectModel, spacing_m: float) -> Float:
        """Return R_sensor_object (K, 3, 3), about `spacing_m` of surface motion apart unless `level` is set."""
        return make_rotation_grid(obj, spacing_m, self.options.level).all_representatives()

    def least_poses(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> int:
        """Return the number of poses at a spacing in metres. In a large grid, it is estimated from some rotations."""
        rotations = make_rotation_grid(obj, spacing_m, self.options.level)
        total = len(rotations)
        some = np.arange(total) if total <= _SAMPLE else np.random.default_rng(0).integers(total, size=_SAMPLE)
        counts = self.place_counts(obj, rotations.representatives(some), geometry, spacing_m)
        return round(float(counts.sum()) * total / len(some))

    def advice(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> str:
        """Return advice for a grid with too many poses: a lower level, or a larger spacing in mm with two digits."""
        if self.options.level is not None:
            return "choose a lower level or a larger spacing"
        while spacing_m < LARGEST_SPACING_M and (
            self.least_poses(obj, geometry, spacing_m) > 0.95 * self.options.max_poses
        ):
            spacing_m = float(f"{1.1 * spacing_m:.1e}")
        return f"choose a spacing of {spacing_m * 1e3:g} mm or more"


def make_hopf_rotations(nside: int, n_psi: int, indices: Int) -> Float:
    """Return the rotations (N, 3, 3), unitless, at the centres of the cells `indices` (N,)."""
    pixel, spin = np.divmod(indices, n_psi)
    z, azimuth_rad = compute_pixel_angles(nside, pixel)
    # A spin about z, then the smallest rotation that takes z to the direction, as one quaternion.
    cosine, sine = np.sqrt((1 + z) / 2), np.sqrt((1 - z) / 2)
    half_spin = (spin + 0.5) * (np.pi / n_psi)
    swing = azimuth_rad - half_spin
    q = (cosine * np.cos(half_spin), -sine * np.sin(swing), sine * np.cos(swing), cosine * np.sin(half_spin))
    return quaternion_to_rotation(np.stack(q, axis=-1))


def compute_pixel_angles(nside: int, pixel: Int) -> tuple[Float, Float]:
    """Return z (N,), unitless, and azimuth (N,), radians, of the centres of HEALPix pixels (N,).

    Pixels are numbered base pixel by base pixel, x (towards north-east) slowest, then y (towards north-west).
    """
    base, x, y = np.unravel_index(pixel, (BASE_PIXELS, nside, nside))
    row, column = np.divmod(base, 4)  # three rows of four base pixels: north, equator, south
    ring = (row + 2) * nside - x - y - 1  # from 1 at the north pole to 4 nside - 1
    quarter = np.minimum(np.minimum(ring, 4 * nside - ring), nside)  # pixels in a quarter of this ring
    z = (2 * nside - ring) * (2 / (3 * nside))
    cap = 1 - quarter**2 / (3 * nside**2)
    z = np.where(ring < nside, cap, np.where(ring > 3 * nside, -cap, z))
    eighths = 2 * column + (row != 1)
    return np.asarray(z, float), np.asarray(np.pi / 4 * (eighths + (x - y) / quarter), float)


@dataclass(frozen=True, eq=False)
class RotationGrid:
    """A Hopf grid of an object's rotations: 12 nside^2 directions of the unit `axis` (3,), with `n_psi` spins each."""

    obj: ObjectModel
    axis: Float
    nside: int
    n_psi: int

    def __len__(self) -> int:
        return BASE_PIXELS * self.nside**2 * self.n_psi

    def representatives(self, indices: Int) -> Float:
        """Return R_sensor_object (K, 3, 3) of the cells `indices` (N,), one for each class of equivalent rotations."""
        R = make_hopf_rotations(self.nside, self.n_psi, indices) @ align_to_z(self.axis)
        return R[self.obj.symmetry.is_representative(R, step_rad=2 * np.pi / self.n_psi)]

    def all_representatives(self) -> Float:
        """Return R_sensor_object (K, 3, 3), one for each class of equivalent rotations."""
        starts = range(0, len(self), _CHUNK)
        return np.concatenate([self.representatives(np.arange(s, min(s + _CHUNK, len(self)))) for s in starts])


def find_spin_axis(obj: ObjectModel) -> tuple[Float, float, float]:
    """Return the object's spin axis (3,), unitless, and the levers, metres, of rotations about and across this axis.

    This is the axis of a continuous symmetry, or else the principal axis about which the object is most nearly round.
    """
    moments, axes = np.linalg.eigh(obj.mesh.covariance_m2)
    lever_m = np.sqrt(np.clip(moments.sum() - moments, 1e-18, None))
    others = lever_m[[[1, 2], [0, 2], [0, 1]]]
    k = int(np.abs(np.log(others[:, 0] / others[:, 1])).argmin())
    continuous = obj.symmetry.continuous_axis
    if continuous is not None:
        k = int(np.abs(axes.T @ continuous).argmax())
    axis = axes[:, k] if continuous is None else continuous
    return axis, float(lever_m[k]), float(np.sqrt(others[k].prod()))


def make_rotation_grid(obj: ObjectModel, spacing_m: float, level: int | None = None) -> RotationGrid:
    """Return rotations whose neighbours are about `spacing_m` metres apart, or 72 * 8^level rotations.

    A cell is one spacing wide about the spin axis and covers one squared spacing across the axis. The number of spins
    is a multiple of the number of symmetry rotations about the axis, so symmetries map cells to cells. A continuous
    symmetry needs one spin.
    """
    axis, spin_m, across_m = find_spin_axis(obj)
    if level is not None:
        return RotationGrid(obj, axis, 2**level, 6 * 2**level)
    nside = max(1, round(SPHERE_STEP_RAD * across_m / spacing_m))
    if obj.symmetry.continuous_axis is not None:
        return RotationGrid(obj, axis, nside, 1)
    turns = int((obj.symmetry.rotations @ axis @ axis > 1 - 1e-6).sum())
    return RotationGrid(obj, axis, nside, turns * max(1, round(2 * np.pi * spin_m / spacing_m / turns)))
