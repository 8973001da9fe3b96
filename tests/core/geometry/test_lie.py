"""Twists, motions and pose errors are converted into each other; the compiled functions agree with those of batches."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.lie import adjoint, exponential, fill_one_logarithm, logarithm, move_one
from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, transform_points


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def draw_pose(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(make_transform(draw_rotations(1, rng)[0], rng.normal(size=3)))


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


@pytest.mark.parametrize("size", [0.3, 1e-9, 0.0])
def test_a_motion_by_a_twist_equals_that_of_the_batches(rng, size):
    T, x, centre = draw_pose(rng), size * rng.normal(size=6), rng.normal(size=3)
    moved = T.copy()
    move_one(moved, x, *centre)
    np.testing.assert_allclose(moved, exponential(x, centre) @ T, atol=1e-14)


@pytest.mark.parametrize("size", [0.3, 1e-9, 0.0])
def test_the_twist_between_two_poses_equals_that_of_the_batches(rng, size):
    other, x, centre, out = draw_pose(rng), size * rng.normal(size=6), rng.normal(size=3), np.empty(6)
    T = exponential(x, centre) @ other
    fill_one_logarithm(T, other, *centre, out)
    np.testing.assert_allclose(out, x, atol=1e-12)
    np.testing.assert_allclose(out, logarithm(T @ invert(other), centre), atol=1e-12)
