"""Patches of places as two arrays that compress well, without loss."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.places.places import FAR, PATCH_PX
from tactile_loc.core.runtime.compiled import njit

# mypy: disable-error-code="no-untyped-def,no-untyped-call"


def split_patches(patches: NDArray[np.uint8]) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Split patches (N, PATCH_PX, PATCH_PX) into two arrays that compress well: see `join_patches`.

    Three of four pixels show no surface. The others differ little from the pixel before.
    """
    seen = (patches != FAR).ravel()
    starts = np.flatnonzero(np.diff(seen, prepend=False))
    runs = np.diff(starts, prepend=0, append=seen.size).astype(np.uint32)
    return runs, np.diff(patches.ravel()[seen], prepend=np.uint8(0))


def join_patches(runs: NDArray[np.uint32], changes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the patches (N, PATCH_PX, PATCH_PX) that `split_patches` split.

    `runs` are the numbers of consecutive pixels without surface and with surface, in turn, beginning with pixels
    without surface. `changes` are the differences, modulo 256, between consecutive pixels with surface.
    """
    pixels = np.empty(int(runs.sum(dtype=np.int64)), np.uint8)
    _fill_pixels(runs, changes, pixels)
    return pixels.reshape(-1, PATCH_PX, PATCH_PX)


@njit
def _fill_pixels(runs, changes, pixels):
    """Fill `pixels` (P,) from `runs` and `changes`."""
    pixel, change, value = 0, 0, 0
    for k in range(len(runs)):
        end = pixel + runs[k]
        if k % 2 == 0:
            pixels[pixel:end] = FAR
        else:
            for i in range(pixel, end):
                value += changes[change]
                pixels[i] = value & 255
                change += 1
        pixel = end
