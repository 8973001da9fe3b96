"""Depth images by a z-buffer. Every triangle is drawn into each image, with exact depths at the pixel centres.

The time for a pose does not depend on its rotation, so the z-buffer suits poses that have different rotations.
Neighbouring triangles form blocks. A block beyond the contact band or outside the view is skipped as a whole.

The ray of a pixel is r = (x/z, y/z, 1). Let the columns of P be the corners of a triangle. Solving P b = r gives the
weights b of the corners. The ray meets the triangle if no weight is negative, at depth 1 / sum(b). A triangle that
reaches behind the camera needs no clipping (Olano and Greer, Triangle Scan Conversion using 2D Homogeneous Coordinates,
Graphics Hardware 1997). For parallel rays, r = (x, y, 1), and the third row of P is replaced by ones. The depth is then
the weighted mean of the corners' depths.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import math

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats, Poses
from tactile_loc.core.objects.blocks import Blocks, make_triangle_blocks
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.compiled import njit, run_in_threads
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

EDGE = 1e-9  # tolerance of a weight, so that no ray passes between two adjacent triangles
NARROW = 4  # pixels; in narrower bounding boxes, every pixel is tested
NEAREST = 0.05  # share of the standoff; a triangle with a corner nearer to the camera is tested at every pixel


def draw_nearest_depths(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
    """Return camera depths (N, H, W), metres, of the object at poses (N, 4, 4), in contact or not.

    A depth is exact up to the end of the contact band, and inf beyond.
    """
    T = np.ascontiguousarray(T_sensor_object, float)
    depth = np.empty((len(T), *geometry.shape), np.float32)
    ends = NEAREST * geometry.standoff_m, geometry.standoff_m + geometry.max_depth_m
    camera = geometry.is_pinhole, geometry.fx, geometry.fy, geometry.cx, geometry.cy, *ends
    which = np.empty((len(T), 0, 0), np.int32)
    run_in_threads(_draw, len(T), make_triangle_blocks(mesh), T, camera, geometry.pixel_slopes, (depth, which))
    return depth


def draw_nearest_faces(
    triangles: Floats, T_camera_object: Floats, x: Floats, y: Floats
) -> tuple[Float32, NDArray[np.int32]]:
    """Return the depths and the faces at which parallel rays along z first meet triangles (F, 3, 3) at a pose (4, 4).

    The rays pass through evenly spaced x (W,) and y (H,). The depths (H, W) are in the unit of the triangles; a ray
    that misses all triangles has the depth inf. The faces (H, W) are indices of triangles, or -1 for a miss.
    """
    # the picture shows all triangles, so that none is worth skipping
    block = Blocks(np.ascontiguousarray(triangles), np.array([0, len(triangles)]), np.zeros((1, 3)), np.array([np.inf]))
    depth = np.empty((1, len(y), len(x)), np.float32)
    which = np.full(depth.shape, -1, np.int32)
    fx, fy = 1 / (x[1] - x[0]), 1 / (y[1] - y[0])
    camera = False, fx, fy, 0.5 - fx * x[0], 0.5 - fy * y[0], 0.0, np.inf
    _draw(0, 1, block, np.ascontiguousarray(T_camera_object, float)[None], camera, (x, y), (depth, which))
    return depth[0], which[0]


@njit
def _draw(first, last, triangles, T, camera, slopes, drawn):
    """Fill the depths (N, H, W) of `drawn` for the poses `T` (N, 4, 4) from first to last.

    Unless the second array of `drawn` is empty, fill it with the indices of the triangles that the rays hit.
    """
    (slopes_x, slopes_y), (depth, which) = slopes, drawn
    pinhole, far = camera[0], camera[6]
    # slopes of the outermost rays; the planes through these rays bound the view
    left, right, top, bottom = slopes_x[0], slopes_x[-1], slopes_y[0], slopes_y[-1]
    for i in range(first, last):
        picture, hits = depth[i], which[i]  # taken here, because counting references is slow
        for v in range(picture.shape[0]):
            for u in range(picture.shape[1]):
                picture[v, u] = np.inf
        for b in range(len(triangles.radii)):
            x, y, z = place(T[i], triangles.centres[b])
            r = triangles.radii[b]
            k = z if pinhole else 1.0
            if (
                z - r > far
                or _is_beyond(left * k - x, left, pinhole, r)
                or _is_beyond(x - right * k, right, pinhole, r)
                or _is_beyond(top * k - y, top, pinhole, r)
                or _is_beyond(y - bottom * k, bottom, pinhole, r)
            ):
                continue
            for f in range(triangles.starts[b], triangles.starts[b + 1]):
                p = place(T[i], triangles.corners[f, 0])
                q = place(T[i], triangles.corners[f, 1])
                s = place(T[i], triangles.corners[f, 2])
                if min(p[2], q[2], s[2]) < far:
                    box = _find_box(p, q, s, camera, picture.shape[1], picture.shape[0])
                    if box[0] <= box[1] and box[2] <= box[3]:
                        _draw_triangle(f, (p, q, s), box, camera, slopes, (picture, hits))


@njit
def place(T, p):
    """Return the point p (3,) moved by the pose T (4, 4), as a tuple."""
    return (
        T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3],
        T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3],
        T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3],
    )


@njit
def _is_beyond(outside, slope, pinhole, r):
    """Return whether a sphere of radius r is completely outside a plane that bounds the view.

    `outside` is the distance of the sphere's centre from the plane along x or y, positive outside the view.
    """
    return outside > r * (math.sqrt(1.0 + slope * slope) if pinhole else 1.0) * (1.0 + 1e-9)


@njit
def _draw_triangle(f, corners, box, camera, slopes, drawn):
    """Draw triangle number f, whose three corners are in the camera frame, in the pixels of `box` (see `_find_box`)."""
    (p, q, s), (u0, u1, v0, v1) = corners, box
    (slopes_x, slopes_y), (picture, which) = slopes, drawn
    pinhole, far = camera[0], camera[6]
    zp, zq, zs = (p[2], q[2], s[2]) if pinhole else (1.0, 1.0, 1.0)
    # The rows of P's inverse, times the determinant. The weight of a corner is a x + b y + c.
    ap, bp, cp = q[1] * zs - zq * s[1], zq * s[0] - q[0] * zs, q[0] * s[1] - q[1] * s[0]
    aq, bq, cq = s[1] * zp - zs * p[1], zs * p[0] - s[0] * zp, s[0] * p[1] - s[1] * p[0]
    as_, bs, cs = p[1] * zq - zp * q[1], zp * q[0] - p[0] * zq, p[0] * q[1] - p[1] * q[0]
    determinant = p[0] * ap + p[1] * bp + zp * cp
    if determinant == 0.0:  # the camera sees the triangle edge-on
        return
    k = 1.0 / determinant
    ap, aq, as_ = ap * k, aq * k, as_ * k
    widest = max(abs(slopes_x[u0]), abs(slopes_x[u1]))
    for v in range(v0, v1 + 1):
        y = slopes_y[v]
        fp, fq, fs = (bp * y + cp) * k, (bq * y + cq) * k, (bs * y + cs) * k
        first, last = u0, u1
        if u1 - u0 > NARROW:  # a thin oblique triangle covers little of its bounding box
            most = (abs(ap) + abs(aq) + abs(as_)) * widest + abs(fp) + abs(fq) + abs(fs)
            first, last = _find_covered(ap, fp, 2 * EDGE * most, camera, first, last)
            first, last = _find_covered(aq, fq, 2 * EDGE * most, camera, first, last)
            first, last = _find_covered(as_, fs, 2 * EDGE * most, camera, first, last)
        for u in range(first, last + 1):
            x = slopes_x[u]
            wp, wq, ws = ap * x + fp, aq * x + fq, as_ * x + fs
            total = wp + wq + ws
            if min(wp, wq, ws) < -EDGE * abs(total):
                continue
            z = 1.0 / total if pinhole else (wp * p[2] + wq * q[2] + ws * s[2]) / total
            if 0.0 < z < far and z < picture[v, u]:
                picture[v, u] = z
                if which.size:
                    which[v, u] = f


@njit
def _find_covered(a, b, least, camera, first, last):
    """Return the first and last pixel between `first` and `last` of a row where a x + b can be at least -least."""
    if a == 0.0:
        return (first, last) if b >= -least else (0, -1)
    border = min(max(-1e9, (-least - b) / a * camera[1] + camera[3] - 0.5), 1e9)
    if a > 0.0:
        return max(first, math.floor(border)), last
    return first, min(last, math.ceil(border))


@njit
def _find_box(p, q, s, camera, width, height):
    """Return the first and last column, then the first and last row, of the pixel centres that a triangle can cover."""
    pinhole, fx, fy, cx, cy, near, _ = camera
    if pinhole and min(p[2], q[2], s[2]) < near:
        return 0, width - 1, 0, height - 1
    kp, kq, ks = (1.0 / p[2], 1.0 / q[2], 1.0 / s[2]) if pinhole else (1.0, 1.0, 1.0)
    u0, u1 = _find_span(p[0] * kp, q[0] * kq, s[0] * ks, fx, cx, width)
    v0, v1 = _find_span(p[1] * kp, q[1] * kq, s[1] * ks, fy, cy, height)
    return u0, u1, v0, v1


@njit
def _find_span(a, b, c, scale, centre, size):
    """Return the first and last pixel whose centres lie between the least and the greatest of three coordinates."""
    first = min(max(-1.0, min(a, b, c) * scale + centre - 0.5 - 1e-6), size * 1.0)
    last = max(min(size * 1.0, max(a, b, c) * scale + centre - 0.5 + 1e-6), -1.0)
    return max(0, math.ceil(first)), min(size - 1, math.floor(last))
