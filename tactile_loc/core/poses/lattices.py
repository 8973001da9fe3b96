"""Square lattices of translations, and the range of translations that keep an object over the sensing rectangle."""

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.runtime.errors import GridError

SMALLEST_SPACING_M = 1e-6

PLASTIC = 1.32471795724474602596  # the real root of x^3 = x + 1
SHIFTS = np.array([1 / PLASTIC, 1 / PLASTIC**2])  # its multiples, modulo 1, fill the unit square: Roberts' R2 sequence


def compute_lattice_shape(low_m: Floats, high_m: Floats, pitch_m: float) -> Ints:
    """Return how many points (..., 2) `make_plane_lattice` has along x and y, between low and high (..., 2), metres.

    Each point is the middle of a square of side `pitch_m`. The squares cover the range, with as few points as possible
    but at least one. Raises GridError if the pitch is not a positive number.
    """
    _require_pitch(pitch_m)
    # rounding must not add a point if the range is a whole number of pitches
    squares = np.ceil((np.asarray(high_m, float) - np.asarray(low_m, float)) / pitch_m - 1e-9)
    return np.asarray(np.maximum(squares, 1).astype(np.int64))


def make_plane_lattice(low_m: Floats, high_m: Floats, pitch_m: float) -> Floats:
    """Return the points (K, 2), metres, of a square lattice, centred between low (2,) and high (2,), metres.

    `pitch_m` is the distance between neighbours. x varies slowest. All points lie inside the range. Along each axis, no
    position in the range is farther than half a pitch from a point. A range that is shorter than a pitch or empty (high
    below low) gets one point in its middle. Raises GridError if the pitch is not a positive number.
    """
    low, high = np.asarray(low_m, float), np.asarray(high_m, float)
    x, y = (
        middle + pitch_m * (np.arange(n) - (n - 1) / 2)
        for middle, n in zip((low + high) / 2, compute_lattice_shape(low, high, pitch_m), strict=True)
    )
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def make_shifted_lattice(low_m: Floats, high_m: Floats, pitch_m: float, number: int) -> Floats:
    """Return the points (K, 2), metres, of a shifted square lattice between low (2,) and high (2,), metres.

    The shift is `number` times SHIFTS, modulo 1, in pitches. Lattices with successive numbers fill each other's gaps
    evenly. Lattice 0 has a point in the middle of the range. If there is no point in the range along an axis, the
    middle of the range is used. Raises GridError if the pitch is not a positive number.
    """
    _require_pitch(pitch_m)
    low, high = np.asarray(low_m, float), np.asarray(high_m, float)
    middle, shift = (low + high) / 2, pitch_m * (number * SHIFTS % 1.0)
    axes = []
    for a in range(2):
        first = np.ceil((low[a] - middle[a] - shift[a]) / pitch_m - 1e-9)
        last = np.floor((high[a] - middle[a] - shift[a]) / pitch_m + 1e-9)
        points = middle[a] + shift[a] + pitch_m * np.arange(first, last + 1)
        axes.append(points if len(points) else middle[a : a + 1])
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def require_spacing(spacing_m: float) -> None:
    """Raise GridError unless a grid's spacing, metres, is finite and at least a micrometre."""
    if not SMALLEST_SPACING_M <= spacing_m < np.inf:
        raise GridError(f"the grid's spacing is {spacing_m * 1e3:g} mm; give at least 0.001 mm")


def _require_pitch(pitch_m: float) -> None:
    if not (np.isfinite(pitch_m) and pitch_m > 0):
        raise GridError(f"a lattice's pitch is {pitch_m * 1e3:g} mm; give a spacing above 0")


def find_reachable_translations(
    points_m: Floats, rectangle_m: tuple[float, float, float, float]
) -> tuple[Floats, Floats]:
    """Return the smallest and the largest translations along x and y, each (..., 2), metres, that reach a rectangle.

    Between them, the bounding box of the points overlaps the rectangle (x0, x1, y0, y1), metres. `points_m`
    (..., V, 3), metres, are already rotated into the axes of the sensor frame.
    """
    points = np.asarray(points_m, float)[..., :2]
    x0, x1, y0, y1 = rectangle_m
    return np.array([x0, y0]) - points.max(axis=-2), np.array([x1, y1]) - points.min(axis=-2)
