"""Random poses."""

import numpy as np

from tactile_loc.core.geometry.rigid import Poses, draw_rotations, make_transform


def random_poses(count: int, seed: int, spread_m: float = 0.01) -> Poses:
    """Return poses (N, 4, 4) of any rotation, with translations of this standard deviation along each axis."""
    rng = np.random.default_rng(seed)
    return make_transform(draw_rotations(count, rng), rng.normal(scale=spread_m, size=(count, 3)))
