"""Robust Gauss-Newton steps of one pose at a time, registered to all touches, compiled with numba.

Lengths and twists are as in `gauss_newton.py`.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_loc.core.geometry.small_matrices import (
    add_transformed,
    fill_adjoint,
    fill_difference,
    move,
    multiply_transforms,
    solve,
)
from tactile_loc.core.registration.kernels import build_equations
from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors

FARTHEST_RAD, FARTHEST_MM = 0.2, 3.0  # largest rotation and translation of a step
DAMPING = 1e-4
DAMPING_PULLED = 1e-8  # where a prior pulls a pose, damping would only slow down the weak pull
LEVER_MM = 10.0  # a rotation counts as the motion of a point at this distance from its axis


@njit(fast=True)
def register_poses(
    first, last, T, T_each, parts, moved, misfit, observed, triangles, samples, middle, T_sensor_first, spread, noise,
    scales, finely, stride, settled, peaks, pulls,
):  # fmt: skip
    """Move the object's poses T (K, 4, 4) from first to last, and its poses in each touch T_each (K, N, 4, 4).

    Also fill `moved` (K,) with the length of the last step, mm. Two arrays are from before this step: `parts`
    (K, 2, 6, 6), the information from the first touch and from all others, and `misfit` (K,): see `build_equations`.
    `spread` (N, 6) has the variances of each touch's own error. `middle` (3,) is the object's centre. `scales` (I,) has
    the scale of the robust weights of each step. The last `finely` steps use all points; the others use one point out
    of `stride`. A pose whose step is shorter than `settled`, mm, is not moved further. A prior pulls the poses to its
    `peaks` (K, 4, 4) with the information `pulls` (K, 6, 6) about twists; both are empty without a prior.
    """
    count, pulled = T_each.shape[1], len(peaks) > 0
    A, b, H, g = np.empty((count, 6, 6)), np.empty((count, 6)), np.empty((6, 6)), np.empty((6, 1))
    for k in range(first, last):
        every = stride
        damping = DAMPING_PULLED if pulled and pulls[k].any() else DAMPING
        for number in range(len(scales)):
            if number + finely >= len(scales):
                every = 1
            misfit[k] = build_equations(T_each[k], every, observed, triangles, samples, scales[number], noise, A, b)
            H[:], g[:] = 0.0, 0.0
            if damping < DAMPING:
                add_pull(T[k], peaks[k], pulls[k], middle, H, g)
            if count == 1:
                moved[k] = step_to_one(
                    T[k], T_each[k], A, b, observed.centres, T_sensor_first, middle, parts[k], H, g, damping
                )
            else:
                moved[k] = step_to_all(
                    T[k], T_each[k], A, b, observed.centres, T_sensor_first, middle, spread, parts[k], H, g, damping
                )
            if scales[number] == scales[-1] and moved[k] < settled:
                if every == 1 or finely == 0:
                    break
                every = 1


@njit(fast=True)
def add_pull(T, peak, pull, middle, H, g):
    """Add the pull (6, 6) of a prior's `peak` (4, 4) on the pose T (4, 4) to the equations H x = g (6, 1)."""
    c0 = T[0, 0] * middle[0] + T[0, 1] * middle[1] + T[0, 2] * middle[2] + T[0, 3]
    c1 = T[1, 0] * middle[0] + T[1, 1] * middle[1] + T[1, 2] * middle[2] + T[1, 3]
    c2 = T[2, 0] * middle[0] + T[2, 1] * middle[1] + T[2, 2] * middle[2] + T[2, 3]
    e = np.empty(6)
    fill_difference(peak, T, c0, c1, c2, e)
    for m in range(6):
        for n in range(6):
            H[m, n] += pull[m, n]
            g[m, 0] += pull[m, n] * e[n]


@njit(fast=True)
def step_to_one(T, T_each, A, b, centres, T_sensor_first, middle, parts, H, g, damping):
    """Take the step of `step_to_all` for one touch. Return its length, mm.

    One touch cannot separate its own error from the object's pose, so only the pose moves.
    """
    Ad = np.empty((6, 6))
    fill_change(T_each[0], T_sensor_first[0], centres[0], middle, Ad)
    parts[:] = 0.0
    add_transformed(Ad, A[0], parts[0])
    add_turned(Ad, b[0], g)
    H += parts[0]
    x, far = solve_step(H, g, damping)
    move_object(T, x, middle)
    multiply_transforms(T_sensor_first[0], T, T_each[0])
    return far


@njit(fast=True)
def step_to_all(T, T_each, A, b, centres, T_sensor_first, middle, spread, parts, H, g, damping):
    """Take one step of the object's pose T (4, 4) and of its poses T_each (N, 4, 4). Return its length, mm.

    Touch i gives the equations A u = b for a twist u of its pose in T_each. Its present error is e. Its new error s
    has the covariance S, and the object's twist is x. Then u = Ad x - e + s. Eliminating s gives the equations for
    Ad x: the matrix (1 + A S)^-1 A and the right side (1 + A S)^-1 (b + A e). The pull of a prior is already in the
    matrix H (6, 6) and the right side g (6, 1).
    """
    count = len(T_each)
    Ad, left, M = np.empty((count, 6, 6)), np.empty((count, 6, 7)), np.empty((6, 6))
    e, s, nominal = np.empty(6), np.empty(6), np.empty((4, 4))
    parts[:] = 0.0
    for i in range(count):
        multiply_transforms(T_sensor_first[i], T, nominal)
        fill_difference(T_each[i], nominal, centres[i, 0], centres[i, 1], centres[i, 2], e)
        fill_change(nominal, T_sensor_first[i], centres[i], middle, Ad[i])
        for m in range(6):
            left[i, m, 6] = b[i, m]
            for n in range(6):
                left[i, m, n] = A[i, m, n]
                left[i, m, 6] += A[i, m, n] * e[n]
                M[m, n] = A[i, m, n] * spread[i, n]
            M[m, m] += 1.0
        solve(M, left[i])
        if i == 0:
            add_transformed(Ad[0], A[0], parts[0])
            add_transformed(Ad[0], left[0], H)
        else:
            add_transformed(Ad[i], left[i], parts[1])
        add_turned(Ad[i], left[i, :, 6], g)
    H += parts[1]
    x, far = solve_step(H, g, damping)
    move_object(T, x, middle)
    for i in range(count):
        # the touch's new error s, given the object's twist: S (1 + A S)^-1 (b + A e - A Ad x)
        for m in range(6):  # e is now the twist of the touch's pose by x
            e[m] = 0.0
            for n in range(6):
                e[m] += Ad[i, m, n] * x[n]
        for m in range(6):
            own = left[i, m, 6]
            for n in range(6):
                own -= left[i, m, n] * e[n]
            s[m] = spread[i, m] * own
        multiply_transforms(T_sensor_first[i], T, T_each[i])
        move(T_each[i], s, centres[i, 0], centres[i, 1], centres[i, 2])
    return far


@njit(fast=True)
def fill_change(seen, T_sensor_first, centre, middle, Ad):
    """Fill Ad (6, 6): from twists about the object's centre to twists about a touch's `centre`, at the pose `seen`."""
    x = centre[0] - seen[0, 0] * middle[0] - seen[0, 1] * middle[1] - seen[0, 2] * middle[2] - seen[0, 3]
    y = centre[1] - seen[1, 0] * middle[0] - seen[1, 1] * middle[1] - seen[1, 2] * middle[2] - seen[1, 3]
    z = centre[2] - seen[2, 0] * middle[0] - seen[2, 1] * middle[1] - seen[2, 2] * middle[2] - seen[2, 3]
    fill_adjoint(T_sensor_first, x, y, z, Ad)


@njit(fast=True)
def add_turned(Ad, b, g):
    """Add Ad^T b to g (6, 1)."""
    for m in range(6):
        for n in range(6):
            g[n, 0] += Ad[m, n] * b[m]


@njit(fast=True)
def move_object(T, x, middle):
    """Move the object's pose T (4, 4) by a twist x (6,) about its centre, which is `middle` (3,) in its own frame."""
    c0 = T[0, 0] * middle[0] + T[0, 1] * middle[1] + T[0, 2] * middle[2] + T[0, 3]
    c1 = T[1, 0] * middle[0] + T[1, 1] * middle[1] + T[1, 2] * middle[2] + T[1, 3]
    c2 = T[2, 0] * middle[0] + T[2, 1] * middle[1] + T[2, 2] * middle[2] + T[2, 3]
    move(T, x, c0, c1, c2)


@njit(fast=True)
def solve_step(H, g, damping):
    """Solve H x = g (6, 1), damped by the share `damping` of H, for a twist x (6,) of limited size.

    Also return the length of x, mm.
    """
    damped, x = H.copy(), np.zeros(6)
    turn, shift = (H[0, 0] + H[1, 1] + H[2, 2]) / 3, (H[3, 3] + H[4, 4] + H[5, 5]) / 3
    if shift <= 0.0:
        return x, 0.0
    for n in range(3):
        damped[n, n] += damping * turn + 1e-9
        damped[3 + n, 3 + n] += damping * shift + 1e-9
    solve(damped, g)
    for n in range(6):
        x[n] = g[n, 0]
    angle, far = math.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2), math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2)
    shorter = min(1.0, FARTHEST_RAD / (angle + 1e-12), FARTHEST_MM / (far + 1e-12))
    x *= shorter
    return x, (far + LEVER_MM * angle) * shorter
