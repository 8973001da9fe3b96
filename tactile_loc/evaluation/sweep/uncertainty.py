"""How sure medians and paired differences are: percentile intervals of the bootstrap (Efron 1979) over touches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints

RESAMPLED, SEED = 1000, 0
RANGE = (2.5, 97.5)  # percentiles of an interval
LEAST_TOUCHES = 6  # the probability that fewer fair differences all have one sign is above 5 %
CHANCE, FEW, EQUAL = "may be chance", "too few touches", "equal"


class Estimate(NamedTuple):
    """A value with its 95 % interval; NaN if unknown."""

    value: float
    low: float = math.nan
    high: float = math.nan


@lru_cache(maxsize=16)
def draw_median_ranks(count: int) -> Ints:
    """Return the ranks (R, 2), from 0, of the two middle values of each of RESAMPLED samples of `count` values."""
    rng = np.random.default_rng(SEED)
    middle = [(count - 1) // 2, count // 2]
    return np.stack([np.partition(rng.integers(count, size=count), middle)[middle] for _ in range(RESAMPLED)])


def resample_medians(values: Floats) -> Floats:
    """Return the medians (M, R) of each of M series of values (M, T), for samples of the touches of each series."""
    ranks, ordered = draw_median_ranks(values.shape[1]), np.sort(values, axis=1)
    # the samples of different series are independent, because their order differs
    return np.stack([some[np.roll(ranks, k, axis=0)].mean(axis=1) for k, some in enumerate(ordered)])


def find_interval(samples: Floats, touches: int) -> tuple[float, float]:
    """Return the 95 % interval of samples (R,); NaN with fewer than LEAST_TOUCHES touches."""
    if touches < LEAST_TOUCHES:
        return math.nan, math.nan
    low, high = RANGE  # between two samples, the outer one counts; medians of few touches take few values
    return float(np.percentile(samples, low, method="lower")), float(np.percentile(samples, high, method="higher"))


def estimate_median(values: Floats) -> Estimate:
    """Return the mean over series, such as seeds, of the medians over touches of values (M, T)."""
    value = float(np.median(values, axis=1).mean())
    return Estimate(value, *find_interval(resample_medians(values).mean(axis=0), values.size))


@dataclass(frozen=True, eq=False)
class ComparedMedian:
    """The median over the touches of values (M, T) of M series, and that of the differences from a base.

    `difference` is the median over all touches of all series of the value less the base's value of the same touch; it
    is NaN without a base. `verdict` says whether its interval excludes zero.
    """

    values: Floats
    median: Estimate
    difference: Estimate
    verdict: str

    @classmethod
    def of(cls, values: Floats, base: Floats | None, less: str, more: str, without: str = "") -> ComparedMedian:
        """Compare values (M, T) with those of a base; the verdict is `without` if there is none.

        The verdict is `less` or `more` if the interval of the difference excludes zero, CHANCE if it includes zero, FEW
        without an interval, and EQUAL if the values of every touch are equal.
        """
        if base is None:
            return cls(values, estimate_median(values), Estimate(math.nan), without)
        difference = estimate_median((values - base).reshape(1, -1))
        if np.array_equal(values, base):
            verdict = EQUAL
        elif math.isnan(difference.low):
            verdict = FEW
        else:
            verdict = less if difference.high < 0 else more if difference.low > 0 else CHANCE
        return cls(values, estimate_median(values), difference, verdict)
