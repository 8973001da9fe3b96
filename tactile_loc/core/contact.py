"""Bringing an object to contact: the z translation at which it just touches the sensing rectangle.

Only the part of the object over the rectangle counts. The lowest point of a triangle over a rectangle is a corner of
their intersection: a vertex inside, an edge crossing a side, or the triangle's height at a corner of the rectangle.
Looking at exactly these makes the result exact. Compiled with numba; imported only when poses are brought to contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.blocks import triangle_blocks
from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

BINS = 256  # into which blocks of triangles are sorted by height


def bring_to_contact(
    mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry
) -> tuple[Poses, NDArray[np.bool_]]:
    """Return poses (N, 4, 4), moved along z so that the object touches the surface, and which (N,) have contact.

    Metres. A pose without any surface over the sensing rectangle keeps its z and is marked False. Where the gel is
    curved, what is brought to the standoff is the least height over its relief.
    """
    T = np.array(T_sensor_object, float, copy=True)
    lowest = _lowest_over_gel(mesh, T, geometry)
    touching = np.isfinite(lowest)
    T[touching, 2, 3] += geometry.standoff_m - lowest[touching]
    return T, touching


def _lowest_over_gel(mesh: TriangleMesh, T: Poses, geometry: SensorGeometry) -> NDArray[np.float64]:
    if geometry.relief_m is None:
        return lowest_points(mesh, T, geometry.rectangle)
    from tactile_loc.core.curved_contact import lowest_over_gel

    return lowest_over_gel(mesh, T, geometry)


def lowest_points(
    mesh: TriangleMesh, T_sensor_object: Poses, rectangle_m: tuple[float, float, float, float]
) -> NDArray[np.float64]:
    """Return z (N,) in metres of the surface's lowest point over a rectangle (x0, x1, y0, y1); inf where none is."""
    R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
    rotations, starts, members = group_rotations(R)
    triangles, t = triangle_blocks(mesh), np.ascontiguousarray(t)
    rectangle = np.asarray(rectangle_m, float)
    result = np.full(len(members), np.inf)
    in_threads(_lowest, len(rotations), triangles, rotations, starts, members, t, rectangle, result)
    return result


def group_rotations(R: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Group rotations (N, 3, 3) that are equal to the bit.

    Returns the distinct rotations (K, 3, 3), starts (K + 1,) and members (N,): the indices of the poses that have
    rotation k are members[starts[k]:starts[k + 1]]. Unitless.
    """
    flat = np.ascontiguousarray(R, dtype=float).reshape(len(R), 9) + 0.0
    keys = flat.view(np.dtype((np.void, flat.itemsize * 9))).ravel()
    _, first, inverse, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return flat[first].reshape(-1, 3, 3), starts, np.argsort(inverse, kind="stable").astype(np.int64)


@njit
def _lowest(first, last, triangles, rotations, starts, members, t, rectangle, result):  # type: ignore[no-untyped-def]
    """Fill the lowest z (N,) of the poses that have one of the rotations from first to last."""
    for k in range(first, last):
        _lowest_of_rotation(triangles, rotations[k], members[starts[k] : starts[k + 1]], t, rectangle, result)


@njit
def _lowest_of_rotation(triangles, R, members, t, rectangle, result):  # type: ignore[no-untyped-def]
    """Search the blocks of triangles roughly from the lowest up, and stop when no other can be lower."""
    count = len(triangles.radii)
    middles, floor, p = np.empty((count, 3)), np.empty(count), np.empty((3, 3))
    for b in range(count):
        _turn(R, triangles.centres[b], middles[b])
        floor[b] = middles[b, 2] - triangles.radii[b]
    order, bin_m = _from_below(floor)
    for i in members:
        x0, x1 = rectangle[0] - t[i, 0], rectangle[1] - t[i, 0]
        y0, y1 = rectangle[2] - t[i, 1], rectangle[3] - t[i, 1]
        best = np.inf
        for b in order:
            if floor[b] >= best + bin_m:
                break
            x, y, r = middles[b, 0], middles[b, 1], triangles.radii[b]
            if floor[b] >= best or x + r < x0 or x - r > x1 or y + r < y0 or y - r > y1:
                continue
            for f in range(triangles.starts[b], triangles.starts[b + 1]):
                for c in range(3):
                    _turn(R, triangles.corners[f, c], p[c])
                if min(p[0, 2], p[1, 2], p[2, 2]) < best:
                    best = min(best, _lowest_of_triangle(p, x0, x1, y0, y1))
        result[i] = best + t[i, 2]


@njit
def _from_below(heights):  # type: ignore[no-untyped-def]
    """The order (F,) of heights (F,) sorted into bins, and how wide a bin is: numpy's sort takes seconds to compile."""
    low = high = heights[0]
    for height in heights:
        low, high = min(low, height), max(high, height)
    bin_m = (high - low) / BINS
    ends, which = np.zeros(BINS + 1, np.int64), np.empty(len(heights), np.int64)
    for f in range(len(heights)):
        which[f] = min(BINS - 1, int((heights[f] - low) / bin_m)) if bin_m > 0.0 else 0
        ends[which[f] + 1] += 1
    for b in range(BINS):
        ends[b + 1] += ends[b]
    order = np.empty(len(heights), np.int64)
    for f in range(len(heights)):
        order[ends[which[f]]] = f
        ends[which[f]] += 1
    return order, bin_m


@njit
def _turn(R, p, turned):  # type: ignore[no-untyped-def]
    """Fill the point (3,) where the rotation R takes p (3,)."""
    for a in range(3):
        turned[a] = R[a, 0] * p[0] + R[a, 1] * p[1] + R[a, 2] * p[2]


@njit
def _lowest_of_triangle(p, x0, x1, y0, y1):  # type: ignore[no-untyped-def]
    """Lowest z of one triangle (3, 3) over a rectangle; inf when it is nowhere over it."""
    if max(p[0, 0], p[1, 0], p[2, 0]) < x0 or min(p[0, 0], p[1, 0], p[2, 0]) > x1:
        return np.inf
    if max(p[0, 1], p[1, 1], p[2, 1]) < y0 or min(p[0, 1], p[1, 1], p[2, 1]) > y1:
        return np.inf
    best = np.inf
    for c in range(3):
        best = min(best, _lowest_of_edge(p[c], p[(c + 1) % 3], x0, x1, y0, y1))
    for x in (x0, x1):
        for y in (y0, y1):
            best = min(best, _height_at(p, x, y))
    return best


@njit
def _lowest_of_edge(a, b, x0, x1, y0, y1):  # type: ignore[no-untyped-def]
    """Lowest z of the part of the segment a-b over the rectangle (Liang-Barsky clipping); inf when no part is."""
    enter, leave = 0.0, 1.0
    for axis, low, high in ((0, x0, x1), (1, y0, y1)):
        d = b[axis] - a[axis]
        if d == 0.0:
            if a[axis] < low or a[axis] > high:
                return np.inf
            continue
        s, e = (low - a[axis]) / d, (high - a[axis]) / d
        enter, leave = max(enter, min(s, e)), min(leave, max(s, e))
    if enter > leave:
        return np.inf
    dz = b[2] - a[2]
    return min(a[2] + enter * dz, a[2] + leave * dz)


@njit
def _height_at(p, x, y):  # type: ignore[no-untyped-def]
    """Height z of the triangle's plane at (x, y) when that point lies in the triangle, else inf."""
    ax, ay = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1]
    bx, by = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1]
    area = ax * by - ay * bx
    if area == 0.0:
        return np.inf
    qx, qy = x - p[0, 0], y - p[0, 1]
    u, v = (qx * by - qy * bx) / area, (ax * qy - ay * qx) / area
    if u < 0.0 or v < 0.0 or u + v > 1.0:
        return np.inf
    return p[0, 2] + u * (p[1, 2] - p[0, 2]) + v * (p[2, 2] - p[0, 2])
