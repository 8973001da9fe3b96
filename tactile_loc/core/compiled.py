"""numba, without its warning about a threading library that it does not need."""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    # numba looks for an optional TBB while its parallel module is imported and warns of versions that it cannot use.
    warnings.simplefilter("ignore")
    from numba import njit, prange

__all__ = ["njit", "prange"]
