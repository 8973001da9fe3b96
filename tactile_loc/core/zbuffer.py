"""Depths by a z-buffer: every triangle is drawn pixel by pixel into each picture, exact at pixel centres.

The cost is one pass over the mesh a pose, whatever its rotation: best for few poses that all differ a little.
A pixel's ray is r = (x/z, y/z, 1). With the corners of a triangle as the columns of P, P b = r gives the weights b of
the corners; the ray meets the triangle where no weight is negative, at depth 1 / sum(b). Triangles that reach behind
the camera need no clipping (Olano and Greer, Triangle Scan Conversion using 2D Homogeneous Coordinates, Graphics
Hardware 1997). Parallel rays have r = (x, y, 1) and the depth is that of the weights' mean of the corners.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

EDGE = 1e-9  # of a weight: a ray that meets the edge between two triangles must not slip through
NEAREST = 0.05  # of the standoff: corners nearer to the camera, or behind it, are not projected


def nearest_depths(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> NDArray[np.float32]:
    """Return camera depths (N, H, W) in metres of poses (N, 4, 4), whether in contact or not.

    What lies beyond the contact band is inf; exact from the camera up to there.
    """
    T = np.ascontiguousarray(T_sensor_object, float)
    depth = np.empty((len(T), *geometry.shape), np.float32)
    vertices, faces = np.ascontiguousarray(mesh.vertices_m, float), np.ascontiguousarray(mesh.faces)
    ends = NEAREST * geometry.standoff_m, geometry.standoff_m + geometry.max_depth_m
    camera = geometry.is_pinhole, geometry.fx, geometry.fy, geometry.cx, geometry.cy, *ends
    in_threads(_draw, len(T), vertices, faces, T, camera, *geometry.pixel_slopes, depth)
    return depth


@njit
def _draw(first, last, vertices, faces, T, camera, slopes_x, slopes_y, depth):
    """Fill depths (N, H, W) of the poses (N, 4, 4) from first to last."""
    for i in range(first, last):
        _draw_one(vertices, faces, T[i], camera, slopes_x, slopes_y, depth[i])


@njit
def _draw_one(vertices, faces, T, camera, slopes_x, slopes_y, picture):
    """Fill a picture (H, W) with the nearest depth, metres, of the triangles that reach into the band."""
    picture.fill(np.inf)
    placed = np.empty_like(vertices)
    for i in range(len(vertices)):
        x, y, z = vertices[i]
        for a in range(3):
            placed[i, a] = T[a, 0] * x + T[a, 1] * y + T[a, 2] * z + T[a, 3]
    far = camera[6]
    for f in range(len(faces)):
        i, j, k = faces[f]
        if min(placed[i, 2], placed[j, 2], placed[k, 2]) < far:
            _draw_triangle(placed[i], placed[j], placed[k], camera, slopes_x, slopes_y, picture)


@njit
def _draw_triangle(p, q, s, camera, slopes_x, slopes_y, picture):
    """Draw one triangle; its corners (3,) are in the camera's frame."""
    u0, u1, v0, v1 = _box(p, q, s, camera, picture.shape[1], picture.shape[0])
    if u0 > u1 or v0 > v1:
        return
    pinhole, far = camera[0], camera[6]
    zp, zq, zs = (p[2], q[2], s[2]) if pinhole else (1.0, 1.0, 1.0)
    # The rows of P's inverse, but for the determinant: a weight is a x + b y + c.
    ap, bp, cp = q[1] * zs - zq * s[1], zq * s[0] - q[0] * zs, q[0] * s[1] - q[1] * s[0]
    aq, bq, cq = s[1] * zp - zs * p[1], zs * p[0] - s[0] * zp, s[0] * p[1] - s[1] * p[0]
    as_, bs, cs = p[1] * zq - zp * q[1], zp * q[0] - p[0] * zq, p[0] * q[1] - p[1] * q[0]
    determinant = p[0] * ap + p[1] * bp + zp * cp
    if determinant == 0.0:  # seen edge-on
        return
    k = 1.0 / determinant
    for v in range(v0, v1 + 1):
        y = slopes_y[v]
        for u in range(u0, u1 + 1):
            x = slopes_x[u]
            wp, wq, ws = (ap * x + bp * y + cp) * k, (aq * x + bq * y + cq) * k, (as_ * x + bs * y + cs) * k
            total = wp + wq + ws
            if min(wp, wq, ws) < -EDGE * abs(total):
                continue
            z = 1.0 / total if pinhole else (wp * p[2] + wq * q[2] + ws * s[2]) / total
            if 0.0 < z < far and z < picture[v, u]:
                picture[v, u] = z


@njit
def _box(p, q, s, camera, width, height):
    """First and last column, first and last row, of the pixels whose centres a triangle may cover."""
    pinhole, fx, fy, cx, cy, near, _ = camera
    if pinhole and min(p[2], q[2], s[2]) < near:
        return 0, width - 1, 0, height - 1
    kp, kq, ks = (1.0 / p[2], 1.0 / q[2], 1.0 / s[2]) if pinhole else (1.0, 1.0, 1.0)
    u0, u1 = _span(p[0] * kp, q[0] * kq, s[0] * ks, fx, cx, width)
    v0, v1 = _span(p[1] * kp, q[1] * kq, s[1] * ks, fy, cy, height)
    return u0, u1, v0, v1


@njit
def _span(a, b, c, scale, centre, size):
    """First and last pixel whose centre lies between the least and the greatest of three coordinates."""
    first = min(max(-1.0, min(a, b, c) * scale + centre - 0.5 - 1e-6), size * 1.0)
    last = max(min(size * 1.0, max(a, b, c) * scale + centre - 0.5 + 1e-6), -1.0)
    return max(0, math.ceil(first)), min(size - 1, math.floor(last))
