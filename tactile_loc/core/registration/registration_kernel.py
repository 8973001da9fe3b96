"""Registration of many poses, each to all touches at once, by robust Gauss-Newton steps.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). A touch's twist is about the
touch's centre, in the frame of its sensor. The object's twist is about the object's centre, in the frame of the first
sensor.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import math
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.lie import (
    adjoint,
    exponential,
    fill_one_adjoint,
    fill_one_logarithm,
    logarithm,
    move_one,
    multiply_one,
)
from tactile_loc.core.geometry.rigid import Floats, invert
from tactile_loc.core.objects.blocks import Blocks, NearestTriangles
from tactile_loc.core.registration.equations import build_equations
from tactile_loc.core.registration.observations import Observed
from tactile_loc.core.registration.prior_factors import PriorFactors
from tactile_loc.core.runtime.compiled import njit, run_in_threads

SETTLED_MM = 1e-3  # a pose has converged if its last step was shorter
FARTHEST_RAD, FARTHEST_MM = 0.2, 3.0  # largest rotation and translation of a step
DAMPING = 1e-4
DAMPING_WITH_PRIOR = 1e-8  # more damping would only slow down the weak factor of a prior
LEVER_MM = 10.0  # a rotation counts as the motion of a point at this distance from its axis
NO_FACTORS = PriorFactors(np.empty((0, 4, 4)), np.empty((0, 6, 6)))


class Schedule(NamedTuple):
    """The steps of a registration.

    `scales` (I,) are the scales of the robust weights, one for each step. The last `finely` steps use all points. The
    other steps use one point out of `stride`. A pose whose step is shorter than SETTLED_MM is not moved further.
    """

    scales: Floats
    finely: int
    stride: int


class RegisteredPoses(NamedTuple):
    """K registered poses of an object, given N touches.

    `T_reported` (K, 4, 4) are its poses relative to the reported pose of the first sensor, which has an error. `T_each`
    (K, N, 4, 4) are its poses in the frame of each touch's sensor, as this touch shows them. `moved` (K,) is the length
    of the last step, mm. The other arrays are from before this step: `misfit` (K,), mm^2, states how badly the poses
    explain the touches, and `parts` (K, 2, 6, 6) are the information about twists from the first touch and from all
    others.
    """

    T_reported: Floats
    T_each: Floats
    moved: Floats
    misfit: Floats
    parts: Floats


class RegistrationProblem(NamedTuple):
    """A registration problem: `observed`, the observations of N touches, and the touched object.

    The object has `triangles`, `samples` of its surface and a centre `middle` (3,). `T_sensor_first` (N, 4, 4) converts
    from the first sensor's frame to each sensor's frame. The touch of the first sensor itself can be left out. Each of
    these transforms has an unknown error, a twist about the touch's centre. The variances of this twist are the sum of
    `sensor` (N, 6), from the sensor's pose, and `press` (N, 6), from the press depth. `noise` is the least standard
    deviation of a point. The weights in `observed` assume this noise.
    """

    observed: Observed
    T_sensor_first: Floats
    sensor: Floats
    press: Floats
    noise: float
    triangles: NearestTriangles
    samples: Blocks
    middle: Floats

    def register(self, T: Floats, schedule: Schedule, factors: PriorFactors = NO_FACTORS) -> RegisteredPoses:
        """Move poses T (K, 4, 4), in the first sensor's frame, so that they explain all touches.

        `factors` (K), with lengths in mm, are those of a prior. They refer to twists of the object from a peak.
        """
        count = len(T)
        moved, misfit, parts = np.full(count, np.inf), np.full(count, np.inf), np.zeros((count, 2, 6, 6))
        found = RegisteredPoses(np.array(T), self.T_sensor_first @ T[:, None], moved, misfit, parts)
        run_in_threads(register_poses, count, found, self, self.sensor + self.press, schedule, factors)
        return found

    def inform(self, found: RegisteredPoses, reported: bool = False) -> Floats:
        """Return the information (K, 6, 6) about twists of poses in the first sensor's frame, along its axes.

        If `reported`, the twists are those of the poses relative to the reported pose of the first sensor. The parts of
        the information are reduced by errors, which are twists about the first touch's centre. The object's pose in the
        first sensor's frame is seen by the first touch with the error of its press depth, and by the others with the
        error of the first sensor's pose. The object's pose relative to the reported pose of the first sensor is seen by
        the first touch with both errors, and by the others with none of them.
        """
        press, sensor = self.press[0], self.sensor[0]
        errors = np.stack([press + sensor, np.zeros(6)] if reported else [press, sensor])
        back, T, parts = invert(self.T_sensor_first[0]), found.T_reported, found.parts
        touched = back[:3, :3] @ self.observed.centres[0] + back[:3, 3]
        to_centre = adjoint(back[:3, :3], T[:, :3, :3] @ self.middle + T[:, :3, 3] - touched)[:, None]
        allowed = errors[:, None, :] * to_centre @ to_centre.swapaxes(-1, -2)
        total = np.linalg.solve(np.eye(6) + parts @ allowed, parts).sum(axis=1)
        return np.asarray((total + total.swapaxes(1, 2)) / 2)

    def view_from_first(self, found: RegisteredPoses) -> Floats:
        """Return the poses (K, 4, 4) in the first sensor's frame.

        They are corrected by the error of the first sensor's pose, but not by the error of its press depth. The first
        touch shows the sum of both errors, which is divided in proportion to their variances. If the touch of the first
        sensor is left out, the first other touch counts.
        """
        T, allowed = found.T_reported, self.sensor[0] + self.press[0]
        if not self.sensor[0].any():
            return T
        share = np.divide(self.sensor[0], allowed, out=np.zeros(6), where=allowed > 0)
        centre, here = self.observed.centres[0], self.T_sensor_first[0]
        reported = here @ T
        corrected = exponential(share * logarithm(found.T_each[:, 0] @ invert(reported), centre), centre) @ reported
        return np.asarray(invert(here) @ corrected)


@njit(fast=True)
def register_poses(first, last, moving, problem, spread, schedule, factors):
    """Move the `RegisteredPoses` `moving` from first to last, as `RegistrationProblem.register` describes.

    `spread` (N, 6) are the variances of each touch's twist. `factors` (K) are those of a prior, or empty. For the
    misfit, see `build_equations`.
    """
    count, known = moving.T_each.shape[1], len(factors.T) > 0
    A, b, H, g = np.empty((count, 6, 6)), np.empty((count, 6)), np.empty((6, 6)), np.empty((6, 1))
    scales, equations = schedule.scales, (A, b, H, g)
    # each access to a part of a tuple counts references of all arrays in it, so this is not done in the loop
    observed, triangles, samples, noise = problem.observed, problem.triangles, problem.samples, problem.noise
    frames = problem.T_sensor_first, observed.centres, problem.middle, spread
    peaks, information = factors.T, factors.information
    for k in range(first, last):
        T, T_each = moving.T_reported[k], moving.T_each[k]
        every = schedule.stride
        damping = DAMPING_WITH_PRIOR if known and information[k].any() else DAMPING
        for number in range(len(scales)):
            if number + schedule.finely >= len(scales):
                every = 1
            moving.misfit[k] = build_equations(
                T_each, observed, triangles, samples, (scales[number], every, noise), A, b
            )
            H[:], g[:] = 0.0, 0.0
            if damping < DAMPING:
                add_factor(T, peaks[k], information[k], problem.middle, H, g)
            if count == 1:
                moving.moved[k] = step_to_one(T, T_each, equations, frames, moving.parts[k], damping)
            else:
                moving.moved[k] = step_to_all(T, T_each, equations, frames, moving.parts[k], damping)
            if scales[number] == scales[-1] and moving.moved[k] < SETTLED_MM:
                if every == 1 or schedule.finely == 0:
                    break
                every = 1


@njit(fast=True)
def add_factor(T, peak, information, middle, H, g):
    """Add a prior's `information` (6, 6) about its `peak` (4, 4), at the pose T (4, 4), to the equations H x = g."""
    c0 = T[0, 0] * middle[0] + T[0, 1] * middle[1] + T[0, 2] * middle[2] + T[0, 3]
    c1 = T[1, 0] * middle[0] + T[1, 1] * middle[1] + T[1, 2] * middle[2] + T[1, 3]
    c2 = T[2, 0] * middle[0] + T[2, 1] * middle[1] + T[2, 2] * middle[2] + T[2, 3]
    e = np.empty(6)
    fill_one_logarithm(peak, T, c0, c1, c2, e)
    for m in range(6):
        for n in range(6):
            H[m, n] += information[m, n]
            g[m, 0] += information[m, n] * e[n]


@njit(fast=True)
def step_to_one(T, T_each, equations, frames, parts, damping):
    """Take the step of `step_to_all` for one touch. Return its length, mm.

    One touch cannot separate its own error from the object's pose, so only the pose moves.
    """
    A, b, H, g = equations
    T_sensor_first, centres, middle, _ = frames
    Ad = np.empty((6, 6))
    fill_change(T_each[0], T_sensor_first[0], centres[0], middle, Ad)
    parts[:] = 0.0
    add_transformed(Ad, A[0], parts[0])
    add_turned(Ad, b[0], g)
    H += parts[0]
    x, far = solve_step(H, g, damping)
    move_object(T, x, middle)
    multiply_one(T_sensor_first[0], T, T_each[0])
    return far


@njit(fast=True)
def step_to_all(T, T_each, equations, frames, parts, damping):
    """Take one step of the object's pose T (4, 4) and of its poses T_each (N, 4, 4). Return its length, mm.

    Touch i gives the equations A u = b for a twist u of its pose in T_each. Its present error is e. Its new error s
    has the covariance S, and the object's twist is x. Then u = Ad x - e + s. Eliminating s gives the equations for
    Ad x: the matrix (1 + A S)^-1 A and the right side (1 + A S)^-1 (b + A e). The factor of a prior is already in
    the matrix H (6, 6) and the right side g (6, 1).
    """
    A, b, H, g = equations
    T_sensor_first, centres, middle, spread = frames
    count = len(T_each)
    Ad, left, M = np.empty((count, 6, 6)), np.empty((count, 6, 7)), np.empty((6, 6))
    e, s, nominal = np.empty(6), np.empty(6), np.empty((4, 4))
    parts[:] = 0.0
    for i in range(count):
        multiply_one(T_sensor_first[i], T, nominal)
        fill_one_logarithm(T_each[i], nominal, centres[i, 0], centres[i, 1], centres[i, 2], e)
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
        multiply_one(T_sensor_first[i], T, T_each[i])
        move_one(T_each[i], s, centres[i, 0], centres[i, 1], centres[i, 2])
    return far


@njit(fast=True)
def fill_change(seen, T_sensor_first, centre, middle, Ad):
    """Fill Ad (6, 6): from twists about the object's centre to twists about a touch's `centre`, at the pose `seen`."""
    x = centre[0] - seen[0, 0] * middle[0] - seen[0, 1] * middle[1] - seen[0, 2] * middle[2] - seen[0, 3]
    y = centre[1] - seen[1, 0] * middle[0] - seen[1, 1] * middle[1] - seen[1, 2] * middle[2] - seen[1, 3]
    z = centre[2] - seen[2, 0] * middle[0] - seen[2, 1] * middle[1] - seen[2, 2] * middle[2] - seen[2, 3]
    fill_one_adjoint(T_sensor_first, x, y, z, Ad)


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
    move_one(T, x, c0, c1, c2)


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


@njit(fast=True)
def add_transformed(B, A, out):
    """Add B^T A B to `out`; all matrices are (6, 6)."""
    for c in range(6):
        for r in range(6):
            inner = 0.0  # row r of A times column c of B
            for k in range(6):
                inner += A[r, k] * B[k, c]
            for n in range(6):
                out[n, c] += B[r, n] * inner


@njit(fast=True)
def solve(M, X):
    """Replace X (6, C) by the solution Y of M Y = X, by elimination with pivots; M (6, 6) is lost.

    A column of M without a pivot, which means that M is singular, gives zeros.
    """
    size, columns = M.shape[0], X.shape[1]
    for k in range(size):
        pivot = k
        for r in range(k + 1, size):
            if abs(M[r, k]) > abs(M[pivot, k]):
                pivot = r
        if pivot != k:
            for c in range(size):
                M[k, c], M[pivot, c] = M[pivot, c], M[k, c]
            for c in range(columns):
                X[k, c], X[pivot, c] = X[pivot, c], X[k, c]
        if M[k, k] == 0.0:
            continue
        for r in range(k + 1, size):
            factor = M[r, k] / M[k, k]
            for c in range(k + 1, size):
                M[r, c] -= factor * M[k, c]
            for c in range(columns):
                X[r, c] -= factor * X[k, c]
    for c in range(columns):
        for k in range(size - 1, -1, -1):
            rest = X[k, c]
            for n in range(k + 1, size):
                rest -= M[k, n] * X[n, c]
            X[k, c] = rest / M[k, k] if M[k, k] != 0.0 else 0.0
