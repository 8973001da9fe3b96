"""The sums over pixels that compare imprints, compiled with numba."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors


@njit(fast=True)
def add_imprints(first, last, made, seen, press, observed, outline, far, sums):
    """Fill `sums` (N, 5) for the contact depths `made` (N, H, W) from first to last, and those of a touch (H, W).

    The sums are the number of pixels in contact in both, and in one of them; the smaller of both imprints, and the
    larger, each as a share of the press depth plus `outline`; and the difference of depths in common contact, metres,
    at most `far` each.
    """
    zero, top = np.float32(0), np.float32(1) + outline
    scale = np.float32(1) / press
    for k in range(first, last):
        common, either, least, most, off = 0, 0, 0.0, 0.0, 0.0
        for row in range(seen.shape[0]):
            lower, upper, beside = zero, zero, zero
            for column in range(seen.shape[1]):
                if not observed[row, column]:
                    continue
                mine, other = made[k, row, column], seen[row, column]
                touches, touched = mine < press, other < press
                a = top - mine * scale if touches else zero
                b = top - other * scale if touched else zero
                lower += min(a, b)
                upper += max(a, b)
                either += touches or touched
                if touches and touched:
                    common += 1
                    beside += min(abs(mine - other), far)
            least, most, off = least + lower, most + upper, off + beside
        sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3], sums[k, 4] = common, either, least, most, off
