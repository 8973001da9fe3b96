"""Merging of modes: poses that are within a radius of a likelier pose, up to the object's symmetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseMetric


def merge_modes(T_object: Poses, metric: PoseMetric, radius_m: ArrayLike, most: int | None = None) -> NDArray[np.int64]:
    """Return for each of poses (K, 4, 4), the likeliest first, the index (K,) of the pose that it merges with.

    A kept pose has its own index. A pose within its radius, metres, a number or (K,), of kept poses merges with the
    likeliest of them. After `most` kept poses, the others get -1.
    """
    radii_m = np.broadcast_to(radius_m, len(T_object))
    merged = np.full(len(T_object), -1)
    kept: list[int] = []
    for k, T in enumerate(T_object):
        distances_m = metric.symmetric_distance(T_object[kept], np.broadcast_to(T, (len(kept), 4, 4)))
        near = np.flatnonzero(distances_m < radii_m[k])
        if len(near):
            merged[k] = kept[near[0]]
        elif most is None or len(kept) < most:
            merged[k] = k
            kept.append(k)
    return merged
