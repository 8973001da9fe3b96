"""The networks of the descriptor, computed with numpy: circular convolutions over the angles, and a pool."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

STRIDES = (1, 2, 2)


class Tower:
    """Maps features (N, A, C) to unit vectors (N, D). The vectors hardly depend on a rotation of the contact."""

    def __init__(self, weights: Mapping[str, Float32], name: str) -> None:
        self.layers = []
        for k in range(len(STRIDES)):
            kernel = weights[f"{name}.{k}.weight"]  # (outputs, inputs, taps)
            matrix = np.ascontiguousarray(kernel.transpose(2, 1, 0).reshape(-1, len(kernel)))
            self.layers.append((kernel.shape[2], matrix, weights[f"{name}.{k}.bias"]))
        self.out = np.ascontiguousarray(weights[f"{name}.out.weight"].T), weights[f"{name}.out.bias"]

    @property
    def dimensions(self) -> int:
        """The length of a vector."""
        return len(self.out[1])

    def __call__(self, features: Float32) -> Float32:
        """Return the vectors (N, D) of features (N, A, C)."""
        x = features
        for (taps, matrix, bias), stride in zip(self.layers, STRIDES, strict=True):
            count, angles, channels = x.shape
            wrapped = np.concatenate([x[:, -(taps // 2) :], x, x[:, : taps // 2]], axis=1)
            windows = np.lib.stride_tricks.sliding_window_view(wrapped, taps, axis=1)[:, ::stride]
            rows = windows.transpose(0, 1, 3, 2).reshape(-1, taps * channels)
            x = np.maximum(rows @ matrix + bias, 0).reshape(count, angles // stride, -1)
        matrix, bias = self.out
        vectors: Float32 = np.concatenate([x.mean(axis=1), x.max(axis=1)], axis=1) @ matrix + bias
        vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-12))
        return vectors
