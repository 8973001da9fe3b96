"""The encoder slot: embeddings of contact shapes, and the training data of an encoder."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Ints
from tactile_loc.core.places.places import CAMERA, cut_patches
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.slots.component import Component


class Checkpoints:
    """Storage for the state of a training run, so that the run can resume after an interruption.

    This base class stores nothing.
    """

    def load(self) -> Path | None:
        """Return the last intact file that was saved, or None if there is no such file."""
        return None

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the saved file atomically with the file that `write(path)` writes."""


@dataclass(frozen=True, eq=False)
class TrainingBatch:
    """B noisy touches with labels.

    `depth_m` (B, H, W) are contact depths, metres, cut at the press depths `press_m` (B,). `seen` (B, H, W) marks the
    pixels that the sensor observes. `labels` (B,) are the numbers of the keys nearest to the true poses.
    """

    depth_m: Float32
    seen: Bools
    press_m: Floats
    labels: Ints

    def __len__(self) -> int:
        return len(self.labels)


class TrainingTouches(ABC):
    """Simulated touches with known poses. They are rendered once, and each batch adds new noise."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of touches."""

    @abstractmethod
    def batch(self, count: int, rng: np.random.Generator, press_m: float) -> TrainingBatch:
        """Draw `count` different touches, for comparison with keys that are cut at `press_m` metres."""


class TrainingProblem(ABC):
    """The simulated training data of an encoder: touches, and one key for each pose or place that is searched.

    `partly_seen` is True if a touch shows only a part of its key. The touches are then encoded with
    `Encoder.encode_seen`. The encoder reports its progress to `progress` and resumes from `checkpoints`.
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
    def key_presses_m(self) -> Floats:
        """The press depths (P,), metres, at which keys may be cut. A touch is compared with keys of one press depth."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of keys."""

    @abstractmethod
    def clean_keys(self, press_m: float) -> Iterable[Float32]:
        """Yield the keys' complete contact depths, metres, without noise, cut at `press_m`, in shards (S, H, W).

        S is at least one.
        """

    @abstractmethod
    def draw(self, count: int, noise: TouchNoise, rng: np.random.Generator) -> TrainingTouches:
        """Render `count` touches at random poses. The batches of these touches add `noise`."""

    @abstractmethod
    def key_distances(self, first: Ints, second: Ints) -> Floats:
        """Return the pose distances (K,), metres, between keys `first` (K,) and keys `second` (K,)."""


class Encoder(Component):
    """Maps contact shapes to vectors. Contact shapes of similar poses get vectors at a small Euclidean distance."""

    slot = "encoder"

    def fit(self, problem: TrainingProblem) -> None:
        """Train on simulated touches. Does nothing unless the encoder needs training."""

    def save_weights(self, path: Path) -> None:
        """Write the trained weights to a safetensors file. Raises NotImplementedError if there is no training."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    def load_weights(self, path: Path) -> None:
        """Read the file of `save_weights` instead of calling `fit`. Raises WeightsError if another encoder wrote it."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    @abstractmethod
    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, D) of contact depths (N, H, W), metres, that are all cut at one press depth."""

    def encode_seen(
        self, depth_m: Float32, seen: Bools, press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return embeddings and weights, each (N, D) float32, of contact depths (N, H, W), metres, known in part.

        `seen` (N, H, W) marks the known pixels. A weight, 0 to 1, is the known share of one number of an embedding; the
        matcher gets the weights. Grids of places use this method, because a sensor sees only a part of a place's
        surroundings. If all pixels are seen, the embeddings equal those of `encode`, and the weights are one.

        By default, unseen pixels count as out of contact, and all weights are one. Override the method if this does not
        suit the encoder.
        """
        embeddings = self.encode(np.where(seen, depth_m, np.float32(press_depth_m)), press_depth_m, geometry)
        return embeddings, np.ones_like(embeddings)

    def encode_patches(self, patches: NDArray[np.uint8], press_depth_m: float) -> Float32:
        """Return the embeddings (N, D) of places' patches (N, PATCH_PX, PATCH_PX), cut at a press depth in metres.

        By default, this is `encode` of the patches' contact depths, as the camera of `Places` sees them. All places are
        encoded again at each press depth. Override the method if the encoder can do this faster, with equal results.
        """
        return self.encode(cut_patches(patches, press_depth_m), press_depth_m, CAMERA)
