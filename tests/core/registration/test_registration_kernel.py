"""Small equations are solved, also if they are singular."""

import numpy as np
import pytest

from tactile_loc.core.registration.registration_kernel import add_transformed, solve


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


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
