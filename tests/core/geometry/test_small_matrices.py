"""Compiled functions for one pose agree with numpy, and with the twists in batches."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform
from tactile_loc.core.geometry.small_matrices import (
    add_transformed,
    fill_adjoint,
    fill_difference,
    move,
    multiply_transforms,
    solve,
)
from tactile_loc.core.geometry.twists import adjoint, exponential, logarithm


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def draw_pose(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(make_transform(draw_rotations(1, rng)[0], rng.normal(size=3)))


def test_a_product_of_transforms_equals_that_of_numpy(rng):
    a, b, out = draw_pose(rng), draw_pose(rng), np.empty((4, 4))
    multiply_transforms(a, b, out)
    np.testing.assert_allclose(out, a @ b, atol=1e-14)


def test_the_adjoint_equals_that_of_the_batches(rng):
    T, lever, out = draw_pose(rng), rng.normal(size=3), np.empty((6, 6))
    fill_adjoint(T, *lever, out)
    np.testing.assert_allclose(out, adjoint(T[:3, :3], lever), atol=1e-14)


def test_a_transformed_matrix_is_added(rng):
    B, A, out = rng.normal(size=(6, 6)), rng.normal(size=(6, 7)), np.ones((6, 6))
    add_transformed(B, A, out)
    np.testing.assert_allclose(out, 1 + B.T @ A[:, :6] @ B, atol=1e-12)


@pytest.mark.parametrize("columns", [1, 7])
def test_equations_are_solved_also_if_a_pivot_is_zero(rng, columns):
    M, X = rng.normal(size=(6, 6)), rng.normal(size=(6, columns))
    M[0, 0] = 0.0
    expected = np.linalg.solve(M, X)
    solve(M.copy(), X)
    np.testing.assert_allclose(X, expected, atol=1e-11)


def test_a_singular_matrix_gives_zeros_and_no_infinity():
    X = np.array([[1.0], [2.0], [3.0], [0.0], [0.0], [0.0]])
    solve(np.diag([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), X)
    assert X.ravel().tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("size", [0.3, 1e-9, 0.0])
def test_a_motion_by_a_twist_equals_that_of_the_batches(rng, size):
    T, x, centre = draw_pose(rng), size * rng.normal(size=6), rng.normal(size=3)
    moved = T.copy()
    move(moved, x, *centre)
    np.testing.assert_allclose(moved, exponential(x, centre) @ T, atol=1e-14)


@pytest.mark.parametrize("size", [0.3, 1e-9, 0.0])
def test_the_twist_between_two_poses_equals_that_of_the_batches(rng, size):
    other, x, centre, out = draw_pose(rng), size * rng.normal(size=6), rng.normal(size=3), np.empty(6)
    T = exponential(x, centre) @ other
    fill_difference(T, other, *centre, out)
    np.testing.assert_allclose(out, x, atol=1e-12)
    np.testing.assert_allclose(out, logarithm(T @ invert(other), centre), atol=1e-12)
