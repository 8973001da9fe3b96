"""The torch matcher: matrix products of the queries with chunks of the bank's rows, on a GPU if there is one."""

from typing import Any, Literal

import numpy as np
import torch
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, ConfigError, Float32, Matcher

NEUTRAL = {"neutral": True}  # marks options that change scores only by rounding


class TorchMatcher(Matcher):
    """Scores all rows exactly, with or without weights.

    The bank's mean is subtracted from rows and queries. This keeps sums small, and does not change distances.
    """

    class Options(ComponentOptions):
        """The device, and the number of rows in a chunk."""

        device: Literal["auto", "cpu", "cuda"] = Field(
            default="auto", description="device; auto: CUDA if there is any", json_schema_extra=NEUTRAL
        )
        rows: int = Field(
            default=65_536, ge=1, description="rows of the bank compared at once", json_schema_extra=NEUTRAL
        )

    def __init__(self, options: Any = None) -> None:
        """Choose the device. Raises ConfigError if CUDA is requested but not available."""
        super().__init__(options)
        wanted, there = self.options.device, torch.cuda.is_available()
        if wanted == "cuda" and not there:
            raise ConfigError(
                "the matcher 'torch-matcher' cannot use CUDA, because torch finds no CUDA device; install a CUDA build "
                "of torch and a driver, or set matcher.device to cpu"
            )
        self.device = torch.device("cuda" if there and wanted != "cpu" else "cpu")

    def index(self, bank: Float32) -> None:
        """Copy the bank (N, D), unitless, to the device. It replaces an earlier bank."""
        rows = self._on_device(bank)
        self._mean = rows.mean(dim=0)
        self._chunks = (rows - self._mean).split(self.options.rows)
        self._half_norms = [0.5 * chunk.square().sum(dim=1) for chunk in self._chunks]
        self._half_squares: list[torch.Tensor] = []  # computed for the first queries with weights

    @torch.inference_mode()
    def scores(self, queries: Float32, weights: Float32 | None = None) -> Float32:
        """Return scores (M, N), -1/2 sum w (q - b)^2, of queries q and weights w, both (M, D). None means ones."""
        q = self._on_device(queries) - self._mean
        if weights is None:
            of_queries = 0.5 * q.square().sum(dim=1, keepdim=True)
            pairs = zip(self._chunks, self._half_norms, strict=True)
            parts = [torch.addmm(-norms, q, chunk.T) - of_queries for chunk, norms in pairs]
        else:
            w = self._on_device(weights)
            weighed = w * q
            of_queries = 0.5 * (weighed * q).sum(dim=1, keepdim=True)
            pairs = zip(self._chunks, self._squares(), strict=True)
            parts = [torch.addmm(-(w @ squares.T), weighed, chunk.T) - of_queries for chunk, squares in pairs]
        scores: Float32 = torch.cat(parts, dim=1).cpu().numpy()
        return scores

    def _squares(self) -> list[torch.Tensor]:
        if not self._half_squares:
            self._half_squares = [0.5 * chunk.square() for chunk in self._chunks]
        return self._half_squares

    def _on_device(self, array: Float32) -> torch.Tensor:
        return torch.from_numpy(np.array(array, np.float32, order="C")).to(self.device)  # a copy: stores are read-only
