"""Contact shapes from height maps: one map of the object's underside for each rotation, shared by all translations.

The object's lower envelope is rasterised once for each rotation and then sampled. For an orthographic camera, the map
is sampled directly. For a pinhole camera, rays are marched through the contact band. With a coarse map of minima,
blocks of pixels that see nothing in the band are skipped, and the march is shortened.

A height map has one surface in each cell, so surfaces above an overhang are missing. (A pinhole camera would see a
small part of such surfaces.) Steep walls are placed to within half a cell. Poses that share no rotation are drawn
exactly, triangle by triangle.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import Capabilities, ComponentOptions, Float32, Poses, Renderer, SensorGeometry, TriangleMesh
from tactile_loc.plugin.helpers import draw_nearest_depths, group_rotations, njit, run_in_threads

FINE, COARSE = 4, 16  # side of a tile with known minimum, cells, at two levels
BLOCKS = (32, 8, 4)  # side of the blocks that are skipped at once, pixels, at three levels
WALL = 3.0  # cells: a larger rise between neighbouring cells is a wall, not a slope
Floats = NDArray[np.float64]

MAX_MAP_BYTES = 256 * 2**20


class HeightmapRenderer(Renderer):
    """Renders by height maps. This is fastest when many poses share few rotations, as in a pose grid."""

    capabilities = Capabilities(exact_undercuts=False)

    class Options(ComponentOptions):
        """`cell_mm` is the map's resolution. Walls are placed to within half a cell."""

        cell_mm: float = Field(default=0.1, gt=0.005, le=2.0, description="size of a height map cell, mm")

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths (N, H, W), metres, of poses (N, 4, 4) in contact. Depths beyond the band are inf."""
        T = np.asarray(T_sensor_object, float)
        depth = np.empty((len(T), *geometry.shape), np.float32)
        if len(T) == 0:
            return depth
        cell = self.options.cell_mm * 1e-3
        rotations, starts, members = group_rotations(T[:, :3, :3])
        slot = np.repeat(np.arange(len(rotations)), np.diff(starts))
        low, cells = _measure_footprints(mesh, rotations, T[members, :3, 3], starts, geometry, cell)
        # the map reaches a little beyond the band, for slopes that leave the band
        end = geometry.standoff_m + geometry.max_depth_m + WALL * cell
        ceilings = np.maximum.reduceat(end - T[members, 2, 3], starts[:-1])
        triangles, t = np.ascontiguousarray(mesh.triangles_m), np.ascontiguousarray(T[:, :3, 3])
        band = geometry.standoff_m, geometry.standoff_m + geometry.max_depth_m
        camera = geometry.is_pinhole, *band, *geometry.pixel_slopes, cell
        step = max(1, int(MAX_MAP_BYTES // (4 * cells[0] * cells[1])))
        for first in range(0, len(rotations), step):
            some = slice(first, first + step)
            last = min(first + step, len(rotations))
            maps = np.empty((last - first, *cells), np.float32)
            poses = slice(starts[first], starts[last])
            turned = rotations[some], low[some], ceilings[some]
            run_in_threads(rasterise, len(maps), triangles, turned, cell, maps)
            fine = _find_minima(maps, FINE)
            tiles = maps, fine, _find_minima(fine, COARSE // FINE), low[some]
            which = slot[poses] - first, members[poses]
            run_in_threads(sample, len(which[0]), tiles, which, t, camera, depth)
        return depth

    def render_apart(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths (N, H, W), metres, of poses (N, 4, 4) that share no rotation.

        This is exact, and for such poses two to three times as fast as height maps.
        """
        return draw_nearest_depths(mesh, T_sensor_object, geometry)


def _find_minima(maps: Float32, tile: int) -> Float32:
    """Return the least height (K, rows / tile, columns / tile) of every tile of the maps (K, rows, columns)."""
    count, rows, columns = maps.shape
    strips: Float32 = maps.reshape(count, rows // tile, tile, columns).min(axis=2)
    lowest: Float32 = strips.reshape(count, rows // tile, columns // tile, tile).min(axis=3)
    return lowest


def _measure_footprints(
    mesh: TriangleMesh, rotations: Floats, t_m: Floats, starts: NDArray[np.int64], geometry: SensorGeometry, cell: float
) -> tuple[Floats, tuple[int, int]]:
    """Return each rotation's map corner (K, 2) in metres and the common map size (rows, columns).

    A map covers the area below the rotated object that the camera can see within the contact band, with a margin of two
    cells. All translations of the rotation count: `t_m` (N, 3), grouped by `starts`.
    """
    view_low, view_high = _measure_view(geometry)
    turned = rotations[:, :2] @ mesh.vertices_m.T
    corner = np.maximum(np.minimum.reduceat(view_low - t_m[:, :2], starts[:-1]), turned.min(axis=2)) - 2 * cell
    end = np.minimum(np.maximum.reduceat(view_high - t_m[:, :2], starts[:-1]), turned.max(axis=2)) + 2 * cell
    corner = np.floor(corner / cell) * cell  # makes the cells independent of the other poses
    columns, rows = np.maximum(np.ceil((end - corner).max(axis=0) / cell).astype(int) + 1, 1)
    return corner, (int(-(-rows // COARSE) * COARSE), int(-(-columns // COARSE) * COARSE))


def _measure_view(geometry: SensorGeometry) -> tuple[Floats, Floats]:
    """Return the low (2,) and high (2,) corner of the camera's view of the contact band, metres."""
    reaches = (geometry.standoff_m, geometry.standoff_m + geometry.max_depth_m) if geometry.is_pinhole else (1.0,)
    ends = np.array([[slopes[0], slopes[-1]] for slopes in geometry.pixel_slopes])
    spans = np.stack([ends * reach for reach in reaches])
    return spans.min(axis=(0, 2)), spans.max(axis=(0, 2))


# The compiled loops. Lengths are in metres. A map's cell (row, column) samples the lower envelope at its centre, corner
# + (column + 1/2, row + 1/2) * cell, in the object's rotated frame.


@njit(fast=True)
def rasterise(first, last, triangles, turned, cell, maps):
    """Draw lower envelopes (K, rows, columns) of triangles (F, 3, 3) at the rotations from first to last.

    `turned` are the rotations (K, 3, 3), the corners (K, 2) of their maps, and the heights (K,) where the maps end.
    """
    rotations, corners, ceilings = turned
    for k in range(first, last):
        _rasterise_one(triangles, rotations[k], corners[k], ceilings[k], cell, maps[k])


@njit(fast=True)
def _rasterise_one(triangles, R, corner, ceiling, cell, envelope):
    """Draw the lower envelope (rows, columns) of triangles (F, 3, 3) rotated by R; inf without a triangle."""
    envelope.fill(np.inf)
    p = np.empty((3, 3))
    for f in range(len(triangles)):
        for c in range(3):
            for a in range(3):
                q = triangles[f, c]
                p[c, a] = R[a, 0] * q[0] + R[a, 1] * q[1] + R[a, 2] * q[2]
            p[c, 0] = (p[c, 0] - corner[0]) / cell - 0.5
            p[c, 1] = (p[c, 1] - corner[1]) / cell - 0.5
        if min(p[0, 2], p[1, 2], p[2, 2]) < ceiling:
            _draw(p, envelope)


@njit(fast=True)
def _draw(p, envelope):
    """Lower the map's heights to a triangle where the triangle is lower. A corner is (column, row, height)."""
    rows, columns = envelope.shape
    ax, ay, bx, by = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[2, 0] - p[0, 0], p[2, 1] - p[0, 1]
    area = ax * by - ay * bx
    if abs(area) < 1e-12:
        return
    slope_x = ((p[1, 2] - p[0, 2]) * by - (p[2, 2] - p[0, 2]) * ay) / area
    slope_y = ((p[2, 2] - p[0, 2]) * ax - (p[1, 2] - p[0, 2]) * bx) / area
    first = max(0, math.ceil(min(p[0, 1], p[1, 1], p[2, 1])))
    last = min(rows - 1, math.floor(max(p[0, 1], p[1, 1], p[2, 1])))
    for r in range(first, last + 1):
        left, right = _find_span(p, r)
        for c in range(max(0, math.ceil(left - 1e-9)), min(columns - 1, math.floor(right + 1e-9)) + 1):
            z = p[0, 2] + slope_x * (c - p[0, 0]) + slope_y * (r - p[0, 1])
            if z < envelope[r, c]:
                envelope[r, c] = z


@njit(fast=True)
def _find_span(p, r):
    """Return the columns between which the scan line `r` lies in the triangle."""
    left, right = np.inf, -np.inf
    for i in range(3):
        j = (i + 1) % 3
        y0, y1 = p[i, 1], p[j, 1]
        if (y0 <= r <= y1) or (y1 <= r <= y0):
            if y0 == y1:
                left, right = min(left, p[i, 0], p[j, 0]), max(right, p[i, 0], p[j, 0])
            else:
                x = p[i, 0] + (r - y0) / (y1 - y0) * (p[j, 0] - p[i, 0])
                left, right = min(left, x), max(right, x)
    return left, right


@njit(fast=True)
def sample(first, last, tiles, which, t, camera, depth):
    """Fill `depth` (N, H, W) for the poses members[first:last], each from map slot[m], as seen by `camera`.

    `tiles` are the maps, their minima at two levels and their corners. `which` are `slot` and `members`. `camera`
    states whether it is a pinhole, the begin and the end of the band, the slopes of its rays, and the size of a cell.
    """
    (maps, fine, coarse, corners), (slot, members) = tiles, which
    for m in range(first, last):
        i, k = members[m], slot[m]
        _sample_one(maps[k], fine[k], coarse[k], corners[k], t[i], camera, depth[i])


@njit(fast=True)
def _sample_one(envelope, fine, coarse, corner, t, camera, picture):
    """Fill a picture (H, W) from one map, as seen by `camera`.

    Blocks of pixels are divided until their part of the map lies beyond the band, or until they are traced.
    """
    picture.fill(np.inf)
    height, width = picture.shape
    big, middle, small = BLOCKS
    end, cell = camera[2], camera[5]
    offset = ((t[0] + corner[0]) / cell, (t[1] + corner[1]) / cell, t[2])
    for v in range(0, height, big):
        for u in range(0, width, big):
            if _find_lowest(coarse, COARSE, u, v, big, camera, offset) >= end:
                continue
            for v1 in range(v, min(v + big, height), middle):
                for u1 in range(u, min(u + big, width), middle):
                    if _find_lowest(coarse, COARSE, u1, v1, middle, camera, offset) >= end:
                        continue
                    for v2 in range(v1, min(v1 + middle, height), small):
                        for u2 in range(u1, min(u1 + middle, width), small):
                            low = _find_lowest(fine, FINE, u2, v2, small, camera, offset)
                            if low < end:
                                _trace(envelope, low, u2, v2, camera, offset, picture)


@njit(fast=True)
def _find_lowest(tiles, tile, u, v, size, camera, offset):
    """Return the least depth of all tiles that a block's rays cross in the band, with a margin of one cell."""
    pinhole, begin, end, slopes_x, slopes_y, cell = camera
    near, far = (begin / cell, end / cell) if pinhole else (1.0 / cell, 1.0 / cell)
    x0, x1 = slopes_x[u], slopes_x[min(u + size, len(slopes_x)) - 1]
    y0, y1 = slopes_y[v], slopes_y[min(v + size, len(slopes_y)) - 1]
    rows, columns = tiles.shape
    first_row = max(0, int((min(y0 * near, y0 * far) - offset[1] - 1.5) // tile))
    last_row = min(rows - 1, int((max(y1 * near, y1 * far) - offset[1] + 1.5) // tile))
    first_column = max(0, int((min(x0 * near, x0 * far) - offset[0] - 1.5) // tile))
    last_column = min(columns - 1, int((max(x1 * near, x1 * far) - offset[0] + 1.5) // tile))
    low = np.float32(np.inf)
    for i in range(first_row, last_row + 1):
        for j in range(first_column, last_column + 1):
            low = min(low, tiles[i, j])
    return low + offset[2]


@njit(fast=True)
def _trace(envelope, low, u, v, camera, offset, picture):
    """Trace every ray of a small block of pixels, starting at the block's least depth."""
    pinhole, begin, end, slopes_x, slopes_y, cell = camera
    wall = WALL * cell
    x0, y0, z0 = offset
    low = max(low, begin)
    for row in range(v, min(v + BLOCKS[2], len(slopes_y))):
        sy = slopes_y[row] / cell
        for column in range(u, min(u + BLOCKS[2], len(slopes_x))):
            sx = slopes_x[column] / cell
            if pinhole:
                picture[row, column] = _march(envelope, (sx, sy, x0, y0, z0), low, end, wall)
            else:
                picture[row, column] = _interpolate_height(envelope, sx - x0 - 0.5, sy - y0 - 0.5, wall) + z0


@njit(fast=True)
def _interpolate_height(envelope, c, r, wall):
    """Return the height at a fractional cell: bilinear on a slope, or the nearest cell's height at a wall or edge."""
    rows, columns = envelope.shape
    j, i = math.floor(c), math.floor(r)
    if i < 0 or j < 0 or i >= rows - 1 or j >= columns - 1:
        return np.inf
    a, b, d, e = envelope[i, j], envelope[i, j + 1], envelope[i + 1, j], envelope[i + 1, j + 1]
    x, y = c - j, r - i
    if max(a, b, d, e) - min(a, b, d, e) < wall:
        return (1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * d + x * e)
    return float(envelope[i + (1 if y >= 0.5 else 0), j + (1 if x >= 0.5 else 0)])


@njit(fast=True)
def _march(envelope, ray, low, end, wall):
    """Return the depth, between `low` and `end`, at which a pinhole ray first meets the map, or inf.

    At depth z, the `ray` is at cell (sx z - x0, sy z - y0). The ray advances by at most two cells in a step.
    """
    sx, sy, x0, y0, z0 = ray
    rows, columns = envelope.shape
    steps = 1 + int(0.5 * max(abs(sx), abs(sy)) * (end - low))
    step = (end - low) / steps
    c, r, z = sx * low - x0, sy * low - y0, low
    for _ in range(steps + 1):
        i, j = int(r), int(c)
        if 0 <= i < rows and 0 <= j < columns and envelope[i, j] + z0 <= z:
            hit = _find_crossing(envelope, (sx, sy, x0 + 0.5, y0 + 0.5, z0), max(low, z - step), z, wall)
            return hit if hit < end else np.inf
        c, r, z = c + sx * step, r + sy * step, z + step
    return np.inf


@njit(fast=True)
def _find_crossing(envelope, ray, before, z, wall):
    """Return the depth, approximately between `before` and `z`, at which the ray crosses the map.

    On a slope, two fixed-point steps with Aitken's extrapolation are exact. At a wall, the interval is halved three
    times.
    """
    sx, sy, x0, y0, z0 = ray
    first = _interpolate_height(envelope, sx * z - x0, sy * z - y0, wall) + z0
    second = _interpolate_height(envelope, sx * first - x0, sy * first - y0, wall) + z0
    move, then = first - z, second - first
    if abs(then) > wall:
        for _ in range(3):
            middle = 0.5 * (before + z)
            if _interpolate_height(envelope, sx * middle - x0, sy * middle - y0, wall) + z0 > middle:
                before = middle
            else:
                z = middle
        return 0.5 * (before + z)
    curve = then - move
    crossing = second if curve == 0.0 else second - then * then / curve
    return min(max(crossing, before), z + wall)
