"""The merging of modes, and non-maximum suppression: what lies within a radius of a likelier pose is not kept."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import numpy as np
from numpy.typing import ArrayLike

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.runtime.compiled import njit


def merge_modes(
    T_object: Poses,
    metric: PoseMetric,
    radius_m: ArrayLike,
    most: int | None = None,
    tolerance: Tolerance | None = None,
) -> Ints:
    """Return, for each pose (K, 4, 4), metres, the index (K,) of the pose that it merges with.

    The poses are sorted, the likeliest first. A pose merges with the likeliest kept pose that is nearer than
    `radius_m`, metres, which is one number or one for each pose (K,). A pose without such a neighbour is kept, and has
    its own index. At most `most` poses are kept; further poses without a neighbour get -1. With a `tolerance`, poses
    that are not within it of each other do not merge.
    """
    radii_m, orbits = np.broadcast_to(radius_m, len(T_object)), metric.embed_orbits(np.asarray(T_object))
    merged = np.full(len(T_object), -1)
    kept: list[int] = []
    for k in range(len(T_object)):
        distances_m = np.linalg.norm(orbits[:, kept] - orbits[0, k], axis=-1).min(axis=0)
        near = np.flatnonzero(distances_m < radii_m[k])
        if len(near) and tolerance is not None:
            near = near[tolerance.find_within(metric.object, T_object[k], T_object[np.array(kept)[near]])]
        if len(near):
            merged[k] = kept[near[0]]
        elif most is None or len(kept) < most:
            merged[k] = k
            kept.append(k)
    return merged


@njit(fast=True)
def choose_apart(points, radius, count):
    """Return the indices of at most `count` points (K, D): each is farther than `radius` from all chosen before it."""
    chosen, found = np.empty(min(count, len(points)), np.int64), 0
    least = radius * radius
    for k in range(len(points)):
        if found == len(chosen):
            break
        free = True
        for n in range(found - 1, -1, -1):  # the last chosen points are often the nearest
            other, squared = chosen[n], 0.0
            for d in range(points.shape[1]):
                squared += (points[k, d] - points[other, d]) ** 2
            if squared <= least:
                free = False
                break
        if free:
            chosen[found] = k
            found += 1
    return chosen[:found]


def suppress_non_maxima(poses: Poses, worth: Floats, metric: PoseMetric, radius_m: float, count: int) -> Ints:
    """Return the indices of at most `count` poses (K, 4, 4), sorted by their `worth` (K,), the greatest first.

    No chosen pose is within `radius_m` metres of a pose with greater worth. Symmetries do not count.
    """
    order = np.argsort(-worth, kind="stable")
    points = np.ascontiguousarray(metric.embed(poses[order]))
    return np.asarray(order[choose_apart(points, float(radius_m), count)])
