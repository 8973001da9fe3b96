"""Products and solutions of small matrices, and motions by twists, compiled with numba for single poses.

The functions write to given arrays, because allocation takes longer than the arithmetic. Twists are as in `twists.py`,
whose functions take batches of them.
"""

from __future__ import annotations

import math

from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors

TINY = 1e-30  # added to a squared angle, so that a division by the angle is possible without rotation


@njit(fast=True)
def multiply_transforms(a, b, out):
    """Fill `out` (4, 4) with the product of the transforms a and b (4, 4); `out` must be neither of them."""
    for r in range(3):
        for c in range(4):
            out[r, c] = a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]
        out[r, 3] += a[r, 3]
        out[3, r] = 0.0
    out[3, 3] = 1.0


@njit(fast=True)
def fill_adjoint(R, x, y, z, out):
    """Fill `out` (6, 6) with the matrix of `twists.adjoint` for axes R (4, 4) and the lever x, y, z."""
    for r in range(3):
        for c in range(3):
            out[r, c] = out[3 + r, 3 + c] = R[r, c]
            out[r, 3 + c] = 0.0
    for c in range(3):
        out[3, c] = z * R[1, c] - y * R[2, c]
        out[4, c] = x * R[2, c] - z * R[0, c]
        out[5, c] = y * R[0, c] - x * R[1, c]


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


@njit(fast=True)
def move(T, x, c0, c1, c2):
    """Move the transform T (4, 4) by the twist x (6,) about the centre c0, c1, c2, as `twists.exponential` does."""
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
def fill_difference(T, other, c0, c1, c2, out):
    """Fill `out` (6,) with the twist about a centre from the transform `other` to T, as `twists.logarithm` does."""
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
