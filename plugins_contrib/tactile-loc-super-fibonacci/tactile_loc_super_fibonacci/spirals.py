"""Any number of evenly spread rotations and directions, along spirals.

Rotations follow M. Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3)", CVPR 2022. Directions are
the Fibonacci lattice of the sphere, which uses the same idea in one dimension less.
"""

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin.helpers import align_to_z, quaternion_to_rotation

Float = NDArray[np.float64]

PHI = float(np.sqrt(2.0))
PSI = 1.533751168755204288118041
"""The positive root of x^4 = x + 4. The paper chooses this value and `PHI`."""
GOLDEN = float((1 + np.sqrt(5.0)) / 2)


def super_fibonacci_quaternions(count: int) -> Float:
    """Return unit quaternions (count, 4), scalar last, with algorithm 1 of the paper.

    The quaternions cover the sphere S^3, and all are different rotations. Raises ValueError if count is below 1.
    """
    s, share = _steps(count)
    inner, outer = np.sqrt(share), np.sqrt(1 - share)
    alpha, beta = 2 * np.pi * (s / PHI % 1.0), 2 * np.pi * (s / PSI % 1.0)
    return np.stack([inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)], axis=-1)


def super_fibonacci_rotations(count: int) -> Float:
    """Return evenly spread rotations (count, 3, 3). Raises ValueError if count is below 1."""
    return quaternion_to_rotation(np.roll(super_fibonacci_quaternions(count), 1, axis=-1))


def fibonacci_directions(count: int) -> Float:
    """Return unit vectors (count, 3), spread evenly over the sphere. Raises ValueError if count is below 1."""
    s, share = _steps(count)
    z = 1 - 2 * share
    radius, azimuth = np.sqrt(1 - z**2), 2 * np.pi * (s / GOLDEN % 1.0)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)


def rotations_of_axis(axis: Float, directions: Float) -> Float:
    """Return rotations (N, 3, 3) that rotate the unit vector `axis` (3,) to unit vectors `directions` (N, 3)."""
    z = directions[:, 2]
    cosine, sine = np.sqrt(np.clip((1 + z) / 2, 0, 1)), np.sqrt(np.clip((1 - z) / 2, 0, 1))
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    q = np.stack([cosine, -sine * np.sin(azimuth), sine * np.cos(azimuth), np.zeros_like(z)], axis=-1)
    return quaternion_to_rotation(q) @ align_to_z(axis)


def _steps(count: int) -> tuple[Float, Float]:
    """Return the steps s (count,) along a spiral, and each step's share of the spiral's length, between 0 and 1."""
    if count < 1:
        raise ValueError(f"there must be at least one point on a spiral, not {count}")
    s = np.arange(count, dtype=np.float64) + 0.5
    return s, s / count
