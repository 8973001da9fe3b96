from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.places.patch_averages import average_patches


def draw(cells: int, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """Return random weights (cells, pixels) of pixels that are in one cell or in two neighbours."""
    weights = np.zeros((cells, pixels), np.float32)
    for pixel in range(pixels):
        first = int(rng.integers(cells))
        weights[first : first + int(rng.integers(1, 3)), pixel] = rng.uniform(0.1, 1)
    return weights


@pytest.mark.parametrize(("down", "across"), [(1, 1), (1, 5), (3, 2), (6, 9)])
@pytest.mark.parametrize("shape", [(9, 9), (4, 11)])
def test_sums_are_matrix_products(down, across, shape):
    rng = np.random.default_rng(3)
    patches = rng.integers(0, 256, (7, *shape)).astype(np.uint8)
    rows, columns = draw(down, shape[0], rng), draw(across, shape[1], rng)
    for end in (0, 1, 90, 256):
        signal = np.where(np.arange(256) < end, rng.normal(size=256), 0).astype(np.float32)
        found = average_patches(patches, signal, rows, columns)
        assert found == pytest.approx(rows @ signal[patches] @ columns.T, abs=1e-4)


def test_no_patch_has_no_sum():
    weights = np.ones((1, 5), np.float32)
    assert average_patches(np.empty((0, 5, 5), np.uint8), np.ones(256, np.float32), weights, weights).shape == (0, 1, 1)


@pytest.mark.parametrize("cells", [[0, 1, 2], [0, 2]])
def test_a_pixel_in_too_many_cells_is_refused(cells):
    weights = np.zeros((3, 4), np.float32)
    weights[cells, 1] = 1
    patches, signal = np.zeros((1, 4, 4), np.uint8), np.ones(256, np.float32)
    for rows, columns in ((weights, np.ones((1, 4), np.float32)), (np.ones((1, 4), np.float32), weights)):
        with pytest.raises(ValueError, match="cells"):
            average_patches(patches, signal, rows, columns)
