"""Matching with faiss: exact (flat), or approximate over a neighbour graph (hnsw) or inverted lists (ivf)."""

from functools import cached_property
from typing import Any, Literal

import faiss
import numpy as np
from pydantic import Field

from tactile_loc.plugin import Capabilities, ComponentOptions, Float32, Matcher

LINKS = 32  # hnsw: neighbours of each node
ROWS_A_LIST = 39  # rows that faiss needs to train one inverted list


class FaissMatcher(Matcher):
    """Scores the `top_k` most similar poses of each query. All other poses get -inf.

    Queries with weights w use a second index. Let rows b and queries q be relative to the bank's mean. The score
    -1/2 sum w (q - b)^2 is then the inner product of [w q, -w/2] with [b, b^2], minus 1/2 sum w q^2.
    """

    capabilities = Capabilities(top_k_only=True)

    class Options(ComponentOptions):
        """The kind of faiss index, and the number of poses it returns."""

        kind: Literal["flat", "hnsw", "ivf"] = Field(default="flat", description="exact, graph, or inverted lists")
        top_k: int = Field(default=1000, ge=1, description="poses scored for each query; others count as impossible")
        effort: int = Field(default=128, ge=1, description="hnsw: nodes visited; ivf: lists visited")

    def index(self, bank: Float32) -> None:
        """Keep the bank (N, D), unitless. The faiss index is built at the first search."""
        self._bank = np.ascontiguousarray(bank, np.float32)
        for made in ("_plain", "_weighing", "_mean"):
            self.__dict__.pop(made, None)

    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N), -1/2 sum w (q - b)^2, unitless. Poses that faiss does not find get -inf.

        The queries and their weights are (M, D). None means weights of one.
        """
        q = np.ascontiguousarray(queries, np.float32)
        k = min(self.options.top_k, len(self._bank))
        if weights is None:
            squared, found = self._plain.search(q, k)
            return self._spread(-0.5 * squared, found)
        q, w = q - self._mean, np.asarray(weights, np.float32)
        products, found = self._weighing.search(np.hstack([w * q, -0.5 * w]), k)
        return self._spread(products - 0.5 * np.einsum("md,md,md->m", w, q, q)[:, None], found)

    def _spread(self, scores: Float32, found: Any) -> Float32:
        """Return scores (M, N) of all rows, given the scores (M, K) of found rows (M, K). Row -1 means none found."""
        spread = np.full((len(scores), len(self._bank)), -np.inf, np.float32)
        queries, places = np.nonzero(found >= 0)
        spread[queries, found[queries, places]] = scores[queries, places]
        return spread

    @cached_property
    def _mean(self) -> Float32:
        mean: Float32 = self._bank.mean(axis=0, dtype=np.float64).astype(np.float32)
        return mean

    @cached_property
    def _plain(self) -> Any:
        return self._make_index(self._bank, faiss.METRIC_L2)

    @cached_property
    def _weighing(self) -> Any:
        centred = self._bank - self._mean
        return self._make_index(np.hstack([centred, centred**2]), faiss.METRIC_INNER_PRODUCT)

    def _make_index(self, rows: Float32, metric: int) -> Any:
        (count, dimension), options = rows.shape, self.options
        index: Any
        if options.kind == "flat":
            index = faiss.IndexFlat(dimension, metric)
        elif options.kind == "hnsw":
            index = faiss.IndexHNSWFlat(dimension, LINKS, metric)
            index.hnsw.efSearch = max(options.effort, options.top_k)
        else:
            lists = max(1, min(round(np.sqrt(count)), count // ROWS_A_LIST))
            index = faiss.IndexIVFFlat(faiss.IndexFlat(dimension, metric), dimension, lists, metric)
            index.train(rows)
            index.nprobe = min(lists, options.effort)
        index.add(rows)
        return index
