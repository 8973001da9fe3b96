"""Base class for matchers that score all poses exactly."""

from functools import cached_property

import numpy as np

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.compiled import run_in_threads, use_one_blas_thread
from tactile_loc.slots.matcher import Matcher

TRANSPOSED = 256  # rows transposed at once, so that they stay in a processor's cache


class ExactMatcher(Matcher):
    """Scores all poses exactly: -1/2 ||q - b||^2 = q . b - 1/2 ||b||^2 - 1/2 ||q||^2."""

    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), unitless."""
        self._bank = np.ascontiguousarray(bank, np.float32)
        for derived in ("_half_squares", "_half_norms"):
            self.__dict__.pop(derived, None)

    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N), unitless, of queries (M, D) with weights (M, D), as `Matcher.scores` defines them."""
        q = np.asarray(queries, np.float32)
        if weights is not None:
            return self._score_weighted(q, np.asarray(weights, np.float32))
        half_norms = 0.5 * np.einsum("md,md->m", q, q)
        scores = multiply(q, self._bank.T)
        scores -= self._half_norms
        scores -= half_norms[:, None]
        return scores

    def _score_weighted(self, q: Float32, w: Float32) -> Float32:
        weighed = np.multiply(w, q, dtype=np.float32)
        of_queries = 0.5 * np.einsum("md,md->m", weighed, q)
        scores = multiply(weighed, self._bank.T)
        partly = np.flatnonzero((w != 1).any(axis=0))  # all rows have the same squares where each query counts fully
        if 2 * len(partly) < w.shape[1]:
            scores += multiply(1 - w[:, partly], self._half_squares[partly])
            scores -= self._half_norms
        else:
            scores -= multiply(w, self._half_squares)
        scores -= of_queries[:, None]
        return scores

    @cached_property
    def _half_norms(self) -> Float32:
        return np.asarray(0.5 * np.einsum("nd,nd->n", self._bank, self._bank), np.float32)

    @cached_property
    def _half_squares(self) -> Float32:
        halves = np.empty(self._bank.T.shape, np.float32)
        for start in range(0, len(self._bank), TRANSPOSED):
            some = slice(start, start + TRANSPOSED)
            np.multiply(np.square(self._bank[some]).T, np.float32(0.5), out=halves[:, some])
        return halves


def multiply(a: Float32, b: Float32) -> Float32:
    """Return the matrix product (M, N) of a (M, D) and b (D, N), in the threads of `compiled`."""
    product = np.empty((len(a), b.shape[1]), np.float32)
    with use_one_blas_thread():
        run_in_threads(_multiply_rows, len(a), a, b, product)
    return product


def _multiply_rows(first: int, last: int, a: Float32, b: Float32, product: Float32) -> None:
    np.matmul(a[first:last], b, out=product[first:last])
