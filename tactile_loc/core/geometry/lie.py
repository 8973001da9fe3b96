"""Motions of poses: twists, their exponential, logarithm and adjoint, and the errors and covariances of poses.

A twist (..., 6) is a rotation vector (rad), then a translation, about a given centre. The error of a pose (..., 6) is
x, y, z (m), then a rotation vector (rad), about the origin of the object frame, along the axes of the pose's frame.

The functions of batches use numpy. Those with "one" in their names are the same formulas for one pose, compiled. They
write to given arrays, because allocation takes longer than the arithmetic.
"""

import math

import numpy as np

from tactile_loc.core.geometry.rigid import (
    Floats,
    Poses,
    axis_times_sine,
    cross_matrix,
    make_transform,
    rotation_to_vector,
    vector_to_rotation,
)
from tactile_loc.core.runtime.compiled import njit

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

TINY = 1e-30  # added to a squared angle, so that a division by the angle is possible without rotation


def exponential(x: Floats, centre: Floats) -> Floats:
    """Return the motions (..., 4, 4) that rotate by x[..., :3] about centres (..., 3), then shift by x[..., 3:]."""
    R = vector_to_rotation(x[..., :3])
    return make_transform(R, centre + x[..., 3:] - (R @ centre[..., None])[..., 0])


def logarithm(T: Floats, centre: Floats) -> Floats:
    """Return the twists (..., 6) of motions T (..., 4, 4) about centres (..., 3), for rotations below a right angle."""
    R = T[..., :3, :3]
    skew = axis_times_sine(R)
    sine = np.minimum(1.0, np.sqrt((skew * skew).sum(axis=-1, keepdims=True)))
    turn = skew * np.where(sine > 1e-9, np.arcsin(sine) / np.maximum(sine, 1e-9), 1.0)
    return np.concatenate([turn, T[..., :3, 3] - centre + (R @ centre[..., None])[..., 0]], axis=-1)


def adjoint(R: Floats, lever: Floats) -> Floats:
    """Return matrices (..., 6, 6) that convert twists about one centre to twists about another, in other axes.

    R (..., 3, 3) rotates into the other axes. In these axes, `lever` (..., 3) leads from the first centre to the other.
    """
    moved = np.zeros((*np.broadcast_shapes(R.shape[:-2], lever.shape[:-1]), 6, 6))
    moved[..., :3, :3] = moved[..., 3:, 3:] = R
    moved[..., 3:, :3] = -cross_matrix(lever) @ R  # a rotation shifts the other centre: w x lever
    return moved


def compute_pose_errors(T: Poses, T_measured: Poses) -> Floats:
    """Return the errors (..., 6) of poses T against measured poses, ordered as in `RefinedPose.covariance`."""
    rotation = rotation_to_vector(T[..., :3, :3] @ np.swapaxes(T_measured[..., :3, :3], -1, -2))
    return np.concatenate([T[..., :3, 3] - T_measured[..., :3, 3], rotation], axis=-1)


def move(T: Poses, errors: Floats) -> Poses:
    """Return poses (..., 4, 4), metres, that differ from T by `errors` (..., 6), as `compute_pose_errors` returns."""
    R = vector_to_rotation(errors[..., 3:]) @ T[..., :3, :3]
    return make_transform(R, T[..., :3, 3] + errors[..., :3])


def move_covariance(covariance: Floats, shift_m: Floats) -> Floats:
    """Move a pose's covariances (..., 6, 6), m, then rad, to reference points at `shift_m` (..., 3), metres."""
    moved = np.broadcast_to(np.eye(6), (*shift_m.shape[:-1], 6, 6)).copy()
    moved[..., :3, 3:] = -cross_matrix(shift_m)  # w x shift
    return np.asarray(moved @ covariance @ np.swapaxes(moved, -1, -2))


def rotate_covariance(covariance: Floats, R: Floats) -> Floats:
    """Return a pose's covariance (6, 6), m, then rad, along other axes. R (3, 3) maps vectors to the other axes."""
    both = np.kron(np.eye(2), R)
    return np.asarray(both @ covariance @ both.T)


@njit(fast=True)
def multiply_one(a, b, out):
    """Fill `out` (4, 4) with the product of the transforms a and b (4, 4); `out` must be neither of them."""
    for r in range(3):
        for c in range(4):
            out[r, c] = a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]
        out[r, 3] += a[r, 3]
        out[3, r] = 0.0
    out[3, 3] = 1.0


@njit(fast=True)
def fill_one_adjoint(R, x, y, z, out):
    """Fill `out` (6, 6) with the matrix of `adjoint` for axes R (4, 4) and the lever x, y, z."""
    for r in range(3):
        for c in range(3):
            out[r, c] = out[3 + r, 3 + c] = R[r, c]
            out[r, 3 + c] = 0.0
    for c in range(3):
        out[3, c] = z * R[1, c] - y * R[2, c]
        out[4, c] = x * R[2, c] - z * R[0, c]
        out[5, c] = y * R[0, c] - x * R[1, c]


@njit(fast=True)
def move_one(T, x, c0, c1, c2):
    """Move the transform T (4, 4) by the twist x (6,) about the centre c0, c1, c2, as `exponential` does."""
    a, b, c = x[0], x[1], x[2]
    half = 0.5 * math.sqrt(a * a + b * b + c * c + TINY)
    sinc = math.sin(half) / half
    p, q = sinc * math.cos(half), 0.5 * sinc * sinc
    R00, R11, R22 = 1.0 - q * (b * b + c * c), 1.0 - q * (a * a + c * c), 1.0 - q * (a * a + b * b)
    R01, R10 = q * a * b - p * c, q * a * b + p * c
    R02, R20 = q * a * c + p * b, q * a * c - p * b
    R12, R21 = q * b * c - p * a, q * b * c + p * a
    for n in range(3):
        t0, t1, t2 = T[0, n], T[1, n], T[2, n]
        T[0, n] = R00 * t0 + R01 * t1 + R02 * t2
        T[1, n] = R10 * t0 + R11 * t1 + R12 * t2
        T[2, n] = R20 * t0 + R21 * t1 + R22 * t2
    t0, t1, t2 = T[0, 3] - c0, T[1, 3] - c1, T[2, 3] - c2
    T[0, 3] = R00 * t0 + R01 * t1 + R02 * t2 + c0 + x[3]
    T[1, 3] = R10 * t0 + R11 * t1 + R12 * t2 + c1 + x[4]
    T[2, 3] = R20 * t0 + R21 * t1 + R22 * t2 + c2 + x[5]


@njit(fast=True)
def fill_one_logarithm(T, other, c0, c1, c2, out):
    """Fill `out` (6,) with the twist about a centre from the transform `other` to T, as `logarithm` does."""
    # the rotation between them, R = T other^T, of which only the trace and the skew part are needed
    skew0 = skew1 = skew2 = 0.0
    for k in range(3):
        skew0 += T[2, k] * other[1, k] - T[1, k] * other[2, k]
        skew1 += T[0, k] * other[2, k] - T[2, k] * other[0, k]
        skew2 += T[1, k] * other[0, k] - T[0, k] * other[1, k]
    skew0, skew1, skew2 = 0.5 * skew0, 0.5 * skew1, 0.5 * skew2
    sine = min(1.0, math.sqrt(skew0 * skew0 + skew1 * skew1 + skew2 * skew2))
    longer = math.asin(sine) / sine if sine > 1e-9 else 1.0
    out[0], out[1], out[2] = longer * skew0, longer * skew1, longer * skew2
    # the centre as a point of the object at `other`, moved to T
    q0, q1, q2 = c0 - other[0, 3], c1 - other[1, 3], c2 - other[2, 3]
    x = other[0, 0] * q0 + other[1, 0] * q1 + other[2, 0] * q2
    y = other[0, 1] * q0 + other[1, 1] * q1 + other[2, 1] * q2
    z = other[0, 2] * q0 + other[1, 2] * q1 + other[2, 2] * q2
    out[3] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3] - c0
    out[4] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3] - c1
    out[5] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3] - c2
