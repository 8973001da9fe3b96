"""Blocks hold neighbours: every item once, in blocks that are small and inside their spheres."""

import numpy as np
import pytest

from tactile_loc.core.objects.blocks import make_blocks


@pytest.mark.parametrize(("count", "corners", "most"), [(1, 1, 4), (4, 3, 4), (5, 3, 4), (333, 1, 16), (333, 3, 1)])
def test_blocks_hold_each_item_once_and_bound_it(count, corners, most):
    items = np.random.default_rng(count).normal(size=(count, corners, 3))
    blocks = make_blocks(items, most)
    sizes = np.diff(blocks.starts)
    assert sorted(blocks.corners.tolist()) == sorted(items.tolist())
    assert most / 2 <= sizes.max() <= most or count < most
    assert sizes.min() > 0
    of = np.repeat(np.arange(len(sizes)), sizes)
    assert (np.linalg.norm(blocks.corners - blocks.centres[of][:, None], axis=2) <= blocks.radii[of][:, None]).all()


def test_a_block_is_split_along_its_longest_side():
    items = np.array([[0.0, 0, 0], [9, 1, 0], [3, 0, 1], [6, 1, 1]])[:, None]
    blocks = make_blocks(items, 2)
    assert np.array_equal(blocks.corners, items[[0, 2, 3, 1]])
    assert blocks.starts.tolist() == [0, 2, 4]
