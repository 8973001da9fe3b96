"""The usearch matcher: the nearest rows of each query, found in a graph of neighbours (HNSW)."""

import numpy as np
from pydantic import Field
from tactile_loc.plugin import Capabilities, ComponentOptions, Float32, Matcher
from usearch.index import Index

LINKS = 32  # neighbours of each node
ONE = 1  # thread, because several threads would build another graph each time


class UsearchMatcher(Matcher):
    """Scores the `top_k` most similar poses of each query. All other poses get -inf."""

    capabilities = Capabilities(top_k_only=True, weights=False)

    class Options(ComponentOptions):
        """The number of poses found, and the effort of building and searching the graph."""

        top_k: int = Field(default=1000, ge=1, description="poses scored for each query; others count as impossible")
        build_effort: int = Field(default=64, ge=1, description="nodes visited to place a row in the graph")
        effort: int = Field(default=1000, ge=1, description="nodes visited for a query, at least top_k")

    def index(self, bank: Float32) -> None:
        """Build the graph of the bank (N, D), unitless."""
        rows, made = np.array(bank, np.float32, order="C"), self.options
        effort = max(made.effort, made.top_k)
        self._index = Index(
            ndim=rows.shape[1],
            metric="l2sq",
            dtype="f32",
            connectivity=LINKS,
            expansion_add=made.build_effort,
            expansion_search=effort,
        )
        self._index.add(np.arange(len(rows)), rows, threads=ONE)

    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N), -1/2 ||q - b||^2, unitless. Poses that usearch does not find get -inf."""
        q, count = np.array(queries, np.float32, order="C"), len(self._index)
        scores = np.full((len(q), count), -np.inf, np.float32)
        for row, query in zip(scores, q, strict=True):
            found = self._index.search(query, min(self.options.top_k, count), threads=ONE)
            row[found.keys.astype(np.int64)] = -0.5 * found.distances
        return scores
