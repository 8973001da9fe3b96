"""Twists and motions are converted into each other about any centre."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import (
    draw_rotations,
    invert,
    make_transform,
    transform_points,
)
from tactile_loc.core.geometry.twists import adjoint, exponential, logarithm


def test_exponential_and_logarithm_are_inverse():
    rng = np.random.default_rng(1)
    x = np.concatenate([0.2 * rng.normal(size=(10, 6)), 1e-9 * rng.normal(size=(10, 6)), np.zeros((1, 6))])
    centre = rng.normal(size=(len(x), 3))
    motion = exponential(x, centre)
    np.testing.assert_allclose(logarithm(motion, centre), x, atol=1e-12)
    np.testing.assert_allclose(motion[:, :3, :3], Rotation.from_rotvec(x[:, :3]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(transform_points(motion, centre[:, None])[:, 0], centre + x[:, 3:], atol=1e-12)


def test_the_adjoint_gives_the_same_motion_in_another_frame():
    rng = np.random.default_rng(2)
    T = make_transform(draw_rotations(1, rng)[0], rng.normal(size=3))
    here, there, x = rng.normal(size=3), rng.normal(size=3), 1e-6 * rng.normal(size=6)
    Ad = adjoint(T[:3, :3], there - transform_points(T, here)[0])
    np.testing.assert_allclose(T @ exponential(x, here) @ invert(T), exponential(Ad @ x, there), atol=1e-11)
