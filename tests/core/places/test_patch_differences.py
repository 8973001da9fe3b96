"""Patches are found again from their differences."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.places.patch_differences import differentiate, integrate


@pytest.mark.parametrize("shape", [(5, 7, 7), (1, 1, 1), (0, 7, 7)])
def test_patches_are_found_again_from_their_differences(shape):
    patches = np.random.default_rng(2).integers(0, 256, shape).astype(np.uint8)
    differences = differentiate(patches)
    assert np.array_equal(integrate(differences), patches)
    assert np.array_equal(np.cumsum(np.cumsum(differences, 1, np.uint8), 2, np.uint8), patches)
