from __future__ import annotations

import numpy as np

from tactile_loc.core.places.packed_patches import join_patches, split_patches
from tactile_loc.core.places.places import BELOW, FAR, PATCH_PX


def test_any_patches_are_the_same_after_splitting_and_joining():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, FAR + 1, (3, PATCH_PX, PATCH_PX), np.uint8)
    for patches in (noise, np.where(rng.random(noise.shape) < 0.8, FAR, noise), 0 * noise, 0 * noise + FAR, noise[:0]):
        for some in (patches, patches[:, ::-1]):
            joined = join_patches(*split_patches(some))
            assert joined.dtype == np.uint8
            assert np.array_equal(joined, some)


def test_a_patch_is_split_into_runs_and_changes():
    patch = np.full((1, PATCH_PX, PATCH_PX), FAR, np.uint8)
    patch[0, 0, 2:5] = BELOW, BELOW + 7, BELOW + 4
    runs, changes = split_patches(patch)
    assert runs.tolist() == [2, 3, PATCH_PX**2 - 5]
    assert changes.tolist() == [BELOW, 7, 256 - 3]
