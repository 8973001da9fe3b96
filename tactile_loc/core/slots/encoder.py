"""The encoder slot: vectors of contact shapes, and what an encoder may learn from."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.slots.component import Component, Float32
from tactile_loc.core.slots.grid import GridSampler
from tactile_loc.core.slots.scene import Scene


class Checkpoints:
    """Where a training keeps its state, so that it can go on after an interruption. This one forgets everything."""

    def load(self) -> Path | None:
        """Return the file that was saved last and is intact, or None."""
        return None

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the saved file, atomically, by what `write(path)` writes."""


@dataclass(frozen=True, eq=False)
class TrainingProblem:
    """What an encoder may learn from, all of it simulation.

    `grid` and `shapes`, the contact depths (S, H, W) in metres of its poses at full press, shard by shard in its order;
    fresh poses from `sampler`, rendered through `scene`.
    """

    grid: PoseGrid
    scene: Scene
    sampler: GridSampler
    shapes: Callable[[], Iterable[Float32]]
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)


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
