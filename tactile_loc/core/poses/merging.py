"""The merging of modes that are within a radius of a likelier mode, up to the object's symmetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseMetric


def merge_modes(T_object: Poses, metric: PoseMetric, radius_m: ArrayLike, most: int | None = None) -> NDArray[np.int64]:
    """Return, for each pose (K, 4, 4), metres, the index (K,) of the pose that it merges with.

    The poses are sorted, the likeliest first. A pose merges with the likeliest kept pose that is nearer than
    `radius_m`, metres, which is one number or one for each pose (K,). A pose without such a neighbour is kept, and has
    its own index. At most `most` poses are kept; further poses without a neighbour get -1.
    """
    radii_m, orbits = np.broadcast_to(radius_m, len(T_object)), metric.embed_orbits(np.asarray(T_object))
    merged = np.full(len(T_object), -1)
    kept: list[int] = []
    for k in range(len(T_object)):
        distances_m = np.linalg.norm(orbits[:, kept] - orbits[0, k], axis=-1).min(axis=0)
        near = np.flatnonzero(distances_m < radii_m[k])
        if len(near):
            merged[k] = kept[near[0]]
        elif most is None or len(kept) < most:
            merged[k] = k
            kept.append(k)
    return merged
