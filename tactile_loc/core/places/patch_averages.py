"""Averages of signals over the cells of places' patches, compiled with numba."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.compiled import njit, run_in_threads

Float32 = NDArray[np.float32]


def average_patches(patches: NDArray[np.uint8], signal: Float32, rows: Float32, columns: Float32) -> Float32:
    """Return weighted sums of a signal over cells of patches: an array (N, R, C), in the unit of the signal.

    A pixel of the patches (N, H, W) with the value v has the signal (256,) of v. The sums of a patch are `rows` (R, H)
    @ signals (H, W) @ `columns` (C, W) transposed. A pixel may have a weight in at most two cells, one after the other.
    High values without signal are skipped, so this is fast if most pixels have them. Raises ValueError if a pixel is
    in more cells.
    """
    of_row, of_column = _split_weights(rows), _split_weights(columns)
    sums = np.empty((len(patches), len(rows), len(columns)), np.float32)
    end = int(np.flatnonzero(signal).max(initial=-1)) + 1
    run_in_threads(_fill_sums, len(patches), np.ascontiguousarray(patches), end, signal, *of_row, *of_column, sums)
    return sums


def _split_weights(weights: Float32) -> tuple[NDArray[np.int64], Float32, Float32]:
    """Return the first cell of each pixel (P,), and its weights (P,) in this and the next cell, from (cells, P)."""
    cells, pixels = weights.shape
    firsts = np.minimum((weights != 0).argmax(axis=0), max(0, cells - 2))
    here = weights[firsts, np.arange(pixels)]
    after = weights[firsts + 1, np.arange(pixels)] if cells > 1 else np.zeros_like(here)
    if np.count_nonzero(weights) > np.count_nonzero(here) + np.count_nonzero(after):
        raise ValueError("a pixel is in more than two cells, or in two that are apart; average over fewer cells")
    return firsts.astype(np.int64), here, after


@njit(fast=True)
def _fill_sums(first, last, patches, end, signal, row, row_here, row_after, column, here, after, sums):
    """Fill `sums` (N, R, C) for the patches (N, H, W) from first to last: see `average_patches`.

    Values from `end` have no signal. `row` (H,), `row_here` (H,) and `row_after` (H,) are the first cell of each pixel
    row, and its weights in this and the next cell. `column`, `here` and `after` (W,) are the same for pixel columns.
    """
    height, width = patches.shape[1], patches.shape[2]
    line, cells = np.empty(sums.shape[2], np.float32), np.empty(sums.shape[1:], np.float32)
    for n in range(first, last):
        cells[:] = np.float32(0)
        for r in range(height):
            least = np.uint8(255)
            for c in range(width):
                least = min(least, patches[n, r, c])
            if least >= end:
                continue
            line[:] = np.float32(0)
            for c in range(width):
                value = patches[n, r, c]
                if value < end:
                    line[column[c]] += here[c] * signal[value]
                    if after[c] != 0:
                        line[column[c] + 1] += after[c] * signal[value]
            for j in range(len(line)):
                cells[row[r], j] += row_here[r] * line[j]
            if row_after[r] != 0:
                for j in range(len(line)):
                    cells[row[r] + 1, j] += row_after[r] * line[j]
        sums[n] = cells
