"""numba, without its warning about a threading library that it does not need."""

from __future__ import annotations

import warnings

from numba import njit, prange

# When it first runs in parallel, numba looks for an optional TBB and warns of versions that it cannot use.
warnings.filterwarnings("ignore", message="The TBB threading layer requires TBB")

__all__ = ["njit", "prange"]
