"""The matcher slot: how alike queries and the rows of a bank are."""

from __future__ import annotations

from abc import abstractmethod

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.slots.component import Component, Float32


class Matcher(Component):
    """Compares queries with the bank. A score is -1/2 ||query - row||^2: for unit vectors, the cosine minus one."""

    slot = "matcher"

    @abstractmethod
    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), one row a grid pose."""

    @abstractmethod
    def scores(self, queries: Float32) -> Float32:
        """Return scores (M, N) of queries (M, D), unitless, higher is more alike; -inf where it did not look."""

    def weighted_scores(self, queries: Float32, weights: Float32) -> Float32:
        """Return scores (M, N), -1/2 sum w (q - b)^2, of queries (M, D) of which weights (M, D), 0 to 1, are known.

        Raises ConfigError for a matcher that cannot weigh.
        """
        if (weights == 1).all():
            return self.scores(queries)
        raise ConfigError(
            f"the matcher {type(self).__name__} cannot leave out what a sensor does not see; choose dense, or a grid "
            "that lists its poses, such as face or hopf"
        )
