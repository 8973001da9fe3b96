"""The encoder slot: embeddings of contact shapes, and the training data of an encoder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.simulation.noise import TouchNoise
from tactile_loc.core.slots.component import Component, Float32


class Checkpoints:
    """Stores the state of a training, so that it can resume after an interruption. This base class stores nothing."""

    def load(self) -> Path | None:
        """Return the last intact file that was saved, or None."""
        return None

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the saved file atomically with the one that `write(path)` writes."""


@dataclass(frozen=True, eq=False)
class TrainingBatch:
    """Noisy touches with labels, each in V views: B touches, V at least one.

    `depth_m` (B, V, H, W) are contact depths, metres, cut at presses `press_m` (B,). `seen` (B, V, H, W) marks the
    pixels that the sensor observes. `labels` (B,) are the numbers of the keys nearest to the true poses. View 0 matches
    the key. The other views are decoys: the same touch, rotated so that no key of this object explains it. `counts` (B,
    V) marks the views that count; a decoy that matches a key by symmetry does not count.
    """

    depth_m: Float32
    seen: NDArray[np.bool_]
    press_m: NDArray[np.float64]
    labels: NDArray[np.int64]
    counts: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.labels)


class TrainingTouches(ABC):
    """Simulated touches of known pose, rendered once; each batch has new noise."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of touches."""

    @abstractmethod
    def batch(self, count: int, rng: np.random.Generator, press_m: float, decoys: int = 0) -> TrainingBatch:
        """Draw `count` different touches, to compare with keys that are cut at `press_m` metres.

        Each has `decoys` decoys, if touches are rotated when they are compared.
        """


class TrainingProblem(ABC):
    """The simulated training data of an encoder: touches, and one key for each pose or place that is searched.

    `partly_seen`: touches show only a part of what their keys show, and are encoded with `Encoder.encode_seen`. The
    encoder reports its progress to `progress` and resumes from `checkpoints`.
    """

    progress: Progress
    checkpoints: Checkpoints
    partly_seen: bool

    @property
    @abstractmethod
    def geometry(self) -> SensorGeometry:
        """The camera that sees keys and touches."""

    @property
    @abstractmethod
    def key_presses_m(self) -> NDArray[np.float64]:
        """The press depths (P,), metres, at which keys may be cut; a touch is compared with keys of one of them."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of keys."""

    @abstractmethod
    def clean_keys(self, press_m: float) -> Iterable[Float32]:
        """Yield the keys' whole contact depths without noise, cut at a press: shards (S, H, W), S > 0, metres."""

    @abstractmethod
    def draw(self, count: int, noise: TouchNoise, rng: np.random.Generator) -> TrainingTouches:
        """Render `count` touches at random poses, to which this noise will be added."""

    @abstractmethod
    def key_distances(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the distances (K,), metres, in the pose metric between keys `first` (K,) and `second` (K,)."""


class Encoder(Component):
    """Maps contact shapes to vectors whose Euclidean distance tells how similar the poses are."""

    slot = "encoder"

    def fit(self, problem: TrainingProblem) -> None:
        """Train on simulated touches. Does nothing unless the encoder needs training."""

    def save_weights(self, path: Path) -> None:
        """Write the trained weights to a safetensors file. Raises NotImplementedError without training."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    def load_weights(self, path: Path) -> None:
        """Read the file of `save_weights` instead of calling `fit`. Raises WeightsError if another encoder wrote it."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    @abstractmethod
    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, D) of contact depths (N, H, W) in metres, all cut at one press depth."""

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return embeddings (N, D) of contact depths (N, H, W), metres, known at pixels `seen` (N, H, W), and weights
        (N, D), the known share of each number of an embedding, 0 to 1. Both are float32.

        A grid of places uses this, because the sensor's field is limited; the matcher gets the weights. If all pixels
        are seen, the embeddings equal those of `encode`, and the weights are one. By default, unseen pixels count as
        out of contact, and all weights are one; override the method if that does not suit the encoder.
        """
        embeddings = self.encode(np.where(seen, depth_m, np.float32(press_depth_m)), press_depth_m, geometry)
        return embeddings, np.ones_like(embeddings)
