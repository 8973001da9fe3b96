"""How far an object is from a gel that is not flat: the least height of its surface over the gel's.

Over a curved gel the lowest point of a triangle may lie anywhere on it. Its edges, cut at the sensing rectangle, and
its inside are looked at every STEP_M: of a gel of radius r that misses at most STEP_M^2 / 8 r, below a micrometre.
Compiled with numba; imported only when poses are brought to contact with such a gel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.blocks import triangle_blocks
from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

STEP_M = 2.5e-4
ROUNDS = 4  # in which a pinhole's relief, known along rays, is found upright


def lowest_over_gel(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the least of z - relief (N,), metres, of poses' surface over the sensing rectangle; inf where none is."""
    T = np.ascontiguousarray(T_sensor_object, float)
    result = np.full(len(T), np.inf)
    gel = (np.asarray(geometry.rectangle, float), *upright_relief(geometry))
    in_threads(_lowest, len(T), triangle_blocks(mesh), T, *gel, result)
    return result


def upright_relief(geometry: SensorGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a curved gel's relief (H, W), metres, over points of the plane z = surface, and their lattice.

    The lattice (4,), metres, are x and y of the first point and the steps to the next. Parallel rays see it so; a
    pinhole's pixel sees the gel beside the point of the plane that it aims at.
    """
    from scipy.ndimage import map_coordinates

    k = geometry.surface_m if geometry.is_pinhole else 1.0
    x, y = (slopes * k for slopes in geometry.pixel_slopes)
    lattice = np.array([x[0], y[0], k / geometry.fx, k / geometry.fy])
    seen = np.asarray(geometry.relief_m, float)
    relief = seen
    for _ in range(ROUNDS if geometry.is_pinhole else 0):
        z = geometry.surface_m + relief
        at = (y[:, None] * geometry.fy / z + geometry.cy - 0.5, x[None] * geometry.fx / z + geometry.cx - 0.5)
        relief = map_coordinates(seen, at, order=1, mode="nearest")
    return np.ascontiguousarray(relief), lattice


@njit
def _lowest(first, last, triangles, T, rectangle, relief, lattice, result):
    """Fill the least heights (N,) over the gel of the poses from first to last."""
    p, centre, highest = np.empty((3, 3)), np.empty(3), relief.max()
    for i in range(first, last):
        best = np.inf
        for b in range(len(triangles.radii)):
            _place(T[i], triangles.centres[b], centre)
            r = triangles.radii[b]
            if centre[2] - r - highest >= best or _beside(centre, r, rectangle):
                continue
            for f in range(triangles.starts[b], triangles.starts[b + 1]):
                for c in range(3):
                    _place(T[i], triangles.corners[f, c], p[c])
                if min(p[0, 2], p[1, 2], p[2, 2]) - highest < best:
                    best = min(best, _lowest_of_triangle(p, rectangle, relief, lattice))
        result[i] = best


@njit
def _place(T, p, placed):
    """Fill the point (3,) where the pose T (4, 4) has p (3,)."""
    for a in range(3):
        placed[a] = T[a, 0] * p[0] + T[a, 1] * p[1] + T[a, 2] * p[2] + T[a, 3]


@njit
def _beside(centre, r, rectangle):
    """Whether a sphere is nowhere over the rectangle."""
    beside_x = centre[0] + r < rectangle[0] or centre[0] - r > rectangle[1]
    return beside_x or centre[1] + r < rectangle[2] or centre[1] - r > rectangle[3]


@njit
def _lowest_of_triangle(p, rectangle, relief, lattice):
    """Least height of a triangle (3, 3) over the gel: along its edges, and at points inside."""
    best = np.inf
    for c in range(3):
        best = min(best, _lowest_of_edge(p[c], p[(c + 1) % 3], rectangle, relief, lattice))
    low_x, high_x = max(rectangle[0], p[:, 0].min()), min(rectangle[1], p[:, 0].max())
    low_y, high_y = max(rectangle[2], p[:, 1].min()), min(rectangle[3], p[:, 1].max())
    ax, ay, bx, by = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[2, 0] - p[0, 0], p[2, 1] - p[0, 1]
    area = ax * by - ay * bx
    if area == 0.0 or low_x > high_x or low_y > high_y:
        return best
    columns, rows = math.ceil((high_x - low_x) / STEP_M), math.ceil((high_y - low_y) / STEP_M)
    for j in range(rows + 1):
        y = low_y + (high_y - low_y) * j / max(rows, 1)
        for i in range(columns + 1):
            x = low_x + (high_x - low_x) * i / max(columns, 1)
            u = ((x - p[0, 0]) * by - (y - p[0, 1]) * bx) / area
            v = (ax * (y - p[0, 1]) - ay * (x - p[0, 0])) / area
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                z = p[0, 2] + u * (p[1, 2] - p[0, 2]) + v * (p[2, 2] - p[0, 2])
                best = min(best, z - _relief_at(relief, lattice, x, y))
    return best


@njit
def _lowest_of_edge(a, b, rectangle, relief, lattice):
    """Least height over the gel of the part of a segment a-b over the rectangle (Liang-Barsky); inf when none is."""
    enter, leave = 0.0, 1.0
    for axis in range(2):
        low, high, d = rectangle[2 * axis], rectangle[2 * axis + 1], b[axis] - a[axis]
        if d == 0.0:
            if a[axis] < low or a[axis] > high:
                return np.inf
            continue
        s, e = (low - a[axis]) / d, (high - a[axis]) / d
        enter, leave = max(enter, min(s, e)), min(leave, max(s, e))
    if enter > leave:
        return np.inf
    x, y, z = a[0] + enter * (b[0] - a[0]), a[1] + enter * (b[1] - a[1]), a[2] + enter * (b[2] - a[2])
    dx, dy, dz = (leave - enter) * (b[0] - a[0]), (leave - enter) * (b[1] - a[1]), (leave - enter) * (b[2] - a[2])
    best, steps = np.inf, max(1, math.ceil(math.hypot(dx, dy) / STEP_M))
    for k in range(steps + 1):
        s = k / steps
        best = min(best, z + s * dz - _relief_at(relief, lattice, x + s * dx, y + s * dy))
    return best


@njit
def _relief_at(relief, lattice, x, y):
    """The relief, linear between the lattice's points; beyond them it goes on as at the last."""
    rows, columns = relief.shape
    c = min(max((x - lattice[0]) / lattice[2], 0.0), columns - 1.0)
    r = min(max((y - lattice[1]) / lattice[3], 0.0), rows - 1.0)
    i, j = min(int(r), max(rows - 2, 0)), min(int(c), max(columns - 2, 0))
    s, t = r - i, c - j
    below, beside = min(i + 1, rows - 1), min(j + 1, columns - 1)
    above = (1 - t) * relief[i, j] + t * relief[i, beside]
    return (1 - s) * above + s * ((1 - t) * relief[below, j] + t * relief[below, beside])
