"""A compiled loop that splits points into blocks of neighbours: see `blocks.py`."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.runtime.compiled import njit

# mypy: disable-error-code="no-untyped-def,no-untyped-call"


@njit
def split_into_blocks(middles, most, order, starts):
    """Sort the numbers `order` (N,) of items with `middles` (N, 3) by blocks of at most `most` items.

    Block b has the items from starts[b] to starts[b + 1]. Returns the number of blocks.
    """
    waiting = [(0, len(order))]
    count = 0
    starts[0] = 0
    while len(waiting) > 0:
        first, last = waiting.pop()
        if last - first <= most:
            count += 1
            starts[count] = last
            continue
        some = order[first:last].copy()
        longest, side = -1.0, 0
        for axis in range(3):
            values = middles[some, axis]
            length = values.max() - values.min()
            if length > longest:
                longest, side = length, axis
        order[first:last] = some[np.argsort(middles[some, side], kind="mergesort")]
        middle = first + (last - first) // 2
        waiting.append((middle, last))
        waiting.append((first, middle))
    return count
