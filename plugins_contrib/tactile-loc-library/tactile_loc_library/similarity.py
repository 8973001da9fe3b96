"""The similarities of touches and places by their descriptors, summed in whole numbers.

Sums of whole numbers do not depend on the order of the terms. So a similarity has the same bits in every function of
this module, and on every machine.
"""

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin.helpers import njit, run_in_threads

from tactile_loc_library.descriptor import STEPS

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

TOUCH_STEPS = 32767  # of a component of a touch's vector from 0 to 1
UNIT = STEPS * TOUCH_STEPS  # a similarity of 1
AT_ONCE = 64  # places that stay in the fastest cache while all touches are compared with them
NO_PLACE = np.iinfo(np.int32).min  # the similarity of a part without places


def round_touches(vectors: NDArray[np.float32]) -> NDArray[np.int16]:
    """Return the unit vectors (T, D) of touches times TOUCH_STEPS, rounded."""
    return np.rint(TOUCH_STEPS * vectors).astype(np.int16)


def compare_vectors(vectors: NDArray[np.int8], touches: NDArray[np.int16]) -> NDArray[np.int32]:
    """Return the similarities (T, N), in 1 / UNIT, of rounded touches (T, D) and places (N, D), times STEPS."""
    found = np.empty((len(touches), len(vectors)), np.int32)
    _compare_some(vectors, touches, found)
    return found


def find_most_similar(
    vectors: NDArray[np.int8], touches: NDArray[np.int16], first: NDArray[np.int64], places: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Return the greatest similarities (T, K), in 1 / UNIT, of rounded touches (T, D) and the places of K parts.

    Part k has the `places[k]` rows of `vectors` (N, D), times STEPS, that start at row `first[k]`. If it has none, its
    similarity is NO_PLACE.
    """
    found = np.empty((len(touches), len(first)), np.int32)
    run_in_threads(_find_some, len(first), vectors, touches, first, places, found)
    return found


@njit
def _multiply(one, other):
    total = np.int32(0)
    for d in range(len(one)):
        total += np.int32(one[d]) * np.int32(other[d])
    return total


@njit
def _compare_some(vectors, touches, found):
    for n in range(len(vectors)):
        for t in range(len(touches)):
            found[t, n] = _multiply(vectors[n], touches[t])


@njit
def _find_some(start, stop, vectors, touches, first, places, found):
    for k in range(start, stop):
        end = first[k] + places[k]
        found[:, k] = NO_PLACE
        for at in range(first[k], end, AT_ONCE):
            for t in range(len(touches)):
                best = found[t, k]
                for n in range(at, min(at + AT_ONCE, end)):
                    best = max(best, _multiply(vectors[n], touches[t]))
                found[t, k] = best


def integrate(differences: NDArray[np.uint8]) -> NDArray[np.uint8]:
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
