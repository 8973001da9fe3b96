"""Polar features of contact shapes: heights on rings around the place, on ramps of several lengths.

A rotation of the contact shifts the features along the angles.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.places.places import PATCH_PX, PITCH_M, cut_patches

Float32 = NDArray[np.float32]

RADII_M = (np.arange(16) + 0.5) * 6.25e-4
ANGLES = 48
RAMPS_M = (1e-4, 2.5e-4, 6e-4, 1.5e-3)  # a height has the value 1 from the end of a ramp


def encode_places(patches: NDArray[np.uint8]) -> Float32:
    """Return the features (N, ANGLES, C) of the patches (N, PATCH_PX, PATCH_PX) of places."""
    sampled = _sample(cut_patches(patches, RAMPS_M[-1]))
    return _stack(_climb(sampled))


def encode_touch(depth_m: Float32, seen: NDArray[np.bool_], press_m: float) -> Float32:
    """Return the features (N, ANGLES, 2 C) of touches' patches (N, PATCH_PX, PATCH_PX), metres.

    The second half of the features states what is known. In contact, the height is known. Beside the contact, it is
    known to be at least the press depth, and a ramp is known if it is shorter than the press.
    """
    numbers, weights = _find_samples()
    press = np.float32(press_m)
    sampled = _sample(np.minimum(depth_m, press))
    nearest = np.take_along_axis(numbers, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    visible = seen.reshape(len(seen), -1)[:, nearest]
    touched = sampled < press * np.float32(1 - 1e-6)
    values = [value * visible for value in _climb(sampled)]
    known = [(visible & (touched | (press >= ramp))).astype(np.float32) for ramp in RAMPS_M]
    return _stack(values + known)


def _sample(images: Float32) -> Float32:
    """Return images (N, PATCH_PX, PATCH_PX) at the polar samples (N, rings * ANGLES)."""
    numbers, weights = _find_samples()
    sampled: Float32 = np.einsum("nsk,sk->ns", images.reshape(len(images), -1)[:, numbers], weights)
    return sampled


def _climb(sampled: Float32) -> list[Float32]:
    """Return heights, metres, on each ramp, 0 to 1."""
    return [np.minimum(sampled / np.float32(ramp), 1) for ramp in RAMPS_M]


def _stack(planes: list[Float32]) -> Float32:
    """Return planes (N, rings * ANGLES) as features (N, ANGLES, planes * rings)."""
    stacked = np.stack(planes, axis=1).reshape(len(planes[0]), len(planes) * len(RADII_M), ANGLES)
    return np.ascontiguousarray(stacked.swapaxes(1, 2))


@cache
def _find_samples() -> tuple[NDArray[np.int64], Float32]:
    """Return the numbers (S, 4) and weights (S, 4) of the pixels between which each polar sample is interpolated."""
    angles = 2 * np.pi * np.arange(ANGLES) / ANGLES
    x, y = (np.outer(RADII_M, f(angles)).ravel() / PITCH_M + PATCH_PX // 2 for f in (np.cos, np.sin))
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    right, below = x - column, y - row
    numbers = np.stack([(row + i) * PATCH_PX + column + j for i in (0, 1) for j in (0, 1)], axis=1)
    weights = np.stack([
        (below if i else 1 - below) * (right if j else 1 - right) for i in (0, 1) for j in (0, 1)
    ], axis=1)  # fmt: skip
    return numbers, weights.astype(np.float32)
