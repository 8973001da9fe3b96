"""Nearest points of an object's surface, found with the nearest triangle of each cell of a box around the object.

The field is built once per object. A wave carries triangles outwards from the cells that the triangles cross. The time
to find a nearest point does not depend on the size of the mesh. The search starts with the triangle that is nearest to
the centre of the given point's cell. Near an edge between triangles, another triangle can be nearer to the point
itself. The search therefore continues to nearer triangles that share an edge.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import njit, run_in_threads
from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.objects.blocks import NearestTriangles
from tactile_loc.core.objects.mesh import TriangleMesh

MOST_CELLS = 6_000_000
SIDES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


@keep_old_names(in_unit="to_unit", closest="find_closest", mean_gaps="measure_gaps")
@dataclass(frozen=True, eq=False)
class SurfaceField:
    """The nearest surface points of a mesh, for points up to `reach_m` metres from the mesh."""

    triangles: NearestTriangles
    reach_m: float

    @classmethod
    def of(cls, mesh: TriangleMesh, reach_m: float = 4e-3, cell_m: float = 5e-4) -> SurfaceField:
        """Build the field of a mesh with cells of `cell_m` metres, or larger if there would be too many."""
        low = mesh.vertices_m.min(axis=0) - reach_m
        size = mesh.extents_m + 2 * reach_m
        cell_m = max(cell_m, float(np.cbrt(size.prod() / MOST_CELLS)))
        corners = np.ascontiguousarray(mesh.triangles_m[mesh.face_areas > 0])
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        nearest = np.full(np.ceil(size / cell_m).astype(int) + 1, -1, np.int32)
        first, sides = np.ascontiguousarray(corners[:, 0]), corners[:, 1:] - corners[:, :1]
        carry(first, sides, normals, low, cell_m, reach_m, nearest)
        return cls(NearestTriangles(first, sides, normals, low, cell_m, nearest, *_find_neighbours(corners)), reach_m)

    def to_unit(self, per_m: float) -> NearestTriangles:
        """Return the arrays for compiled code in another unit of length. A metre has `per_m` of these units."""
        of = self.triangles
        return of._replace(
            corners=of.corners * per_m, sides=of.sides * per_m, low=of.low * per_m, cell=of.cell * per_m
        )  # fmt: skip

    def find_closest(self, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the surface points (N, 3), metres, nearest to points (N, 3), metres, in the object frame.

        Also return the numbers of their triangles (N,). Beyond `reach_m`, a point is NaN and its triangle is -1.
        """
        found, which = np.full((len(points_m), 3), np.nan), np.full(len(points_m), -1)
        look_up(np.ascontiguousarray(points_m, float), self.triangles, found, which)
        return found, which

    def measure_gaps(
        self, points_m: NDArray[np.float64], T_object_points: NDArray[np.float64], most_m: float, exactly: bool = False
    ) -> NDArray[np.float64]:
        """Return the mean distance (K,), metres, to the surface of points (N, 3) moved by T_object_points (K, 4, 4).

        Each distance counts as at most `most_m`. Without points, the result is 0. Unless `exactly` is true, only the
        triangle nearest to the centre of a point's cell counts, so distances below a cell can be too large.
        """
        gaps = np.zeros(len(T_object_points))
        points_m = np.ascontiguousarray(points_m, float)
        run_in_threads(
            _fill_mean_gaps, len(gaps), points_m, T_object_points, self.triangles, float(most_m), exactly, gaps
        )
        return gaps


def _find_neighbours(corners: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the neighbours that share an edge with each triangle (F, 3, 3), joined, and where each list ends."""
    from scipy.sparse import csr_matrix

    which = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].ravel()
    of = np.repeat(np.arange(len(corners)), 3)
    touches = csr_matrix((np.ones(len(of), np.int8), (of, which)), shape=(len(corners), int(which.max()) + 1))
    shared = (touches @ touches.T).tocsr()
    shared.data[shared.data != 2] = 0  # the number of common corners; a triangle shares three with itself
    shared.eliminate_zeros()
    return shared.indices.astype(np.int32), shared.indptr.astype(np.int64)


@lru_cache(maxsize=64)  # as many as the objects of a library that are searched together
def build_surface_field(mesh: TriangleMesh) -> SurfaceField:
    """Return the field of a mesh. It is built at its first use."""
    return SurfaceField.of(mesh)


@njit
def look_up(points, triangles, found, which):
    """Fill `found` (N, 3) with the surface points nearest to `points` (N, 3), and `which` (N,) with their triangles."""
    for i in range(len(points)):
        f = find_triangle_near(points[i], triangles)
        which[i] = f
        if f >= 0:
            which[i] = f = find_downhill(points[i], f, triangles)[0]
            x, y, z = find_closest_on_triangle(points[i], triangles.corners[f], triangles.sides[f])
            found[i, 0], found[i, 1], found[i, 2] = x, y, z


@njit
def _fill_mean_gaps(first, last, points, T, triangles, most, exactly, gaps):
    """Fill `gaps` (K,) with the mean distances of the points, moved by T (K, 4, 4), for moves from first to last."""
    x = np.empty(3)
    for k in range(first, last):
        total = 0.0
        for i in range(len(points)):
            for r in range(3):
                x[r] = T[k, r, 0] * points[i, 0] + T[k, r, 1] * points[i, 1] + T[k, r, 2] * points[i, 2] + T[k, r, 3]
            f = find_triangle_near(x, triangles)
            gap = most
            if f >= 0:
                if exactly:
                    squared = find_downhill(x, f, triangles)[1]
                else:
                    squared = _measure_squared_distance(x, triangles.corners[f], triangles.sides[f])
                gap = min(most, math.sqrt(squared))
            total += gap
        gaps[k] = total / max(1, len(points))


@njit
def find_triangle_near(x, triangles):
    """Return the number of the triangle nearest to the cell of x (3,), or -1 beyond reach."""
    i = math.floor((x[0] - triangles.low[0]) / triangles.cell)
    j = math.floor((x[1] - triangles.low[1]) / triangles.cell)
    k = math.floor((x[2] - triangles.low[2]) / triangles.cell)
    a, b, c = triangles.nearest.shape
    if i < 0 or j < 0 or k < 0 or i >= a or j >= b or k >= c:
        return -1
    return int(triangles.nearest[i, j, k])


@njit
def find_downhill(x, f, triangles):
    """Return the triangle nearest to x (3,), and its squared distance.

    The search starts at triangle f, and goes over shared edges as long as the triangles become nearer.
    """
    least = _measure_squared_distance(x, triangles.corners[f], triangles.sides[f])
    while True:
        best = f
        for number in range(triangles.ends[f], triangles.ends[f + 1]):
            other = triangles.beside[number]
            a, n = triangles.corners[other], triangles.normals[other]
            off = n[0] * (x[0] - a[0]) + n[1] * (x[1] - a[1]) + n[2] * (x[2] - a[2])
            if off * off < least:  # otherwise even the plane of the triangle is farther
                d = _measure_squared_distance(x, a, triangles.sides[other])
                if d < least:
                    least, best = d, other
        if best == f:
            return f, least
        f = best


@njit
def find_closest_on_triangle(x, a, sides):
    """Return the point nearest to x (3,) of the triangle with corner a (3,) and `sides` (2, 3) from there.

    See Ericson, Real-Time Collision Detection, 5.1.5.
    """
    ab0, ab1, ab2 = sides[0, 0], sides[0, 1], sides[0, 2]
    ac0, ac1, ac2 = sides[1, 0], sides[1, 1], sides[1, 2]
    p0, p1, p2 = x[0] - a[0], x[1] - a[1], x[2] - a[2]
    d1, d2 = ab0 * p0 + ab1 * p1 + ab2 * p2, ac0 * p0 + ac1 * p1 + ac2 * p2
    between = ab0 * ac0 + ab1 * ac1 + ab2 * ac2
    d3, d4 = d1 - (ab0 * ab0 + ab1 * ab1 + ab2 * ab2), d2 - between
    d5, d6 = d1 - between, d2 - (ac0 * ac0 + ac1 * ac1 + ac2 * ac2)
    v = w = 0.0
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    return a[0] + v * ab0 + w * ac0, a[1] + v * ab1 + w * ac1, a[2] + v * ab2 + w * ac2


@njit
def carry(corners, sides, normals, low, cell, reach, nearest):
    """Fill `nearest` (X, Y, Z) with triangles, first in the cells that triangles cross, then outwards cell by cell."""
    X, Y, Z = nearest.shape
    squared = np.empty((X, Y, Z), np.float32)
    for i in range(X):
        for j in range(Y):
            for k in range(Z):
                squared[i, j, k] = np.inf
    count = _mark_crossed(corners, sides, normals, low, cell, nearest, squared)
    wave = np.empty((count, 3), np.int32)
    count = 0
    for i in range(X):
        for j in range(Y):
            for k in range(Z):
                if nearest[i, j, k] >= 0:
                    wave[count, 0], wave[count, 1], wave[count, 2] = i, j, k
                    count += 1
    queued = np.zeros(nearest.shape, np.int16)
    x = np.empty(3)
    for layer in range(1, 4 * math.ceil(reach / cell) + 2):
        after, ahead = np.empty((6 * count, 3), np.int32), 0
        for n in range(count):
            f = nearest[wave[n, 0], wave[n, 1], wave[n, 2]]
            for s in range(6):
                i, j, k = wave[n, 0] + SIDES[s, 0], wave[n, 1] + SIDES[s, 1], wave[n, 2] + SIDES[s, 2]
                if i < 0 or j < 0 or k < 0 or i >= X or j >= Y or k >= Z or nearest[i, j, k] == f:
                    continue
                x[0], x[1], x[2] = low[0] + (i + 0.5) * cell, low[1] + (j + 0.5) * cell, low[2] + (k + 0.5) * cell
                d = _measure_squared_distance(x, corners[f], sides[f])
                if d < squared[i, j, k] and d <= reach * reach:
                    squared[i, j, k], nearest[i, j, k] = d, f
                    if queued[i, j, k] != layer:
                        queued[i, j, k] = layer
                        after[ahead, 0], after[ahead, 1], after[ahead, 2] = i, j, k
                        ahead += 1
        wave, count = after, ahead
        if count == 0:
            break


@njit
def _mark_crossed(corners, sides, normals, low, cell, nearest, squared):
    """Assign each triangle to the cells within two cell sides of it. Return how many cells have a triangle."""
    x, first, last, count = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64), 0
    near = 2.0 * cell
    for f in range(len(corners)):
        for m in range(3):
            least = corners[f, m] + min(0.0, sides[f, 0, m], sides[f, 1, m])
            most = corners[f, m] + max(0.0, sides[f, 0, m], sides[f, 1, m])
            first[m] = max(0, math.floor((least - low[m]) / cell) - 1)
            last[m] = min(nearest.shape[m] - 1, math.floor((most - low[m]) / cell) + 1)
        n, a = normals[f], corners[f]
        for i in range(first[0], last[0] + 1):
            x[0] = low[0] + (i + 0.5) * cell
            for j in range(first[1], last[1] + 1):
                x[1] = low[1] + (j + 0.5) * cell
                for k in range(first[2], last[2] + 1):
                    x[2] = low[2] + (k + 0.5) * cell
                    off = n[0] * (x[0] - a[0]) + n[1] * (x[1] - a[1]) + n[2] * (x[2] - a[2])
                    if abs(off) > near:
                        continue
                    d = _measure_squared_distance(x, corners[f], sides[f])
                    if d < squared[i, j, k] and d <= near * near:
                        count += nearest[i, j, k] < 0
                        squared[i, j, k], nearest[i, j, k] = d, f
    return count


@njit
def _measure_squared_distance(x, a, sides):
    p = find_closest_on_triangle(x, a, sides)
    return (x[0] - p[0]) ** 2 + (x[1] - p[1]) ** 2 + (x[2] - p[2]) ** 2
