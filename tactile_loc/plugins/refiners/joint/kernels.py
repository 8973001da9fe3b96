"""One pose registered to all touches at once, compiled (numba).

Lengths in mm. A twist (6,) is a rotation (rad) before a translation (mm); it turns about the touch's own centre, in its
sensor's frame, or about the object's centre in the first sensor's frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import closest_on_triangle, downhill, njit, triangle_near

# mypy: ignore-errors

SETTLED_MM = 1e-4
COARSELY = 3  # one point of so many is looked at at first
GROSS_MM = 0.5  # a point that is off by more is no more of a sign of noise
NEAR_PLANE_MM = 0.1  # a point beside its triangle by less is measured to the triangle's plane


class Observed(NamedTuple):
    """What N touches show, all in mm and each in its own sensor's frame.

    `points` (P, 3) on the surface in contact with unit `normals` (P, 3), which point into the sensor, and `weights`
    (P,), 1/mm^2, which may be `slack` (P,) off for nothing; those of touch i from starts[i] to starts[i + 1].
    `T_sensor_first` (N, 4, 4) where its sensor is, `freedom` (N, 6, 6) the covariance of a twist about `centres` (N, 3)
    by which that, and the press, may be off. `cameras` (N, 11): pinhole?, fx, fy, cx, cy, the gel's height, its
    rectangle (4), the weight (1/mm^2) of a surface sample that reaches into it. `images` (Q, 4) hold, for every four
    neighbouring pixels, the least height of the surface that is seen (beyond the gel's: nothing; NaN: not observed),
    below which nothing between their centres can be, and the place x, y, z of the nearest contact; those of touch i are
    rows of sizes[i] (height, width) from offsets[i]. `noise` is the least standard deviation of a point, which weights
    assume; `share` (6,) is how much of what the first touch is off is its sensor's pose, not its press.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weights: NDArray[np.float64]
    slack: NDArray[np.float64]
    starts: NDArray[np.int64]
    T_sensor_first: NDArray[np.float64]
    freedom: NDArray[np.float64]
    centres: NDArray[np.float64]
    cameras: NDArray[np.float64]
    images: NDArray[np.float32]
    sizes: NDArray[np.int64]
    offsets: NDArray[np.int64]
    noise: float
    share: NDArray[np.float64]


@njit(fast=True)
def register(first, last, T, observed, triangles, samples, middle, scales, finely, T_each, information, moved):
    """Move the poses T (K, 4, 4) from first to last to where they explain all touches and the first sensor sees them.

    `triangles` are the object's in mm, `samples` (S, 3) points of its surface, `middle` (3,) its centre, `scales` (I,)
    the scale in mm of the robust weights, iteration by iteration, the last `finely` of which look at all points, the
    others at one of COARSELY. Filled are `T_each` (K, N, 4, 4), where each sensor sees the object, its own pose's error
    regarded; `information` (K, 2, 6, 6), what the first touch's points say of a twist about the middle in the first
    sensor's frame, and what the others say of it in the frame where that sensor is taken to be; and `moved` (K,), the
    last step, mm.
    """
    count = len(observed.centres)
    for k in range(first, last):
        for i in range(count):
            multiply(observed.T_sensor_first[i], T[k], T_each[k, i])
        every = COARSELY
        for n, scale in enumerate(scales):
            if n + finely >= len(scales):
                every = 1
            moved[k] = step(T[k], observed, triangles, samples, middle, scale, every, T_each[k], information[k])
            if moved[k] < SETTLED_MM and scale == scales[-1]:
                if every == 1 or finely == 0:
                    break
                every = 1
        seen_by_first(T[k], T_each[k, 0], observed)


@njit
def seen_by_first(T, T_each, observed):
    """Turn T (4, 4), where the first sensor would see the object if it were where it is taken to be, into where it
    does: its own error regarded, as far as that is not the press's."""
    x, inverse, motion, moved = np.empty(6), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    invert(T, inverse)
    multiply(T_each, inverse, motion)
    logarithm(motion, observed.centres[0], x)
    for r in range(6):
        x[r] *= observed.share[r]
    exponential(x, observed.centres[0], motion)
    multiply(motion, T, moved)
    for r in range(4):
        for c in range(4):
            T[r, c] = moved[r, c]


@njit(fast=True)
def step(T, observed, triangles, samples, middle, scale, every, T_each, information):
    """One Gauss-Newton step of a pose and of every sensor's error; return how far it moved, mm.

    Of touch i with equations A u = b for a twist u of its own pose, whose error e has the covariance S, remains
    (1 + A S)^-1 (A, b + A e) for the object's twist x, u = Ad x - e + (what S allows). All touches' points are taken
    for as noisy as they are off together.
    """
    count = len(observed.centres)
    A, b = np.zeros((count, 6, 6)), np.zeros((count, 6))
    Ad, errors = np.zeros((count, 6, 6)), np.zeros((count, 6))
    misfit, left, H, g = np.zeros(2), np.zeros((count, 6, 7)), np.zeros((6, 6)), np.zeros(6)
    nominal, inverse, gap = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    information[:] = 0.0
    centre = np.empty(3)
    for a in range(3):
        centre[a] = T[a, 0] * middle[0] + T[a, 1] * middle[1] + T[a, 2] * middle[2] + T[a, 3]
    for i in range(count):
        seen(i, T_each[i], observed, triangles, scale, every, A[i], b[i], misfit)
        kept_out(i, T_each[i], observed, samples, scale, every, A[i], b[i])
    surer = min(1.0, observed.noise**2 * misfit[1] / max(misfit[0], 1e-30))
    for i in range(count):
        for r in range(6):
            b[i, r] *= surer
            for c in range(6):
                A[i, r, c] *= surer
        multiply(observed.T_sensor_first[i], T, nominal)
        invert(nominal, inverse)
        multiply(T_each[i], inverse, gap)
        logarithm(gap, observed.centres[i], errors[i])
        adjoint(observed.T_sensor_first[i], centre, observed.centres[i], Ad[i])
        M, right = np.zeros((6, 6)), np.zeros((6, 7))
        for r in range(6):
            for c in range(6):
                M[r, c] = 1.0 if r == c else 0.0
                for m in range(6):
                    M[r, c] += A[i, r, m] * observed.freedom[i, m, c]
                right[r, c] = A[i, r, c]
            right[r, 6] = b[i, r]
            for m in range(6):
                right[r, 6] += A[i, r, m] * errors[i, m]
        solve(M, right)
        for r in range(6):
            for c in range(7):
                left[i, r, c] = right[r, c]
            for c in range(6):
                for m in range(6):
                    for n in range(6):
                        share = Ad[i, m, r] * right[m, n] * Ad[i, n, c]
                        H[r, c] += share
                        if i:
                            information[1, r, c] += share
                        else:
                            information[0, r, c] += Ad[i, m, r] * A[i, m, n] * Ad[i, n, c]
            for m in range(6):
                g[r] += Ad[i, m, r] * right[m, 6]
    x, damped = np.zeros((6, 1)), np.empty((6, 6))
    for r in range(6):
        for c in range(6):
            damped[r, c] = H[r, c]
    turning, sliding = H[0, 0] + H[1, 1] + H[2, 2], H[3, 3] + H[4, 4] + H[5, 5]
    if not sliding > 0.0:
        return 0.0
    for r in range(6):
        damped[r, r] += 1e-4 * (turning if r < 3 else sliding) / 3.0 + 1e-9
        x[r, 0] = g[r]
    solve(damped, x)
    angle = math.sqrt(x[0, 0] ** 2 + x[1, 0] ** 2 + x[2, 0] ** 2)
    far = math.sqrt(x[3, 0] ** 2 + x[4, 0] ** 2 + x[5, 0] ** 2)
    shorter = min(1.0, 0.2 / max(angle, 1e-12), 3.0 / max(far, 1e-12))
    for r in range(6):
        x[r, 0] *= shorter
    motion = np.empty((4, 4))
    exponential(x[:, 0], centre, motion)
    multiply(motion, T, nominal)
    for r in range(4):
        for c in range(4):
            T[r, c] = nominal[r, c]
    own = np.zeros((6, 1))
    for i in range(count):
        # the sensor's own error, given where the object is: S (1 + A S)^-1 (b + A e - A Ad x)
        for r in range(6):
            own[r, 0] = left[i, r, 6]
            for m in range(6):
                for n in range(6):
                    own[r, 0] -= left[i, r, m] * Ad[i, m, n] * x[n, 0]
        for r in range(6):
            errors[i, r] = 0.0
            for m in range(6):
                errors[i, r] += observed.freedom[i, r, m] * own[m, 0]
        exponential(errors[i], observed.centres[i], motion)
        multiply(observed.T_sensor_first[i], T, nominal)
        multiply(motion, nominal, T_each[i])
    return far * shorter + 10.0 * angle * shorter


@njit(fast=True)
def seen(i, T, observed, triangles, scale, every, A, b, misfit):
    """Add the equations of touch i's points: each lies on the object's surface, which faces as the point does.

    To the misfit (2,) are added their weighted squared distances, mm^2, and their weights.
    """
    x, y = np.empty(3), np.empty(3)
    J = np.empty(6)
    for j in range(observed.starts[i], observed.starts[i + 1], every):
        p, n = observed.points[j], observed.normals[j]
        for a in range(3):  # into the object's frame
            x[a] = T[0, a] * (p[0] - T[0, 3]) + T[1, a] * (p[1] - T[1, 3]) + T[2, a] * (p[2] - T[2, 3])
            y[a] = T[0, a] * n[0] + T[1, a] * n[1] + T[2, a] * n[2]
        f = triangle_near(x, triangles)
        if f < 0:
            continue
        f = downhill(x, f, triangles)
        m = triangles.normals[f]
        facing = m[0] * y[0] + m[1] * y[1] + m[2] * y[2]
        if facing <= 0.0:
            continue
        c = closest_on_triangle(x, triangles.corners[f])
        e0, e1, e2 = x[0] - c[0], x[1] - c[1], x[2] - c[2]
        off = e0 * m[0] + e1 * m[1] + e2 * m[2]
        squared = e0 * e0 + e1 * e1 + e2 * e2
        beside = max(0.0, squared - off * off)
        d0, d1, d2, r = m[0], m[1], m[2], off
        if beside > (NEAR_PLANE_MM + 0.5 * abs(off)) ** 2:
            r = math.sqrt(squared)
            d0, d1, d2 = e0 / r, e1 / r, e2 / r
        r = math.copysign(max(0.0, abs(r) - observed.slack[j]), r)
        weight = every * observed.weights[j] * facing / (1.0 + r * r / (scale * scale)) ** 2
        # back into the sensor's frame; the object moves by u, so that the residual falls by d . u(p)
        for a in range(3):
            y[a] = T[a, 0] * d0 + T[a, 1] * d1 + T[a, 2] * d2
        row(p, observed.centres[i], y, J)
        add(J, r, weight, A, b)
        weight = every * observed.weights[j] * facing
        misfit[0] += weight * min(r * r, GROSS_MM**2)
        misfit[1] += weight


@njit(fast=True)
def kept_out(i, T, observed, samples, scale, every, A, b):
    """Add the equations of surface samples that reach deeper into the gel of touch i than it shows."""
    camera = observed.cameras[i]
    pinhole, fx, fy, cx, cy, gel = camera[0] > 0.0, camera[1], camera[2], camera[3], camera[4], camera[5]
    height, width, offset = observed.sizes[i, 0], observed.sizes[i, 1], observed.offsets[i]
    d, p, J = np.empty(3), np.empty(3), np.empty(6)
    for j in range(0, len(samples), every):
        s = samples[j]
        z = T[2, 0] * s[0] + T[2, 1] * s[1] + T[2, 2] * s[2] + T[2, 3]
        if z >= gel:
            continue
        x = T[0, 0] * s[0] + T[0, 1] * s[1] + T[0, 2] * s[2] + T[0, 3]
        y = T[1, 0] * s[0] + T[1, 1] * s[1] + T[1, 2] * s[2] + T[1, 3]
        if x < camera[6] or x > camera[7] or y < camera[8] or y > camera[9]:
            continue
        k = 1.0 / z if pinhole else 1.0
        u, v = math.floor(fx * x * k + cx - 0.5), math.floor(fy * y * k + cy - 0.5)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        pixel = observed.images[offset + v * width + u]
        if not pixel[0] > z:  # not observed, or nothing is wrong
            continue
        r = min(pixel[0], gel) - z
        d[0] = d[1] = 0.0
        d[2] = 1.0
        aside, across = pixel[1] - x, pixel[2] - y
        far = math.sqrt(aside * aside + across * across)
        if pixel[0] >= gel and far < r:  # nearer to the contact beside it than to the gel's surface
            r = far
            if r < 1e-6:
                continue
            d[0], d[1], d[2] = aside / far, across / far, 0.0
        p[0], p[1], p[2] = x, y, z
        row(p, observed.centres[i], d, J)
        # here the point itself moves with the object, towards d, by r
        add(J, r, every * camera[10] / (1.0 + r * r / (scale * scale)) ** 2, A, b)


@njit(fast=True)
def row(p, centre, d, J):
    """The derivative (6,) of d . (motion of p) by a twist about the centre."""
    l0, l1, l2 = p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]
    J[0], J[1], J[2] = l1 * d[2] - l2 * d[1], l2 * d[0] - l0 * d[2], l0 * d[1] - l1 * d[0]
    J[3], J[4], J[5] = d[0], d[1], d[2]


@njit(fast=True)
def add(J, r, weight, A, b):
    """Add weight J^T J and weight J^T r."""
    for m in range(6):
        w = weight * J[m]
        b[m] += w * r
        for n in range(6):
            A[m, n] += w * J[n]


@njit
def solve(M, right):
    """Turn the right sides (6, C) into the solutions of M x = right, by elimination with pivots; M is used up."""
    size = len(M)
    for c in range(size):
        pivot = c
        for r in range(c + 1, size):
            if abs(M[r, c]) > abs(M[pivot, c]):
                pivot = r
        for m in range(size):
            M[c, m], M[pivot, m] = M[pivot, m], M[c, m]
        for m in range(right.shape[1]):
            right[c, m], right[pivot, m] = right[pivot, m], right[c, m]
        k = 1.0 / M[c, c] if M[c, c] != 0.0 else 0.0
        for r in range(size):
            if r != c:
                share = M[r, c] * k
                for m in range(c, size):
                    M[r, m] -= share * M[c, m]
                for m in range(right.shape[1]):
                    right[r, m] -= share * right[c, m]
        for m in range(right.shape[1]):
            right[c, m] *= k
        for m in range(c, size):
            M[c, m] *= k


@njit
def multiply(A, B, out):
    """Fill out (4, 4) with the transform A B."""
    for r in range(3):
        for c in range(4):
            out[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c] + (A[r, 3] if c == 3 else 0.0)
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@njit
def invert(T, out):
    """Fill out (4, 4) with the inverse of the rigid transform T."""
    for r in range(3):
        for c in range(3):
            out[r, c] = T[c, r]
        out[r, 3] = -(T[0, r] * T[0, 3] + T[1, r] * T[1, 3] + T[2, r] * T[2, 3])
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@njit
def exponential(x, centre, out):
    """Fill out (4, 4) with the motion that turns by x[:3] (rad) about the centre, then shifts by x[3:]."""
    angle = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    s = math.sin(angle) / angle if angle > 1e-9 else 1.0
    v = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-5 else 0.5
    a, b, c = x[0], x[1], x[2]
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - v * (b * b + c * c), v * a * b - s * c, v * a * c + s * b
    out[1, 0], out[1, 1], out[1, 2] = v * a * b + s * c, 1.0 - v * (a * a + c * c), v * b * c - s * a
    out[2, 0], out[2, 1], out[2, 2] = v * a * c - s * b, v * b * c + s * a, 1.0 - v * (a * a + b * b)
    for r in range(3):
        out[r, 3] = centre[r] + x[3 + r]
        out[r, 3] -= out[r, 0] * centre[0] + out[r, 1] * centre[1] + out[r, 2] * centre[2]
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@njit
def logarithm(T, centre, x):
    """Fill the twist x (6,) whose motion about the centre T is; small angles, as a sensor's error has."""
    x[0], x[1], x[2] = 0.5 * (T[2, 1] - T[1, 2]), 0.5 * (T[0, 2] - T[2, 0]), 0.5 * (T[1, 0] - T[0, 1])
    sine = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    if sine > 1e-9:
        k = math.asin(min(1.0, sine)) / sine
        x[0], x[1], x[2] = k * x[0], k * x[1], k * x[2]
    for r in range(3):
        x[3 + r] = T[r, 3] - centre[r]
        x[3 + r] += T[r, 0] * centre[0] + T[r, 1] * centre[1] + T[r, 2] * centre[2]


@njit
def adjoint(T, centre, other, out):
    """Fill out (6, 6): a twist about `centre` in one frame as a twist about `other` in the frame T leads to."""
    c = np.empty(3)
    for r in range(3):
        c[r] = other[r] - (T[r, 0] * centre[0] + T[r, 1] * centre[1] + T[r, 2] * centre[2] + T[r, 3])
    for r in range(3):
        for m in range(3):
            out[r, m] = out[3 + r, 3 + m] = T[r, m]
            out[r, 3 + m] = 0.0
    for m in range(3):  # turning shifts the other centre: w x c
        out[3, m] = T[1, m] * c[2] - T[2, m] * c[1]
        out[4, m] = T[2, m] * c[0] - T[0, m] * c[2]
        out[5, m] = T[0, m] * c[1] - T[1, m] * c[0]
