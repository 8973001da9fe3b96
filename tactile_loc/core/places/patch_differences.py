"""Differences of patches, which compress well, and the patches that have given differences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.compiled import njit

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

Bytes = NDArray[np.uint8]


def differentiate(patches: Bytes) -> Bytes:
    """Return the differences, modulo 256, of patches (N, S, S) along both axes."""
    zero = np.uint8(0)
    return np.diff(np.diff(patches, axis=1, prepend=zero), axis=2, prepend=zero)


def integrate(differences: Bytes) -> Bytes:
    """Return the patches (N, S, S) with these differences along both axes, modulo 256."""
    patches = np.empty_like(differences)
    _add_up(differences, patches)
    return patches


@njit
def _add_up(differences, patches):
    N, H, W = differences.shape
    for n in range(N):
        for i in range(H):
            total = np.uint8(0)
            for j in range(W):
                total = np.uint8(total + differences[n, i, j])
                above = patches[n, i - 1, j] if i > 0 else np.uint8(0)
                patches[n, i, j] = np.uint8(total + above)
