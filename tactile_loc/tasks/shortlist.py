"""A shortlist of the likeliest objects, found without rating those that cannot be on it."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


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
