"""Nearest points of an object's surface, found with the nearest triangle of each cell of a box around the object.

The field is built once per object. A wave carries triangles outwards from the cells that the triangles cross. The time
to find a nearest point does not depend on the size of the mesh. The search starts with the triangle that is nearest to
the centre of the given point's cell. Near an edge between triangles, another triangle can be nearer to the point
itself. The search therefore continues to nearer triangles that share an edge.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects.blocks import NearestTriangles
from tactile_loc.core.objects.mesh import TriangleMesh, find_shared_sides
from tactile_loc.core.runtime.caches import ByteCache
from tactile_loc.core.runtime.compiled import njit, run_in_threads

REACH_M, CELL_M = 4e-3, 5e-4  # reach, and side of a cell of a field by default
MOST_CELLS = 6_000_000
KEPT_BYTES = 512 * 2**20  # of fields in memory
FAR = 255  # value of a distance of `reach_m` or more
SAME, SAME_SQUARED = 1e-9, 1e-18  # squared distances are equal up to this share of them, plus this much
MOST_TIES = 16  # steps to equally near triangles in one search
TO_MM = np.repeat([1e3, 1.0, 1e6, 1e12], [9, 3, 3, 1])  # factors of a row of `NearestTriangles.faces` from metres
Cells = tuple[NDArray[np.int32], NDArray[np.uint8]]  # `NearestTriangles.nearest`, and `SurfaceField.distances`
Keep = Callable[[Callable[[], Cells]], Cells]
SIDES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


@dataclass(frozen=True, eq=False)
class SurfaceField:
    """The nearest surface points of a mesh, for points up to `reach_m` metres from the mesh."""

    triangles: NearestTriangles
    reach_m: float
    distances: NDArray[np.uint8]  # (X, Y, Z), from the centre of each cell to the surface, in steps of reach_m / FAR

    @classmethod
    def of(
        cls, mesh: TriangleMesh, reach_m: float = REACH_M, cell_m: float = CELL_M, keep: Keep = lambda find: find()
    ) -> SurfaceField:
        """Build the field of a mesh with cells of `cell_m` metres, or larger if there would be too many.

        `keep` returns what the function given to it returns, or what it kept of an earlier call: the cells' nearest
        triangles and distances.
        """
        low = mesh.vertices_m.min(axis=0) - reach_m
        size = mesh.extents_m + 2 * reach_m
        cell_m = max(cell_m, float(np.cbrt(size.prod() / MOST_CELLS)))
        corners = np.ascontiguousarray(mesh.triangles_m[mesh.face_areas > 0])
        empty = np.full(np.ceil(size / cell_m).astype(int) + 1, -1, np.int32)
        triangles = NearestTriangles(pack_triangles(corners), low, cell_m, empty, *_find_neighbours(corners))
        nearest, distances = keep(lambda: _fill_cells(triangles, corners, reach_m))
        return cls(triangles._replace(nearest=nearest), reach_m, distances)

    @property
    def nbytes(self) -> int:
        """The memory of the field's arrays, bytes."""
        return self.distances.nbytes + sum(part.nbytes for part in self.triangles if isinstance(part, np.ndarray))

    @cached_property
    def triangles_mm(self) -> NearestTriangles:
        """The arrays for compiled code, in mm."""
        of = self.triangles
        return of._replace(faces=of.faces * TO_MM, low=of.low * 1e3, cell=of.cell * 1e3)

    def find_closest(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the surface points (N, 3), metres, nearest to points (N, 3), metres, in the object frame.

        Also return the numbers of their triangles (N,). Beyond `reach_m`, a point is NaN and its triangle is -1.
        """
        found, which = np.full((len(points_m), 3), np.nan), np.full(len(points_m), -1)
        look_up(np.ascontiguousarray(points_m, float), self.triangles, found, which)
        return found, which

    def measure_distances(
        self, points_m: NDArray[np.float64], T_object_points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the distances (K, N), metres, to the surface of points (N, 3) moved by T_object_points (K, 4, 4).

        A distance above `reach_m` can be infinite.
        """
        distances_m = np.empty((len(T_object_points), len(points_m)))
        points_m = np.ascontiguousarray(points_m, float)
        run_in_threads(_fill_distances, len(distances_m), points_m, T_object_points, self.triangles, distances_m)
        return distances_m

    def estimate_distances(
        self, points_m: NDArray[np.float64], T_object_points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return rough mean distances (K,), metres, to the surface of points (N, 3) moved by T_object_points (K, 4, 4).

        Each distance is that of the centre of the point's cell, and at most `reach_m`. This is many times as fast as
        `measure_distances`, to compare many poses. Without points, the result is 0.
        """
        gaps = np.zeros(len(T_object_points))
        triangles, points_m = self.triangles, np.ascontiguousarray(points_m, float)
        run_in_threads(_fill_rough_gaps, len(gaps), points_m, T_object_points, triangles, self.distances, gaps)
        return gaps * (self.reach_m / FAR)


def _fill_cells(triangles: NearestTriangles, corners: NDArray[np.float64], reach_m: float) -> Cells:
    """Fill `triangles.nearest` for triangles with corners (F, 3, 3), and return it with the cells' distances."""
    squared_m2 = np.full(triangles.nearest.shape, np.inf, np.float32)
    boxes = np.hstack([corners.min(axis=1), corners.max(axis=1)])
    _mark_crossed(triangles, boxes, squared_m2)
    _carry(triangles, boxes, reach_m, squared_m2, np.argwhere(triangles.nearest >= 0).astype(np.int32))
    distances = np.minimum(np.rint(np.sqrt(squared_m2) * np.float32(FAR / reach_m)), FAR).astype(np.uint8)
    return triangles.nearest, distances


def pack_triangles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows (F, 16) of `NearestTriangles.faces` for triangles with corners (F, 3, 3)."""
    first, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(b, c)
    areas = np.linalg.norm(normals, axis=1, keepdims=True)
    products = [np.einsum("fk,fk->f", one, other)[:, None] for one, other in ((b, b), (b, c), (c, c))]
    return np.hstack([first, b, c, normals / areas, *products, areas**2])


def _find_neighbours(corners: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the neighbours that share an edge with each triangle (F, 3, 3), joined, and where each list ends."""
    one, other = find_shared_sides(corners).T // 3
    both, times = np.unique(np.r_[one * len(corners) + other, other * len(corners) + one], return_counts=True)
    one, other = np.divmod(both[times == 1], len(corners))  # equal triangles have three common edges
    return other.astype(np.int32), np.r_[0, np.cumsum(np.bincount(one, minlength=len(corners)))]


_fields: ByteCache[tuple[str, float], SurfaceField] = ByteCache(KEPT_BYTES, lambda field: field.nbytes)


def build_surface_field(
    mesh: TriangleMesh, cell_m: float | None = None, keep: Keep = lambda find: find()
) -> SurfaceField:
    """Return the field of a mesh, built at its first use. The fields used last are kept, up to KEPT_BYTES.

    Equal meshes share one field, for instance two that are loaded from the same file.
    Its cells have the side `cell_m`, metres; CELL_M by default. Cells of twice this side take an eighth of the memory
    and about a quarter of the time to build. `estimate_distances` is then less exact. Where parts of a surface are near
    each other, a point may miss the nearest one. `keep` is as for `SurfaceField.of`.
    """
    side_m = CELL_M if cell_m is None else cell_m
    return _fields.get((mesh.digest, side_m), lambda: SurfaceField.of(mesh, cell_m=side_m, keep=keep))


@njit
def look_up(points, triangles, found, which):
    """Fill `found` (N, 3) with the surface points nearest to `points` (N, 3), and `which` (N,) with their triangles."""
    faces = triangles.faces
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        f = find_cell_triangle(x, y, z, triangles)
        if f >= 0:
            f, _ = walk_to_nearest(x, y, z, f, triangles)
            found[i, 0], found[i, 1], found[i, 2] = find_closest_point(x, y, z, f, faces)
        which[i] = f


@njit
def _fill_distances(first, last, points, T, triangles, distances):
    """Fill `distances` (K, N) of the points, moved by T (K, 4, 4), for moves from first to last."""
    for k in range(first, last):
        for i in range(len(points)):
            a, b, c = points[i, 0], points[i, 1], points[i, 2]
            x = T[k, 0, 0] * a + T[k, 0, 1] * b + T[k, 0, 2] * c + T[k, 0, 3]
            y = T[k, 1, 0] * a + T[k, 1, 1] * b + T[k, 1, 2] * c + T[k, 1, 3]
            z = T[k, 2, 0] * a + T[k, 2, 1] * b + T[k, 2, 2] * c + T[k, 2, 3]
            f = find_cell_triangle(x, y, z, triangles)
            distances[k, i] = np.inf if f < 0 else math.sqrt(walk_to_nearest(x, y, z, f, triangles)[1])


@njit(fast=True)
def _fill_rough_gaps(first, last, points, T, triangles, distances, gaps):
    """Fill `gaps` (K,) with the mean distances of the points, moved by T (K, 4, 4), for moves from first to last."""
    X, Y, Z = distances.shape
    low, per = triangles.low, 1.0 / triangles.cell
    for k in range(first, last):
        a, b, c = (T[k, 0, 3] - low[0]) * per, (T[k, 1, 3] - low[1]) * per, (T[k, 2, 3] - low[2]) * per
        R00, R01, R02 = T[k, 0, 0] * per, T[k, 0, 1] * per, T[k, 0, 2] * per
        R10, R11, R12 = T[k, 1, 0] * per, T[k, 1, 1] * per, T[k, 1, 2] * per
        R20, R21, R22 = T[k, 2, 0] * per, T[k, 2, 1] * per, T[k, 2, 2] * per
        total = 0
        for n in range(len(points)):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            u, v, w = R00 * x + R01 * y + R02 * z + a, R10 * x + R11 * y + R12 * z + b, R20 * x + R21 * y + R22 * z + c
            inside = u >= 0.0 and v >= 0.0 and w >= 0.0 and u < X and v < Y and w < Z
            total += int(distances[int(u), int(v), int(w)]) if inside else FAR
        gaps[k] = total / max(1, len(points))


# The next functions take numbers instead of arrays, because a view of an array takes numba longer than the arithmetic.
@njit(fast=True)
def find_cell_triangle(x, y, z, triangles):
    """Return the number of the triangle nearest to the cell of the point x, y, z, or -1 beyond reach."""
    i = math.floor((x - triangles.low[0]) / triangles.cell)
    j = math.floor((y - triangles.low[1]) / triangles.cell)
    k = math.floor((z - triangles.low[2]) / triangles.cell)
    a, b, c = triangles.nearest.shape
    if i < 0 or j < 0 or k < 0 or i >= a or j >= b or k >= c:
        return -1
    return int(triangles.nearest[i, j, k])


@njit(fast=True)
def walk_to_nearest(x, y, z, f, triangles):
    """Return the triangle nearest to the point x, y, z, and its squared distance.

    The search starts at triangle f, and goes over shared edges as long as the triangles become nearer. If the nearest
    point is on an edge, rounding must not choose between its triangles. So the triangle that faces the point most is
    taken, or else the first one. Three triangles may each be preferred to the next one, because what counts as equal is
    a range. So the search goes to an equally near triangle MOST_TIES times at most.
    """
    faces, ends, beside = triangles.faces, triangles.ends, triangles.beside
    least, ties, before = _measure_squared_distance(x, y, z, f, faces), 0, -1
    while True:
        best, tie, start = f, SAME * least + SAME_SQUARED, least
        for number in range(ends[f], ends[f + 1]):
            other = beside[number]
            if other == before:
                continue
            off = _measure_off(x, y, z, other, faces)
            if off < least - tie:  # otherwise even the plane of the triangle is farther
                d = _measure_squared_distance(x, y, z, other, faces)
                nearer = d < least - tie
                if not nearer and d <= least + tie and ties < MOST_TIES:
                    faces_more = off - _measure_off(x, y, z, best, faces)
                    nearer = faces_more > tie or (faces_more >= -tie and other < best)
                if nearer:
                    least, best = d, other
        if best == f:
            return f, least
        ties += least >= start - tie
        before, f = f, best


@njit(fast=True)
def _measure_off(x, y, z, f, faces):
    """Return the squared distance of the point x, y, z from the plane of triangle f."""
    off = faces[f, 9] * (x - faces[f, 0]) + faces[f, 10] * (y - faces[f, 1]) + faces[f, 11] * (z - faces[f, 2])
    return off * off


@njit(fast=True)
def find_closest_point(x, y, z, f, faces):
    """Return the point nearest to the point x, y, z of triangle f, given rows of `NearestTriangles.faces`.

    If the point's projection is outside the triangle, the nearest points of its three sides are compared.
    """
    ab0, ab1, ab2, ac0, ac1, ac2 = faces[f, 3], faces[f, 4], faces[f, 5], faces[f, 6], faces[f, 7], faces[f, 8]
    p0, p1, p2 = x - faces[f, 0], y - faces[f, 1], z - faces[f, 2]
    bb, bc, cc = faces[f, 12], faces[f, 13], faces[f, 14]
    pb, pc = ab0 * p0 + ab1 * p1 + ab2 * p2, ac0 * p0 + ac1 * p1 + ac2 * p2
    v, w, area = cc * pb - bc * pc, bb * pc - bc * pb, faces[f, 15]
    if v >= 0.0 and w >= 0.0 and v + w <= area:
        v, w = v / area, w / area
    else:
        along = pc - pb - bc + bb  # from the second corner to the third one
        third = bb + cc - 2.0 * bc
        s, t, u = min(max(pb / bb, 0.0), 1.0), min(max(pc / cc, 0.0), 1.0), min(max(along / third, 0.0), 1.0)
        # squared distances, less that of the first corner
        on_b, on_c = s * (s * bb - 2.0 * pb), t * (t * cc - 2.0 * pc)
        opposite = bb - 2.0 * pb + u * (u * third - 2.0 * along)
        v, w = (s, 0.0) if on_b <= on_c else (0.0, t)
        v, w = (1.0 - u, u) if opposite < min(on_b, on_c) else (v, w)
    return faces[f, 0] + v * ab0 + w * ac0, faces[f, 1] + v * ab1 + w * ac1, faces[f, 2] + v * ab2 + w * ac2


@njit
def _mark_crossed(triangles, boxes, squared):
    """Assign each triangle to the cells within two cell sides of its box (F, 6): see `_carry`."""
    low, cell, nearest = triangles.low, triangles.cell, triangles.nearest
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(len(boxes)):
        for m in range(3):
            first[m] = max(0, math.floor((boxes[f, m] - low[m]) / cell) - 1)
            last[m] = min(nearest.shape[m] - 1, math.floor((boxes[f, m + 3] - low[m]) / cell) + 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    _assign((i, j, k), f, triangles, boxes, 4.0 * cell * cell, squared)


@njit
def _carry(triangles, boxes, reach, squared, wave):
    """Fill `triangles.nearest` outwards from the cells `wave` (W, 3), cell by cell.

    Also fill `squared` (X, Y, Z) with the squared distances to these triangles, where it is infinite at the start.
    `boxes` (F, 6) are the least and the greatest coordinates of each triangle.
    """
    nearest, count = triangles.nearest, len(wave)
    X, Y, Z = nearest.shape
    queued = np.zeros(nearest.shape, np.int16)
    for layer in range(1, 4 * math.ceil(reach / triangles.cell) + 2):
        after, ahead = np.empty((6 * count, 3), np.int32), 0
        for n in range(count):
            f = nearest[wave[n, 0], wave[n, 1], wave[n, 2]]
            for s in range(6):
                i, j, k = wave[n, 0] + SIDES[s, 0], wave[n, 1] + SIDES[s, 1], wave[n, 2] + SIDES[s, 2]
                if i < 0 or j < 0 or k < 0 or i >= X or j >= Y or k >= Z or nearest[i, j, k] == f:
                    continue
                if _assign((i, j, k), f, triangles, boxes, reach * reach, squared) and queued[i, j, k] != layer:
                    queued[i, j, k] = layer
                    after[ahead, 0], after[ahead, 1], after[ahead, 2] = i, j, k
                    ahead += 1
        wave, count = after, ahead
        if count == 0:
            break


@njit(fast=True)
def _assign(at, f, triangles, boxes, most, squared):
    """Assign triangle f to the cell `at` if it is nearer than before, and nearer than the square root of `most`.

    Return whether it is.
    """
    (i, j, k), low, cell, faces = at, triangles.low, triangles.cell, triangles.faces
    x, y, z = low[0] + (i + 0.5) * cell, low[1] + (j + 0.5) * cell, low[2] + (k + 0.5) * cell
    least = min(squared[i, j, k], most)
    if _measure_off(x, y, z, f, faces) >= least:  # the plane of the triangle is farther
        return False
    a = max(0.0, boxes[f, 0] - x, x - boxes[f, 3])
    b = max(0.0, boxes[f, 1] - y, y - boxes[f, 4])
    c = max(0.0, boxes[f, 2] - z, z - boxes[f, 5])
    if a * a + b * b + c * c >= least:  # the box around the triangle is farther
        return False
    d = _measure_squared_distance(x, y, z, f, faces)
    if d >= least:
        return False
    squared[i, j, k], triangles.nearest[i, j, k] = d, f
    return True


@njit(fast=True)
def _measure_squared_distance(x, y, z, f, faces):
    p = find_closest_point(x, y, z, f, faces)
    return (x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2
