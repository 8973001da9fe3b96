"""Functions that move an object along z until it just touches the sensing rectangle.

Only the part of the object over the rectangle counts. The lowest point of a triangle over the rectangle has one of
three kinds:

- a vertex of the triangle,
- a point where an edge of the triangle crosses a side of the rectangle,
- the triangle's point over a corner of the rectangle.

All of these points are computed, so the result is exact.

Over a curved gel, any point of a triangle can be the nearest to the gel. Points on the triangle's edges and inside it
are therefore sampled every STEP_M. For a gel of radius r, the error is at most STEP_M^2 / 8 r, below a micrometre.

"""

import math

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Floats, Ints, Poses
from tactile_loc.core.objects.blocks import make_triangle_blocks
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.compiled import njit, run_in_threads
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.zbuffer import place

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

STEP_M = 2.5e-4
ROUNDS = 4  # iterations that convert a relief along a pinhole's rays to heights above the plane
BINS = 256  # number of bins into which blocks of triangles are sorted by height


def bring_to_contact(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> tuple[Poses, Bools]:
    """Return poses (N, 4, 4), metres, moved along z until the object touches the gel, and which of them touch (N,).

    A pose without any surface over the sensing rectangle keeps its z and is marked False. Over a curved gel, heights
    are measured from the gel's relief.
    """
    T = np.array(T_sensor_object, float, copy=True)
    lowest = (
        find_lowest_over_relief(mesh, T, geometry)
        if geometry.is_curved
        else find_lowest_points(mesh, T, geometry.rectangle)
    )
    touching = np.isfinite(lowest)
    T[touching, 2, 3] += geometry.standoff_m - lowest[touching]
    return T, touching


def find_lowest_points(
    mesh: TriangleMesh, T_sensor_object: Poses, rectangle_m: tuple[float, float, float, float]
) -> Floats:
    """Return the z (N,), metres, of each pose's lowest point over a rectangle (x0, x1, y0, y1); inf if it has none."""
    R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
    groups = group_rotations(R)
    triangles, t = make_triangle_blocks(mesh), np.ascontiguousarray(t)
    rectangle = np.asarray(rectangle_m, float)
    result = np.full(len(T_sensor_object), np.inf)
    run_in_threads(_fill_lowest, len(groups[0]), triangles, groups, t, rectangle, result)
    return result


def find_lowest_over_relief(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Floats:
    """Return each pose's least z - relief (N,), metres, over the sensing rectangle; inf without surface there."""
    T = np.ascontiguousarray(T_sensor_object, float)
    result = np.full(len(T), np.inf)
    gel = (np.asarray(geometry.rectangle, float), *make_upright_relief(geometry))
    run_in_threads(_fill_lowest_curved, len(T), make_triangle_blocks(mesh), T, gel, result)
    return result


def make_upright_relief(geometry: SensorGeometry) -> tuple[Floats, Floats]:
    """Return a curved gel's relief (H, W), metres, above a lattice of points in the plane z = surface; and the lattice.

    The lattice (4,), metres, is given by the x and y of its first point and by its steps along x and y. Parallel rays
    see the relief directly above these points. A pinhole's rays are oblique, so the relief above them is interpolated.
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


def group_rotations(R: Floats) -> tuple[Floats, Ints, Ints]:
    """Group rotations (N, 3, 3), unitless, that are exactly equal.

    Returns the distinct rotations (K, 3, 3), `starts` (K + 1,) and `members` (N,). The poses with rotation k have the
    indices members[starts[k]:starts[k + 1]].
    """
    flat = np.ascontiguousarray(R, dtype=float).reshape(len(R), 9) + 0.0
    keys = flat.view(np.dtype((np.void, flat.itemsize * 9))).ravel()
    _, first, inverse, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return flat[first].reshape(-1, 3, 3), starts, np.argsort(inverse, kind="stable").astype(np.int64)


@njit
def _fill_lowest(first, last, triangles, groups, t, rectangle, result):
    """Fill `result` (N,) with the lowest z of all poses that have one of the rotations from first to last."""
    rotations, starts, members = groups
    for k in range(first, last):
        _search_blocks(triangles, rotations[k], members[starts[k] : starts[k + 1]], t, rectangle, result)


@njit
def _search_blocks(triangles, R, members, t, rectangle, result):
    """Fill `result` with the lowest z of the poses `members`, which have the rotation R.

    Blocks of triangles are searched from below, until no other block can be lower.
    """
    count = len(triangles.radii)
    middles, floor, p = np.empty((count, 3)), np.empty(count), np.empty((3, 3))
    for b in range(count):
        _rotate(R, triangles.centres[b], middles[b])
        floor[b] = middles[b, 2] - triangles.radii[b]
    order, bin_m = _sort_from_below(floor)
    for i in members:
        x0, x1 = rectangle[0] - t[i, 0], rectangle[1] - t[i, 0]
        y0, y1 = rectangle[2] - t[i, 1], rectangle[3] - t[i, 1]
        best = np.inf
        for b in order:
            if floor[b] >= best + bin_m:
                break
            if floor[b] >= best or _is_beside(middles[b], triangles.radii[b], x0, x1, y0, y1):
                continue
            for f in range(triangles.starts[b], triangles.starts[b + 1]):
                for c in range(3):
                    _rotate(R, triangles.corners[f, c], p[c])
                if min(p[0, 2], p[1, 2], p[2, 2]) < best:
                    best = min(best, _find_lowest_of_triangle(p, x0, x1, y0, y1))
        result[i] = best + t[i, 2]


@njit
def _is_beside(centre, r, x0, x1, y0, y1):
    """Return whether no part of a sphere is over a rectangle."""
    return centre[0] + r < x0 or centre[0] - r > x1 or centre[1] + r < y0 or centre[1] - r > y1


@njit
def _sort_from_below(heights):
    """Return an order (F,) that sorts heights (F,) into bins, lowest first, and the width of a bin.

    Numba takes seconds to compile numpy's exact sort.
    """
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
def _rotate(R, p, rotated):
    """Fill `rotated` (3,) with the point p (3,) rotated by R (3, 3)."""
    for a in range(3):
        rotated[a] = R[a, 0] * p[0] + R[a, 1] * p[1] + R[a, 2] * p[2]


@njit
def _find_lowest_of_triangle(p, x0, x1, y0, y1):
    """Return the lowest z of a triangle (3, 3) over a rectangle; inf if the triangle is beside the rectangle."""
    if max(p[0, 0], p[1, 0], p[2, 0]) < x0 or min(p[0, 0], p[1, 0], p[2, 0]) > x1:
        return np.inf
    if max(p[0, 1], p[1, 1], p[2, 1]) < y0 or min(p[0, 1], p[1, 1], p[2, 1]) > y1:
        return np.inf
    best = np.inf
    for c in range(3):
        a, b = p[c], p[(c + 1) % 3]
        enter, leave = _clip_segment(a, b, x0, x1, y0, y1)
        if enter <= leave:
            best = min(best, a[2] + enter * (b[2] - a[2]), a[2] + leave * (b[2] - a[2]))
    for x in (x0, x1):
        for y in (y0, y1):
            best = min(best, _find_height_at(p, x, y))
    return best


@njit
def _clip_segment(a, b, x0, x1, y0, y1):
    """Return where segment a-b enters and leaves the rectangle, as fractions of its length (Liang-Barsky clipping).

    If no part of the segment is over the rectangle, the first fraction is larger than the second.
    """
    enter, leave = 0.0, 1.0
    for axis, low, high in ((0, x0, x1), (1, y0, y1)):
        d = b[axis] - a[axis]
        if d == 0.0:
            if a[axis] < low or a[axis] > high:
                return 1.0, 0.0
            continue
        s, e = (low - a[axis]) / d, (high - a[axis]) / d
        enter, leave = max(enter, min(s, e)), min(leave, max(s, e))
    return enter, leave


@njit
def _find_height_at(p, x, y):
    """Return the triangle's z at (x, y), or inf if (x, y) is outside the triangle."""
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


@njit
def _fill_lowest_curved(first, last, triangles, T, gel, result):
    """Fill `result` (N,) with the least height above the gel of each pose from first to last."""
    rectangle, relief, lattice = gel
    p, highest = np.empty((3, 3)), relief.max()
    x0, x1, y0, y1 = rectangle[0], rectangle[1], rectangle[2], rectangle[3]
    for i in range(first, last):
        best = np.inf
        for b in range(len(triangles.radii)):
            centre = place(T[i], triangles.centres[b])
            r = triangles.radii[b]
            if centre[2] - r - highest >= best or _is_beside(centre, r, x0, x1, y0, y1):
                continue
            for f in range(triangles.starts[b], triangles.starts[b + 1]):
                for c in range(3):
                    p[c, 0], p[c, 1], p[c, 2] = place(T[i], triangles.corners[f, c])
                if min(p[0, 2], p[1, 2], p[2, 2]) - highest < best:
                    best = min(best, _find_lowest_inside(p, x0, x1, y0, y1, relief, lattice))
        result[i] = best


@njit
def _find_lowest_inside(p, x0, x1, y0, y1, relief, lattice):
    """Return the least height above the gel of a triangle (3, 3), sampled along its edges and inside it."""
    best = np.inf
    for c in range(3):
        best = min(best, _find_lowest_along(p[c], p[(c + 1) % 3], (x0, x1, y0, y1), relief, lattice))
    low_x, high_x = max(x0, p[:, 0].min()), min(x1, p[:, 0].max())
    low_y, high_y = max(y0, p[:, 1].min()), min(y1, p[:, 1].max())
    if low_x > high_x or low_y > high_y:
        return best
    columns, rows = math.ceil((high_x - low_x) / STEP_M), math.ceil((high_y - low_y) / STEP_M)
    for j in range(rows + 1):
        y = low_y + (high_y - low_y) * j / max(rows, 1)
        for i in range(columns + 1):
            x = low_x + (high_x - low_x) * i / max(columns, 1)
            z = _find_height_at(p, x, y)
            if z < np.inf:
                best = min(best, z - _interpolate_relief(relief, lattice, x, y))
    return best


@njit
def _find_lowest_along(a, b, rectangle, relief, lattice):
    """Return the least height above the gel of segment a-b over the rectangle; inf if a-b is beside the rectangle."""
    x0, x1, y0, y1 = rectangle
    enter, leave = _clip_segment(a, b, x0, x1, y0, y1)
    if enter > leave:
        return np.inf
    x, y, z = a[0] + enter * (b[0] - a[0]), a[1] + enter * (b[1] - a[1]), a[2] + enter * (b[2] - a[2])
    dx, dy, dz = (leave - enter) * (b[0] - a[0]), (leave - enter) * (b[1] - a[1]), (leave - enter) * (b[2] - a[2])
    best, steps = np.inf, max(1, math.ceil(math.hypot(dx, dy) / STEP_M))
    for k in range(steps + 1):
        s = k / steps
        best = min(best, z + s * dz - _interpolate_relief(relief, lattice, x + s * dx, y + s * dy))
    return best


@njit
def _interpolate_relief(relief, lattice, x, y):
    """Return the relief at (x, y), interpolated linearly between the lattice's points and constant beyond them."""
    rows, columns = relief.shape
    c = min(max((x - lattice[0]) / lattice[2], 0.0), columns - 1.0)
    r = min(max((y - lattice[1]) / lattice[3], 0.0), rows - 1.0)
    i, j = int(r), int(c)
    s, t = r - i, c - j
    below, beside = min(i + 1, rows - 1), min(j + 1, columns - 1)
    above = (1 - t) * relief[i, j] + t * relief[i, beside]
    return (1 - s) * above + s * ((1 - t) * relief[below, j] + t * relief[below, beside])
