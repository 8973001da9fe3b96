"""What a check is: a function of one component that returns nothing, or raises ContractError."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Check = Callable[[Any], None]


class ContractError(AssertionError):
    """A component broke a contract; the sentence says which, and how."""


def require(holds: object, sentence: str) -> None:
    """Raise ContractError with the sentence unless the condition holds."""
    if not holds:
        raise ContractError(sentence)


def require_array(value: Any, shape: tuple[int, ...], dtype: type, what: str) -> None:
    """Raise ContractError unless `value` is an array of this shape and type; `what` names it in the sentence."""
    require(isinstance(value, np.ndarray), f"{what} must be a numpy array, not {type(value).__name__}")
    require(value.shape == shape, f"{what} must have shape {shape}, not {value.shape}")
    require(value.dtype == dtype, f"{what} must be {np.dtype(dtype)}, not {value.dtype}")


def require_close(value: ArrayLike, truth: ArrayLike, tolerance: float, sentence: str) -> None:
    """Raise ContractError unless two arrays agree to an absolute tolerance, in the arrays' own unit."""
    a, b = np.asarray(value, float), np.asarray(truth, float)
    require(a.shape == b.shape, f"{sentence} (shapes {a.shape} and {b.shape})")
    largest = float(np.abs(a - b).max(initial=0.0)) if np.isfinite(a).all() else float("nan")
    require(largest <= tolerance, f"{sentence} (largest difference {largest:.3g}, allowed {tolerance:.3g})")


class Untouched:
    """Holds copies of arrays, to tell afterwards which of them somebody wrote to."""

    def __init__(self, **arrays: Any) -> None:
        self._arrays = arrays
        self._copies = {name: np.array(array, copy=True) for name, array in arrays.items()}

    def require(self) -> None:
        """Raise ContractError when an array is no longer what it was."""
        for name, array in self._arrays.items():
            same = np.array_equal(array, self._copies[name], equal_nan=array.dtype.kind == "f")
            require(same, f"inputs belong to the caller, but {name} was written to; work on a copy")
