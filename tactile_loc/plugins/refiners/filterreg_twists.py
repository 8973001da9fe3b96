"""The M step of FilterReg, compiled (numba): the twist that solves normal equations, and the motion it stands for.

A twist (6,) is a rotation (rad) before a translation (mm).
"""

# mypy: ignore-errors

from __future__ import annotations

import math

import numpy as np

from tactile_loc.plugin import njit

RIDGE = 1e-3  # of the equations' mean diagonal: damps steps in directions that a contact hardly fixes
SMALL = 1e-3  # rad: below, the series' next terms are lost in rounding


@njit(cache=True, error_model="numpy")
def solved(equations):
    """Return the twists (K, 6) that solve normal equations (K, 6, 7), and the root mean square (K,), mm, of the moves.

    Both are NaN where there are no points.
    """
    twists, moved_mm = np.full((len(equations), 6), np.nan), np.full(len(equations), np.nan)
    for k in range(len(equations)):
        A, b = equations[k, :, :6], equations[k, :, 6]
        turning, sliding = A[0, 0] + A[1, 1] + A[2, 2], A[3, 3] + A[4, 4] + A[5, 5]
        if not (sliding > 0 and turning >= 0 and np.isfinite(turning + sliding)):
            continue
        unit = np.ones(6)
        unit[:3] = math.sqrt(sliding / turning) if turning > 0 else 1.0  # radians a mm
        stiff = A * unit.reshape(6, 1) * unit
        ridge = RIDGE * np.trace(stiff) / 6.0
        for a in range(6):
            stiff[a, a] += ridge
        scaled = np.linalg.solve(stiff, b * unit)
        twists[k], moved_mm[k] = scaled * unit, math.sqrt((scaled * scaled).sum())
    return twists, moved_mm


@njit(cache=True, error_model="numpy")
def exponential(twists):
    """Return the rigid motions (K, 4, 4), translation in mm, of twists (K, 6)."""
    motions = np.zeros((len(twists), 4, 4))
    for k in range(len(twists)):
        x, y, z = twists[k, 0], twists[k, 1], twists[k, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        if angle < SMALL:
            sine, versine, rest = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
        else:
            sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
            rest = (angle - math.sin(angle)) / angle**3
        W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        squared = W @ W
        motions[k, :3, :3] = np.eye(3) + sine * W + versine * squared
        motions[k, :3, 3] = (np.eye(3) + versine * W + rest * squared) @ np.ascontiguousarray(twists[k, 3:])
        motions[k, 3, 3] = 1.0
    return motions


@njit(cache=True, error_model="numpy")
def turned_about(T, centres, twists):
    """Return the poses (K, 4, 4), translation in mm, after twists (K, 6) about centres (K, 3), mm."""
    motions, result = exponential(twists), np.empty_like(T)
    for k in range(len(T)):
        motion = motions[k]
        motion[:3, 3] += centres[k] - np.ascontiguousarray(motion[:3, :3]) @ centres[k]
        result[k] = motion @ T[k]
    return result
