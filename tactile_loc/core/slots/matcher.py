"""The matcher slot: how alike queries and the rows of a bank are."""

from __future__ import annotations

from abc import abstractmethod

from tactile_loc.core.slots.component import Component, Float32


class Matcher(Component):
    """Compares queries with the bank. A score is -1/2 ||query - row||^2: for unit vectors, the cosine minus one."""

    slot = "matcher"

    @abstractmethod
    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), one row a pose; it replaces an earlier one."""

    @abstractmethod
    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N) of queries (M, D), unitless, higher is more alike; -inf where it did not look.

        The weights (M, D), 0 to 1, say how far each number of a query q is known: the score of a row b is
        -1/2 sum_d w (q - b)^2. None stands for ones. A matcher that cannot weigh declares `Capabilities(weights=False)`
        and is never given weights.
        """
