"""Similarities are sums of whole numbers, and those of parts are the greatest ones of their places."""

import numpy as np
import pytest

from tactile_loc_library.similarity import AT_ONCE, NO_PLACE, compare_vectors, find_most_similar, integrate


@pytest.fixture
def vectors() -> np.ndarray:
    return np.random.default_rng(1).integers(-127, 128, (3 * AT_ONCE, 128)).astype(np.int8)


def test_similarities_are_exact_sums(vectors):
    touches = np.array([np.full(128, 32767), np.arange(128) - 64], np.int16)
    vectors[0] = 127
    exact = touches.astype(int) @ vectors.T.astype(int)
    assert np.array_equal(compare_vectors(vectors, touches), exact)


def test_each_part_has_its_most_similar_place(vectors):
    touches = np.random.default_rng(2).integers(-9000, 9000, (3, 128)).astype(np.int16)
    first, places = np.array([5, 0, 70, 100]), np.array([60, 5, 2 * AT_ONCE - 6, 0])
    found, every = find_most_similar(vectors, touches, first, places), compare_vectors(vectors, touches)
    for k in range(3):
        assert np.array_equal(found[:, k], every[:, first[k] : first[k] + places[k]].max(axis=1))
    assert (found[:, 3] == NO_PLACE).all()
    assert find_most_similar(vectors, touches, first[:0], places[:0]).shape == (3, 0)


@pytest.mark.parametrize("shape", [(5, 7, 7), (1, 1, 1), (0, 7, 7)])
def test_patches_are_found_again_from_their_differences(shape):
    differences = np.random.default_rng(2).integers(0, 256, shape).astype(np.uint8)
    assert np.array_equal(integrate(differences), np.cumsum(np.cumsum(differences, 1, np.uint8), 2, np.uint8))
