"""Exact matching with every row of the bank: one matrix product."""

from __future__ import annotations

import numpy as np

from tactile_loc.plugin import Float32, Matcher


class DenseMatcher(Matcher):
    """Scores all poses exactly: -1/2 ||q - b||^2 = q . b - 1/2 ||b||^2 - 1/2 ||q||^2."""

    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), unitless, and its half squared norms."""
        self._bank = np.ascontiguousarray(bank, np.float32)
        self._half_norms = 0.5 * np.einsum("nd,nd->n", self._bank, self._bank)

    def scores(self, queries: Float32) -> Float32:
        """Return scores (M, N) of queries (M, D), unitless; higher is more alike."""
        q = np.asarray(queries, np.float32)
        half_norms = 0.5 * np.einsum("md,md->m", q, q)
        scores: Float32 = q @ self._bank.T - self._half_norms - half_norms[:, None]
        return scores
