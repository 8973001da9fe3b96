"""The choice of points that are far apart, compiled with numba."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors


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
