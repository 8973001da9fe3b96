"""The encoder slot: vectors of contact shapes, and what an encoder may learn from."""

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
    """Where a training keeps its state, so that it can go on after an interruption. This one forgets everything."""

    def load(self) -> Path | None:
        """Return the file that was saved last and is intact, or None."""
        return None

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the saved file, atomically, by what `write(path)` writes."""


@dataclass(frozen=True, eq=False)
class TrainingBatch:
    """Noisy touches with labels, each in V views: B touches, V at least one.

    `depth_m` (B, V, H, W) are contact depths in metres, cut at presses `press_m` (B,); `seen` (B, V, H, W) says which
    pixels the sensor observes. `labels` (B,) are the numbers of the keys nearest to the true poses. View 0
    shows what the key shows. The others are decoys: the same touch, turned so that no key of this object explains it.
    `counts` (B, V) says which views count: a decoy that symmetry makes right does not.
    """

    depth_m: Float32
    seen: NDArray[np.bool_]
    press_m: NDArray[np.float64]
    labels: NDArray[np.int64]
    counts: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.labels)


class TrainingTouches(ABC):
    """Simulated touches of known pose, rendered once: batches of them, each time with new noise."""

    @abstractmethod
    def __len__(self) -> int:
        """Return how many touches there are."""

    @abstractmethod
    def batch(self, count: int, rng: np.random.Generator, press_m: float, decoys: int = 0) -> TrainingBatch:
        """Draw `count` different touches to be compared with keys that are cut at `press_m` metres.

        Each has `decoys` decoys if touches are turned when they are compared.
        """


class TrainingProblem(ABC):
    """What an encoder may learn from, all of it simulation: touches, and a key of each pose or place that is searched.

    `partly_seen` says whether touches show a part of what their keys show, and are encoded by `Encoder.encode_seen`.
    `progress` and `checkpoints` are for the encoder to report to and to resume from.
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
        """The press depths (P,), metres, at which keys may be cut: touches are compared with keys of one of them."""

    @abstractmethod
    def __len__(self) -> int:
        """Return how many keys there are."""

    @abstractmethod
    def clean_keys(self, press_m: float) -> Iterable[Float32]:
        """Return what the keys show, wholly and without noise, cut at a press: shards (S, H, W), S > 0, metres."""

    @abstractmethod
    def draw(self, count: int, noise: TouchNoise, rng: np.random.Generator) -> TrainingTouches:
        """Render `count` touches at random poses, which are to have this noise."""

    @abstractmethod
    def key_distances(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return how far apart keys `first` (K,) and `second` (K,) are as poses, in the pose metric: (K,), metres."""


class Encoder(Component):
    """Maps contact shapes to vectors whose Euclidean distance says how alike the poses are."""

    slot = "encoder"

    def fit(self, problem: TrainingProblem) -> None:
        """Learn from simulation. Does nothing unless the encoder needs training."""

    def save_weights(self, path: Path) -> None:
        """Write what `fit` learned to a safetensors file. Encoders that need no training have nothing to write."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    def load_weights(self, path: Path) -> None:
        """Read what `save_weights` wrote, instead of calling `fit`. Raises WeightsError for another encoder's file."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    @abstractmethod
    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, D) of contact depths (N, H, W) in metres, all cut at one press depth."""

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return embeddings (N, D) of contact depths (N, H, W), metres, of which pixels `seen` (N, H, W) are known, and
        weights (N, D), 0 to 1: how far each number of an embedding is known. Both are float32.

        A grid of places compares touches by this, since a sensor's field ends; the matcher is given the weights. Where
        all is seen, embeddings are those of `encode` and weights are one. By default, what is not seen is out of
        contact, and all weights are one: override it where that is a poor guess.
        """
        embeddings = self.encode(np.where(seen, depth_m, np.float32(press_depth_m)), press_depth_m, geometry)
        return embeddings, np.ones_like(embeddings)
