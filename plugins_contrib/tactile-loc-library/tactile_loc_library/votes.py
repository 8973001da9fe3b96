"""Votes of several touches for the places of an object, joined if the places are at the right distances and angles.

Each touch votes for the places with similar descriptors. A place of one touch is supported by a place of another touch
if both are related as the touches are. Two points with directions are related by their distance and by the angles
between the directions and the line through the points. Drost et al. (CVPR 2010) match such pairs to find objects. The
handedness is compared, too. No pose is computed, and the yaws of the touches are not needed.

A shortlist of the likeliest objects is found without rating those that cannot be on it.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import Float32, Touch
from tactile_loc.plugin.helpers import find_anchor, njit

from tactile_loc_library.descriptor import Descriptor
from tactile_loc_library.similarity import UNIT, compare_vectors, round_touches

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

Float64 = NDArray[np.float64]

VOTED = 300  # most similar places of an object that a touch votes for
STD_M, STD_RAD = 2e-3, 0.12  # of distances and angles, mostly due to the spacing of the places
NEAR_M = 4e-3  # between nearer places, the direction of the line is uncertain
MOST_LOST = 15.0  # nats that a touch can take from an object, so that a single bad touch does not decide
ROUNDING = 1e-6  # nats
STEP_RAD = 0.2  # between the copies of a place about a continuous axis


@dataclass(frozen=True, eq=False)
class DescribedPlaces:
    """N places of an object, as touches are compared with them.

    `vectors` (N, D), int8, are descriptors times STEPS. `at` (N, 6) has the positions, metres, and the unit directions
    of the places, in the object frame: a place is touched along its direction. `copies` (E, 4, 4), metres, are the
    motions that map the object onto itself, the identity first.
    """

    vectors: NDArray[np.int8]
    at: Float32
    copies: Float64

    def __len__(self) -> int:
        return len(self.vectors)

    def copy(self, numbers: NDArray[np.int64]) -> Float64:
        """Return the positions and directions (K * E, 6) of the copies of the places `numbers` (K,), place by place."""
        at = self.at[numbers].astype(float)
        R, t = self.copies[:, :3, :3], self.copies[:, :3, 3]
        positions = np.einsum("eij,kj->kei", R, at[:, :3]) + t
        return np.concatenate([positions, np.einsum("eij,kj->kei", R, at[:, 3:])], axis=2).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class DescribedTouches:
    """Several touches, as places are compared with them: their `vectors` (T, D), and `at` (T, 6), where they touch.

    `at` has the positions, metres, and directions of the touches' deepest points, in the base frame.
    """

    vectors: Float32
    at: Float64

    @classmethod
    def of(cls, touches: Sequence[Touch], descriptor: Descriptor) -> DescribedTouches:
        """Describe touches. If there are several, each needs `T_base_sensor`."""
        at = []
        for touch in touches:
            anchor_m, R_sensor_gel = find_anchor(touch)
            T = np.eye(4) if touch.T_base_sensor is None else touch.T_base_sensor
            at.append([*(T[:3, :3] @ anchor_m + T[:3, 3]), *(T[:3, :3] @ R_sensor_gel[:, 2])])
        return cls(np.stack([descriptor.describe_touch(touch) for touch in touches]), np.array(at))

    @cached_property
    def rounded(self) -> NDArray[np.int16]:
        """The vectors (T, D) as whole numbers: see `round_touches`."""
        return round_touches(self.vectors)

    @cached_property
    def pairs(self) -> list[list[tuple[float, float, float, float, float]]]:
        """The relation of the places of touches i and j, as `pairs[i][j]`: see `measure_pair`."""
        return [[measure_pair(one, other) for other in self.at] for one in self.at]


@dataclass(frozen=True, eq=False)
class Votes:
    """For each touch, the places `numbers` (T, M) that it votes for, and how well these explain all touches.

    `nats` (T, M) are the log-likelihoods of all touches, apart from a constant, if touch t is at place `numbers[t]`.
    """

    numbers: NDArray[np.int64]
    nats: Float64


def join_votes(places: DescribedPlaces, touches: DescribedTouches, temperature: float) -> Votes:
    """Return the votes of T touches for the places of an object; see `Votes`.

    A similarity divided by the `temperature`, unitless, is a log-likelihood, apart from a constant.
    """
    numbers, alone = _vote(places, touches, temperature)
    return Votes(numbers, np.stack([_add_support(i, places, touches, [*numbers], [*alone]) for i in range(len(alone))]))


def rate_object(
    places: DescribedPlaces, touches: DescribedTouches, temperature: float, least: float = -np.inf
) -> float:
    """Return about the greatest of `Votes.nats`: only from the places of the first touch, or of the first two of more.

    This is exact for two touches. Of more touches, one may be bad. A rating below `least` is only a lower bound, which
    is found sooner.
    """
    numbers, alone = _vote(places, touches, temperature)
    least -= ROUNDING
    # the rating lacks at least as much as one of its places lacks of the best place of the same touch
    lowest = alone[:, 0] - max(alone[:, 0].sum() - least, 0.0)
    kept = [np.count_nonzero(nats >= limit) for nats, limit in zip(alone, lowest, strict=True)]
    few, some = ([row[:count] for row, count in zip(of, kept, strict=True)] for of in (numbers, alone))
    rating = -np.inf
    for i in range(max(1, min(2, len(alone) - 1))):
        rating = max(rating, float(_add_support(i, places, touches, few, some, max(least, rating)).max()))
    return rating


def _vote(places: DescribedPlaces, touches: DescribedTouches, temperature: float) -> tuple[NDArray[np.int64], Float64]:
    """Return the places (T, M) that each touch votes for, the most similar first, and the log-likelihoods (T, M)."""
    count = min(VOTED, len(places))
    similar = compare_vectors(places.vectors, touches.rounded)
    numbers = np.argpartition(-similar, count - 1, axis=1)[:, :count]
    best = np.take_along_axis(similar, numbers, axis=1)
    order = np.argsort(-best, axis=1, kind="stable")
    return np.take_along_axis(numbers, order, axis=1), rate_alone(np.take_along_axis(best, order, axis=1), temperature)


def rate_alone(similar: NDArray[np.int32], temperature: float) -> Float64:
    """Return the log-likelihoods of similarities, in 1 / UNIT, apart from a constant."""
    return similar / (UNIT * temperature)


def _add_support(
    i: int,
    places: DescribedPlaces,
    touches: DescribedTouches,
    numbers: Sequence[NDArray[np.int64]],
    alone: Sequence[Float64],
    least: float | None = None,
) -> Float64:
    """Return the log-likelihoods (M,) of the places of touch i, with the support by the places of all other touches.

    If `least` is given, only the greatest one is exact, and only if it is above `least`. The others are lower bounds.
    """
    own, nats = places.at[numbers[i]].astype(float), alone[i].copy()
    others = [j for j in range(len(alone)) if j != i]
    for n, j in enumerate(others, 1):
        copied, values = places.copy(numbers[j]), np.repeat(alone[j], len(places.copies))
        most = sum(float(alone[later][0]) for later in others[n:])  # that later touches can add
        if least is None:
            _support(nats, own, copied, values, touches.pairs[i][j], (-np.inf, most, -np.inf))
        else:
            surely = most - MOST_LOST * len(others[n:])
            least = _support(nats, own, copied, values, touches.pairs[i][j], (least, most, surely))
    return nats


def measure_pair(first: Float64, second: Float64) -> tuple[float, float, float, float, float]:
    """Return the distance, metres, and the angles' cosines and handedness of two points with directions (6,)."""
    along = second[:3] - first[:3]
    distance_m = float(np.linalg.norm(along))
    along = along / max(distance_m, 1e-9)
    a, b = first[3:], second[3:]
    return distance_m, float(a @ b), float(a @ along), float(b @ along), float(np.cross(a, b) @ along)


@dataclass(frozen=True)
class Shortlist:
    """The objects that are at most `most_behind` nats less likely than the likeliest one: from `least` to `most`.

    Any other rating can take the place of the log-likelihood, if a greater one is better.
    """

    most_behind: float
    least: int = 8
    most: int = 64

    def choose(self, nats: Float64) -> list[int]:
        """Return the numbers of the chosen objects, the likeliest first, given the log-likelihoods (K,) of all."""
        order = np.argsort(-nats, kind="stable")
        near = int(np.count_nonzero(nats >= nats.max() - self.most_behind))
        return [int(k) for k in order[: min(max(near, self.least), self.most)]]

    def rate(self, bounds: Float64, rate: Callable[[int, float], float]) -> Float64:
        """Return log-likelihoods (K,) from which `choose` chooses the same objects as from the true ones.

        They are the true ones of the chosen objects, and may be upper bounds of the others. `bounds` (K,) are upper
        bounds of all. `rate(k, least)` returns the log-likelihood of object k. If that is below `least`, it may return
        any lower value.
        """
        nats, limit = bounds.copy(), -np.inf
        best: list[float] = []  # the greatest so far, ascending
        for k in np.argsort(-bounds, kind="stable"):
            if bounds[k] < limit:
                break
            rating = rate(int(k), limit)
            nats[k] = rating if rating >= limit else min(bounds[k], np.nextafter(limit, -np.inf))
            insort(best, float(nats[k]))
            del best[: -self.most]
            limit = self._find_limit(best)
        return nats

    def _find_limit(self, best: Sequence[float]) -> float:
        """Return the log-likelihood that another object needs to be chosen. With further objects, it does not fall.

        `best` are those of the `most` likeliest of some objects, or of all of these if they are fewer, ascending.
        """
        if len(best) < self.least:
            return -np.inf
        near = min(best[-1] - self.most_behind, best[-self.least])
        return near if len(best) < self.most else max(near, best[-self.most])


@njit(fast=True)
def _support(nats, first, second, values, pair, limits):
    """Add the best support by points with directions `second` (N, 6) to `nats` (M,) of points `first` (M, 6).

    The support is the value (N,) of the second point, less the mismatch of the two with the touched `pair`. It
    is at most MOST_LOST below the greatest value. The values are in descending order, so that a search can end early.

    `limits` are `least`, `most` and `surely`. Later touches add from `surely` to `most` nats. A support may be too low
    if the sum then stays below `least`, or below the sum of another point. Returns the greatest sum that is sure, or
    `least` if this is greater.
    """
    least, most, surely = limits
    distance, both, from_first, from_second, handed = pair
    weight = min(1.0, distance / NEAR_M)
    for i in range(len(first)):
        best = values[0] - MOST_LOST
        needed = max(best, least - most - nats[i])
        for j in range(len(second)):
            spare = 2 * (values[j] - needed)
            if spare <= 0:
                break
            x, y, z = second[j, 0] - first[i, 0], second[j, 1] - first[i, 1], second[j, 2] - first[i, 2]
            length = math.sqrt(x * x + y * y + z * z) + 1e-9
            off = (length - distance) / STD_M
            mismatch = off * off
            if mismatch >= spare:
                continue
            a, b, c = first[i, 3], first[i, 4], first[i, 5]
            d, e, f = second[j, 3], second[j, 4], second[j, 5]
            off = (a * d + b * e + c * f - both) / STD_RAD
            mismatch += off * off
            if mismatch >= spare:
                continue
            x, y, z = x / length, y / length, z / length
            along = weight * (a * x + b * y + c * z - from_first) / STD_RAD
            back = weight * (d * x + e * y + f * z - from_second) / STD_RAD
            hand = (b * f - c * e) * x + (c * d - a * f) * y + (a * e - b * d) * z
            turned = weight * (hand - handed) / STD_RAD
            mismatch += along * along + back * back + turned * turned
            best = max(best, values[j] - 0.5 * mismatch)
            needed = max(needed, best)
        nats[i] += best
        least = max(least, nats[i] + surely)
    return least
