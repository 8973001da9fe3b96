"""Twists in batches, (..., 6): a rotation vector (rad), then a translation, about a given centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import axis_times_sine, cross_matrix, make_transform

TINY = 1e-30  # added to a squared angle, so that a division by the angle is possible without rotation
Floats = NDArray[np.float64]


def exponential(x: Floats, centre: Floats) -> Floats:
    """Return the motions (..., 4, 4) that rotate by x[..., :3] about centres (..., 3), then shift by x[..., 3:]."""
    turn = x[..., :3]
    half = 0.5 * np.sqrt((turn * turn).sum(axis=-1) + TINY)[..., None, None]
    K = cross_matrix(turn)
    sinc = np.sin(half) / half
    R = np.eye(3) + sinc * np.cos(half) * K + 0.5 * sinc * sinc * (K @ K)
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
