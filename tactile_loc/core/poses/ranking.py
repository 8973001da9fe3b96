"""Orders that the rounding of a processor cannot change: values that differ too little to mean anything are ties."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseMetric

TIE_NATS = 3e-4  # the rounding of another processor changes log-probabilities of poses by less
GENERIC = np.array([0.71, 1.13, -0.37, 0.93, -1.31, 0.53, -0.83, 0.61, 1.07, 1.49, -1.19, 0.79])  # no pair is alike


def group_ties(worth: NDArray[np.float64], tie: float) -> NDArray[np.int64]:
    """Return the number (K,) of each value's group: 0 for the greatest of `worth` (K,) and those within `tie` of it.

    Each further group has the greatest of the other values and those within `tie` of this value.
    """
    order = np.argsort(-worth, kind="stable")
    groups, leader, number = np.empty(len(worth), np.int64), np.inf, -1
    for k in order:
        if not worth[k] >= leader - tie:
            leader, number = worth[k], number + 1
        groups[k] = max(number, 0)
    return groups


def rank_poses(groups: NDArray[np.int64], T_object: Poses, metric: PoseMetric) -> NDArray[np.int64]:
    """Return the order (K,) of poses (K, 4, 4), metres, by their `groups` (K,) of ties, and in a group by place."""
    return np.lexsort((metric.embed(T_object) @ GENERIC, groups))
