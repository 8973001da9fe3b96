"""Matching with faiss: exact (flat), or approximate over a neighbour graph (hnsw) or inverted lists (ivf)."""

from __future__ import annotations

from typing import Any, Literal

import faiss
import numpy as np
from pydantic import Field

from tactile_loc.plugin import Capabilities, ComponentOptions, Float32, Matcher


class FaissMatcher(Matcher):
    """Scores the `top_k` most alike poses; all others get -inf."""

    capabilities = Capabilities(top_k_only=True)

    class Options(ComponentOptions):
        """Which faiss index, and how many poses it returns."""

        kind: Literal["flat", "hnsw", "ivf"] = Field(default="flat", description="exact, graph, or inverted lists")
        top_k: int = Field(default=1000, ge=1, description="poses scored a touch; the others count as impossible")
        links: int = Field(default=32, ge=4, le=128, description="hnsw: neighbours a node")
        effort: int = Field(default=128, ge=1, description="hnsw: nodes visited; ivf: lists visited")

    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), unitless."""
        bank = np.ascontiguousarray(bank, np.float32)
        self._count = len(bank)
        self._index = self._make(bank)
        self._index.add(bank)

    def scores(self, queries: Float32) -> Float32:
        """Return scores (M, N) of queries (M, D), unitless; -inf beyond the `top_k` that faiss found."""
        k = min(self.options.top_k, self._count)
        squared, found = self._index.search(np.ascontiguousarray(queries, np.float32), k)
        scores = np.full((len(queries), self._count), -np.inf, np.float32)
        rows, columns = np.nonzero(found >= 0)
        scores[rows, found[rows, columns]] = -0.5 * squared[rows, columns]
        return scores

    def _make(self, bank: Float32) -> Any:
        dimension, options = bank.shape[1], self.options
        if options.kind == "flat":
            return faiss.IndexFlatL2(dimension)
        if options.kind == "hnsw":
            graph = faiss.IndexHNSWFlat(dimension, options.links)
            graph.hnsw.efSearch = max(options.effort, options.top_k)
            return graph
        lists = max(1, round(np.sqrt(self._count)))
        index = faiss.IndexIVFFlat(faiss.IndexFlatL2(dimension), dimension, lists)
        index.train(bank)
        index.nprobe = min(lists, options.effort)
        return index
