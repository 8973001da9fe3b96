"""The matcher slot: the similarity of queries and the rows of a bank."""

from abc import abstractmethod

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.slots.component import Component


class Matcher(Component):
    """Compares queries with the bank.

    A score is -1/2 ||query - row||^2. For unit vectors, this is the cosine minus one.
    """

    slot = "matcher"

    @abstractmethod
    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), one row per pose. It replaces any earlier bank."""

    @abstractmethod
    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N), unitless, of queries (M, D). A higher score means more similar, -inf not compared.

        `weights` w (M, D), 0 to 1, are the known shares of the numbers of a query q. The score of a row b is
        -1/2 sum_d w_d (q_d - b_d)^2. None means weights of one. A matcher that declares `Capabilities(weights=False)`
        never gets weights: see `LiftedMatcher`.
        """
