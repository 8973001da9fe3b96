"""The equations of the joint registration, compiled with numba.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). A touch's twist is about the
touch's centre, in the frame of its sensor.
"""

import math

import numpy as np

from tactile_loc.core.objects.surface_field import find_cell_triangle, find_closest_point, walk_to_nearest
from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors

GROSS_MM = 0.5  # a larger distance counts as this much, because it is an outlier and not noise
NEAR_PLANE_MM = 0.1  # for a point less than this beside its triangle, the distance to the triangle's plane is used


@njit(fast=True)
def build_equations(T_each, observed, triangles, samples, weighing, A, b):
    """Fill A (N, 6, 6), b (N, 6) for twists u that make poses T_each (N, 4, 4) explain N touches better.

    The twists solve A u = b. `weighing` has three numbers: the scale of the robust weights, mm; how many points there
    are for each point that is used; and the noise, mm. If the points of all touches have a larger misfit than the
    noise, their weights are reduced accordingly. Returns the misfit: the sum of squared distances of points and
    samples, mm^2, divided by the number of points. An outlier counts as GROSS_MM.
    """
    scale, every, noise = weighing
    A[:], b[:] = 0.0, 0.0
    squares = weights = inside = 0.0
    for i in range(len(T_each)):
        squared, weight = add_seen(i, T_each[i], observed, triangles, (scale, every), A[i], b[i])
        inside += add_kept_out(i, T_each[i], observed, samples, (scale, every), A[i], b[i])
        squares, weights = squares + squared, weights + weight
    surer = min(1.0, noise * noise * weights / max(squares, 1e-30))
    for i in range(len(T_each)):
        for m in range(6):
            b[i, m] *= surer
            for n in range(m, 6):
                A[i, m, n] *= surer
                A[i, n, m] = A[i, m, n]
    return (squares + inside) / max(weights, 1e-30)


@njit(fast=True)
def add_seen(i, T, observed, triangles, weighing, A, b):
    """Add the equations of touch i's points: each must lie on a part of the object's surface that faces the same way.

    Returns two sums over the points: of weighted squared distances, mm^2, and of weights.
    """
    scale, every = weighing
    points, normals, weights, slacks = observed.points, observed.normals, observed.weights, observed.slack
    faces = triangles.faces
    c0, c1, c2 = observed.centres[i, 0], observed.centres[i, 1], observed.centres[i, 2]
    R00, R01, R02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    R10, R11, R12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    R20, R21, R22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    J = np.empty(6)
    squares = total = 0.0
    for j in range(observed.starts[i], observed.starts[i + 1], every):
        p0, p1, p2 = points[j, 0], points[j, 1], points[j, 2]
        q0, q1, q2 = p0 - t0, p1 - t1, p2 - t2
        x = R00 * q0 + R10 * q1 + R20 * q2  # the point in the object frame
        y = R01 * q0 + R11 * q1 + R21 * q2
        z = R02 * q0 + R12 * q1 + R22 * q2
        f = find_cell_triangle(x, y, z, triangles)
        if f < 0:
            continue
        f, squared = walk_to_nearest(x, y, z, f, triangles)
        m0, m1, m2 = faces[f, 9], faces[f, 10], faces[f, 11]
        d0 = R00 * m0 + R01 * m1 + R02 * m2  # the face's normal in the sensor frame
        d1 = R10 * m0 + R11 * m1 + R12 * m2
        d2 = R20 * m0 + R21 * m1 + R22 * m2
        facing = d0 * normals[j, 0] + d1 * normals[j, 1] + d2 * normals[j, 2]
        if facing <= 0.0:
            continue
        off = m0 * (x - faces[f, 0]) + m1 * (y - faces[f, 1]) + m2 * (z - faces[f, 2])
        r = off
        if squared - off * off > (NEAR_PLANE_MM + 0.5 * abs(off)) ** 2:  # the point is beside the triangle
            n0, n1, n2 = find_closest_point(x, y, z, f, faces)
            r = math.sqrt(squared)
            n0, n1, n2 = (x - n0) / r, (y - n1) / r, (z - n2) / r
            d0 = R00 * n0 + R01 * n1 + R02 * n2
            d1 = R10 * n0 + R11 * n1 + R12 * n2
            d2 = R20 * n0 + R21 * n1 + R22 * n2
        r = math.copysign(max(0.0, abs(r) - slacks[j]), r)
        weight = every * weights[j] * facing
        squares += weight * min(r * r, GROSS_MM**2)
        total += weight
        # if a twist u moves the point by u(p), the residual falls by d . u(p)
        fill_row(p0 - c0, p1 - c1, p2 - c2, d0, d1, d2, J)
        add(J, r, weight / (1.0 + r * r / (scale * scale)) ** 2, A, b)
    return squares, total


@njit(fast=True)
def add_kept_out(i, T, observed, samples, weighing, A, b):
    """Add the equations of surface samples that reach deeper into the gel than touch i shows.

    Returns the sum of their weighted squared distances, mm^2.
    """
    scale, every = weighing
    camera, images = observed.cameras[i], observed.images
    pinhole, fx, fy, cx, cy, gel = camera[0] > 0.0, camera[1], camera[2], camera[3], camera[4], camera[5]
    left, right, top, bottom, sample_weight = camera[6], camera[7], camera[8], camera[9], camera[10]
    c0, c1, c2 = observed.centres[i, 0], observed.centres[i, 1], observed.centres[i, 2]
    height, width, offset = observed.sizes[i, 0], observed.sizes[i, 1], observed.offsets[i]
    middles, radii, starts, corners = samples.centres, samples.radii, samples.starts, samples.corners
    J = np.empty(6)
    z0, z1, z2, above = T[2, 0], T[2, 1], T[2, 2], T[2, 3] - gel
    squares = 0.0
    for block in range(len(radii)):
        if z0 * middles[block, 0] + z1 * middles[block, 1] + z2 * middles[block, 2] + above >= radii[block]:
            continue
        for j in range(starts[block], starts[block + 1], every):
            s0, s1, s2 = corners[j, 0, 0], corners[j, 0, 1], corners[j, 0, 2]
            z = z0 * s0 + z1 * s1 + z2 * s2 + above
            if z >= 0.0:
                continue
            z += gel
            x = T[0, 0] * s0 + T[0, 1] * s1 + T[0, 2] * s2 + T[0, 3]
            y = T[1, 0] * s0 + T[1, 1] * s1 + T[1, 2] * s2 + T[1, 3]
            if x < left or x > right or y < top or y > bottom:
                continue
            k = 1.0 / z if pinhole else 1.0
            u, v = math.floor(fx * x * k + cx - 0.5), math.floor(fy * y * k + cy - 0.5)
            if u < 0 or v < 0 or u >= width or v >= height:
                continue
            pixel = offset + v * width + u
            lowest = images[pixel, 0]
            nothing = lowest < 0.0
            surface = -lowest if nothing else lowest
            if not surface > z:  # the pixel is not observed, or the sample is not deeper
                continue
            r = min(surface, gel) - z
            d0, d1, d2 = 0.0, 0.0, 1.0
            aside, across = images[pixel, 1] - x, images[pixel, 2] - y
            far = math.sqrt(aside * aside + across * across)
            if nothing and far < r:  # the contact beside the sample is nearer than the gel's surface
                r = far
                if r < 1e-6:
                    continue
                d0, d1, d2 = aside / far, across / far, 0.0
            # the sample moves with the object: it must move along d by r
            fill_row(x - c0, y - c1, z - c2, d0, d1, d2, J)
            add(J, r, every * sample_weight / (1.0 + r * r / (scale * scale)) ** 2, A, b)
            squares += every * sample_weight * min(r * r, GROSS_MM**2)
    return squares


@njit(fast=True)
def fill_row(l0, l1, l2, d0, d1, d2, J):
    """Fill J (6,) with the derivative of a point's motion along d with respect to a twist. The point is at l."""
    J[0], J[1], J[2] = l1 * d2 - l2 * d1, l2 * d0 - l0 * d2, l0 * d1 - l1 * d0
    J[3], J[4], J[5] = d0, d1, d2


@njit(fast=True)
def add(J, r, weight, A, b):
    """Add the upper half of weight J^T J to A, and weight J^T r to b."""
    for m in range(6):
        w = weight * J[m]
        b[m] += w * r
        for n in range(m, 6):
            A[m, n] += w * J[n]
