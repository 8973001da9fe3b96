"""The equations of the joint registration, compiled with numba.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). A touch's twist is about the
touch's centre, in the frame of its sensor.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_loc.core.compiled import njit
from tactile_loc.core.objects.surface_field import find_closest_on_triangle, find_downhill, find_triangle_near

# mypy: ignore-errors

GROSS_MM = 0.5  # a larger distance counts as this much, because it is an outlier and not noise
NEAR_PLANE_MM = 0.1  # for a point less than this beside its triangle, the distance to the triangle's plane is used


@njit(fast=True)
def build_equations(first, last, T_each, every, observed, triangles, samples, scale, A, b, misfit):
    """Fill A (K, N, 6, 6), b (K, N, 6) for twists u that make poses T_each (K, N, 4, 4) explain their touches better.

    The twists solve A u = b. Only poses from first to last are filled. Pose k uses one point out of every[k].
    `triangles` are the object's triangles, in mm; `samples` are points of its surface, in blocks. `scale`, mm, is the
    scale of the robust weights. `misfit` (K, 2) gets two sums over the points: of weighted squared distances, mm^2, and
    of weights. A, b and `misfit` must be zeros at the start.
    """
    for k in range(first, last):
        for i in range(T_each.shape[1]):
            add_seen(i, T_each[k, i], observed, triangles, scale, every[k], A[k, i], b[k, i], misfit[k])
            add_kept_out(i, T_each[k, i], observed, samples, scale, every[k], A[k, i], b[k, i])
            for m in range(6):
                for n in range(m):
                    A[k, i, m, n] = A[k, i, n, m]


@njit(fast=True)
def add_seen(i, T, observed, triangles, scale, every, A, b, misfit):
    """Add the equations of touch i's points: each must lie on a part of the object's surface that faces the same way.

    Also add the points' weighted squared distances, mm^2, and their weights to the misfit (2,).
    """
    x, y = np.empty(3), np.empty(3)
    J = np.empty(6)
    for j in range(observed.starts[i], observed.starts[i + 1], every):
        p, n = observed.points[j], observed.normals[j]
        for a in range(3):  # x and y are the point and its normal in the object frame
            x[a] = T[0, a] * (p[0] - T[0, 3]) + T[1, a] * (p[1] - T[1, 3]) + T[2, a] * (p[2] - T[2, 3])
            y[a] = T[0, a] * n[0] + T[1, a] * n[1] + T[2, a] * n[2]
        f = find_triangle_near(x, triangles)
        if f < 0:
            continue
        f, squared = find_downhill(x, f, triangles)
        m = triangles.normals[f]
        facing = m[0] * y[0] + m[1] * y[1] + m[2] * y[2]
        if facing <= 0.0:
            continue
        corner = triangles.corners[f]
        off = m[0] * (x[0] - corner[0]) + m[1] * (x[1] - corner[1]) + m[2] * (x[2] - corner[2])
        d0, d1, d2, r = m[0], m[1], m[2], off
        if squared - off * off > (NEAR_PLANE_MM + 0.5 * abs(off)) ** 2:  # the point is beside the triangle
            c = find_closest_on_triangle(x, corner, triangles.sides[f])
            r = math.sqrt(squared)
            d0, d1, d2 = (x[0] - c[0]) / r, (x[1] - c[1]) / r, (x[2] - c[2]) / r
        r = math.copysign(max(0.0, abs(r) - observed.slack[j]), r)
        weight = every * observed.weights[j] * facing / (1.0 + r * r / (scale * scale)) ** 2
        # y is now the direction d in the sensor frame: if u moves the point by u(p), the residual falls by d . u(p)
        for a in range(3):
            y[a] = T[a, 0] * d0 + T[a, 1] * d1 + T[a, 2] * d2
        compute_row(p, observed.centres[i], y, J)
        add(J, r, weight, A, b)
        weight = every * observed.weights[j] * facing
        misfit[0] += weight * min(r * r, GROSS_MM**2)
        misfit[1] += weight


@njit(fast=True)
def add_kept_out(i, T, observed, samples, scale, every, A, b):
    """Add the equations of surface samples that reach deeper into the gel than touch i shows."""
    camera = observed.cameras[i]
    pinhole, fx, fy, cx, cy, gel = camera[0] > 0.0, camera[1], camera[2], camera[3], camera[4], camera[5]
    height, width, offset = observed.sizes[i, 0], observed.sizes[i, 1], observed.offsets[i]
    d, p, J = np.empty(3), np.empty(3), np.empty(6)
    z0, z1, z2, above = T[2, 0], T[2, 1], T[2, 2], T[2, 3] - gel
    for block in range(len(samples.radii)):
        s = samples.centres[block]
        if z0 * s[0] + z1 * s[1] + z2 * s[2] + above >= samples.radii[block]:
            continue
        for j in range(samples.starts[block], samples.starts[block + 1], every):
            s = samples.corners[j, 0]
            z = z0 * s[0] + z1 * s[1] + z2 * s[2] + above
            if z >= 0.0:
                continue
            z += gel
            x = T[0, 0] * s[0] + T[0, 1] * s[1] + T[0, 2] * s[2] + T[0, 3]
            y = T[1, 0] * s[0] + T[1, 1] * s[1] + T[1, 2] * s[2] + T[1, 3]
            if x < camera[6] or x > camera[7] or y < camera[8] or y > camera[9]:
                continue
            k = 1.0 / z if pinhole else 1.0
            u, v = math.floor(fx * x * k + cx - 0.5), math.floor(fy * y * k + cy - 0.5)
            if u < 0 or v < 0 or u >= width or v >= height:
                continue
            pixel = observed.images[offset + v * width + u]
            nothing = pixel[0] < 0.0
            surface = -pixel[0] if nothing else pixel[0]
            if not surface > z:  # the pixel is not observed, or the sample is not deeper
                continue
            r = min(surface, gel) - z
            d[0] = d[1] = 0.0
            d[2] = 1.0
            aside, across = pixel[1] - x, pixel[2] - y
            far = math.sqrt(aside * aside + across * across)
            if nothing and far < r:  # the contact beside the sample is nearer than the gel's surface
                r = far
                if r < 1e-6:
                    continue
                d[0], d[1], d[2] = aside / far, across / far, 0.0
            p[0], p[1], p[2] = x, y, z
            compute_row(p, observed.centres[i], d, J)
            # the sample moves with the object: it must move along d by r
            add(J, r, every * camera[10] / (1.0 + r * r / (scale * scale)) ** 2, A, b)


@njit(fast=True)
def compute_row(p, centre, d, J):
    """Fill J (6,) with the derivative of p's motion along d with respect to a twist about the centre."""
    l0, l1, l2 = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    J[0], J[1], J[2] = l1 * d[2] - l2 * d[1], l2 * d[0] - l0 * d[2], l0 * d[1] - l1 * d[0]
    J[3], J[4], J[5] = d[0], d[1], d[2]


@njit(fast=True)
def add(J, r, weight, A, b):
    """Add the upper half of weight J^T J to A, and weight J^T r to b."""
    for m in range(6):
        w = weight * J[m]
        b[m] += w * r
        for n in range(m, 6):
            A[m, n] += w * J[n]
