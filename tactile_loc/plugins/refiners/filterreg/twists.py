"""Twists that solve normal equations, and their rigid motions. A twist (6,) is a rotation (rad) and a shift (mm)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import cross_matrix

Floats = NDArray[np.float64]

RIDGE = 1e-3  # of the equations' mean diagonal: damps directions that a contact hardly determines
SMALL = 1e-3  # rad: angles below use the series, whose next terms are below rounding


def solve(equations: Floats) -> tuple[Floats, Floats]:
    """Return the twists (K, 6) that solve normal equations (K, 6, 7), and the RMS moves (K,), mm.

    Both are NaN for a candidate without points.
    """
    diagonal = np.diagonal(equations[:, :, :6], axis1=1, axis2=2)
    turning, sliding = diagonal[:, :3].sum(axis=1), diagonal[:, 3:].sum(axis=1)
    known = (sliding > 0) & (turning >= 0) & np.isfinite(turning + sliding)
    turning, sliding = turning[known], sliding[known]
    unit = np.ones((len(turning), 6))  # radians per mm
    unit[:, :3] = np.sqrt(np.divide(sliding, turning, out=np.ones_like(sliding), where=turning > 0))[:, None]
    stiff = equations[known, :, :6] * unit[:, :, None] * unit[:, None]
    ridge = RIDGE * np.trace(stiff, axis1=1, axis2=2) / 6
    wanted = (equations[known, :, 6] * unit)[..., None]
    scaled = np.linalg.solve(stiff + ridge[:, None, None] * np.eye(6), wanted)[..., 0]
    twists, moved_mm = np.full((len(equations), 6), np.nan), np.full(len(equations), np.nan)
    twists[known], moved_mm[known] = scaled * unit, np.sqrt((scaled**2).sum(axis=1))
    return twists, moved_mm


def exponential(twists: Floats) -> Floats:
    """Return the rigid motions (K, 4, 4), translation in mm, of twists (K, 6)."""
    x, y, z = twists[:, :3].T
    angle = np.sqrt(x * x + y * y + z * z)
    small, squared_angle = angle < SMALL, angle**2
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = np.where(small, 1 - squared_angle / 6, np.sin(angle) / angle)
        versine = np.where(small, 0.5 - squared_angle / 24, (1 - np.cos(angle)) / squared_angle)
        rest = np.where(small, 1 / 6 - squared_angle / 120, (angle - np.sin(angle)) / angle**3)
    W = cross_matrix(twists[:, :3])
    squared, one = W @ W, np.eye(3)
    sine, versine, rest = (factor[:, None, None] for factor in (sine, versine, rest))
    motions = np.tile(np.eye(4), (len(twists), 1, 1))
    motions[:, :3, :3] = one + sine * W + versine * squared
    motions[:, :3, 3] = ((one + versine * W + rest * squared) @ twists[:, 3:, None])[..., 0]
    return motions


def turn_about(T: Floats, centres: Floats, twists: Floats) -> Floats:
    """Return the poses (K, 4, 4), translation in mm, after twists (K, 6) about centres (K, 3), mm."""
    motions = exponential(twists)
    motions[:, :3, 3] += centres - (motions[:, :3, :3] @ centres[..., None])[..., 0]
    result: Floats = motions @ T
    return result
