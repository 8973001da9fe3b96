"""Exact matching with every row of the bank: one matrix product, or two if queries have weights."""

from tactile_loc.plugin.helpers import ExactMatcher


class DenseMatcher(ExactMatcher):
    """Scores all poses exactly."""
