"""Estimates the indentation from the whole image by six convolutions, after Bauza et al. (CoRL 2020), "the paper".

Adam trains the network on random crops of images, usually of simulated presses. The paper's loss is the RMS error of
the indentation. Here, the RMS error of the indentation's square root is added to the loss. This term improves the
border of contacts whose rounded rim rises slowly.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

from tactile_loc.core.runtime.errors import CalibrationError, TrainingError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Float32, Image, LabelledPresses
from tactile_loc.sensors.reading.estimator import PLANES, GelEstimator, stack_features
from tactile_loc.slots.encoder import Checkpoints

Dilation = Annotated[int, Field(ge=1, le=256)]

log = logging.getLogger(__name__)

ON_CONTACT = 0.75  # share of crops that are chosen to show contact; the untouched gel is easy to learn
EDGE_WEIGHT = 0.9  # weight of the square root's error in the loss
EDGE_SHARE = 5e-3  # share of the maximal depth that is added before the square root, to limit the root's derivative
LEAST_STD = 1e-3  # least standard deviation for the normalisation of an input, so that constant inputs stay small


class GelNetwork(nn.Module):
    """Maps features (N, PLANES, H, W) to normalised indentations (N, H, W).

    The buffers hold the means and standard deviations of features and indentations.

    This is the paper's network: five convolutions of 3 x 3 pixels with ReLU, dropout, and one convolution of 1 x 1.
    Without dilation, each output depends on 11 x 11 px. This is too small an area in the middle of a flat contact,
    because only the contact's edge differs from the untouched gel. With the default dilations, each output depends on
    63 x 63 px, at the same cost.
    """

    input_mean: torch.Tensor
    input_std: torch.Tensor
    output_mean: torch.Tensor
    output_std: torch.Tensor

    def __init__(self, channels: int, dilations: tuple[int, ...], dropout: float) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for number, step in enumerate(dilations):
            planes = channels if number else PLANES
            layers += [nn.Conv2d(planes, channels, 3, padding=step, dilation=step), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Dropout(dropout), nn.Conv2d(channels, 1, 1))
        self.register_buffer("input_mean", torch.zeros(PLANES, 1, 1))
        self.register_buffer("input_std", torch.ones(PLANES, 1, 1))
        self.register_buffer("output_mean", torch.zeros(()))
        self.register_buffer("output_std", torch.ones(()))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return normalised indentations (N, H, W) for features (N, PLANES, H, W)."""
        scaled = (features - self.input_mean) / self.input_std
        found: torch.Tensor = self.layers(scaled.contiguous(memory_format=torch.channels_last))  # twice as fast
        return found[:, 0]

    def predict_m(self, features: torch.Tensor) -> torch.Tensor:
        """Return indentations (N, H, W), metres, at least 0, for features (N, PLANES, H, W)."""
        return (self(features) * self.output_std + self.output_mean).clamp(min=0)


@dataclass(frozen=True, eq=False)
class Samples:
    """The training presses, in memory.

    `images` (N, H, W, 3) show the presses. `shares` (N, H, W) are the indentations divided by `deepest_m`, the
    sensor's maximal depth in metres. `background` (H, W, 3) is the image of the untouched gel. `fixed` (H, W, FIXED)
    are the features that no touch changes. `observed` (H, W) marks the pixels that the sensor observes.
    """

    images: NDArray[np.uint8]
    shares: NDArray[np.float16]
    background: NDArray[np.uint8]
    fixed: NDArray[np.float32]
    observed: NDArray[np.bool_]
    deepest_m: float

    @classmethod
    def of(cls, presses: LabelledPresses, fixed: NDArray[np.float32], progress: Progress) -> Samples:
        """Load presses. Raises CalibrationError when no press shows contact."""
        geometry, deepest_m = presses.geometry, presses.geometry.max_depth_m
        images = np.empty((len(presses), *geometry.shape, 3), np.uint8)
        shares = np.empty(images.shape[:3], np.float16)
        with progress.task("reading presses", len(images)) as advance:
            for number, (image, label) in enumerate(presses.read_presses()):
                images[number], shares[number] = image, label.indentation_m / np.float32(deepest_m)
                advance(1)
        if not shares[:, geometry.observed_mask].any():
            raise CalibrationError("no press is in contact with the gel; check the poses or circles of the presses")
        return cls(images, shares, presses.background, fixed, geometry.observed_mask, deepest_m)

    def draw_crops(
        self, chosen: NDArray[np.int64], rng: np.random.Generator, crop_px: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Draw a random crop from each of the `chosen` presses (B,).

        Return features (B, PLANES, h, w), indentations (B, h, w), metres, and observed pixels (B, h, w). Crops are
        neither rotated nor mirrored, because the lamps have fixed directions.
        """
        parts = [self._cut(press, *self._draw_window(press, rng, crop_px)) for press in chosen]
        seen, indentation_m, observed = (torch.from_numpy(np.stack(part)) for part in zip(*parts, strict=True))
        return seen.permute(0, 3, 1, 2), indentation_m, observed

    def _draw_window(self, press: int, rng: np.random.Generator, crop_px: int) -> tuple[slice, slice]:
        """Return the rows and columns of a random crop.

        If the press has contact, at least a share ON_CONTACT of its crops contain a pixel in contact.
        """
        sides = np.minimum(crop_px, self.observed.shape)
        last = self.observed.shape - sides
        start = rng.integers(last + 1)
        touched = np.argwhere(self.shares[press] > 0)
        if len(touched) and rng.random() < ON_CONTACT:
            start = np.clip(touched[rng.integers(len(touched))] - rng.integers(sides), 0, last)
        (top, left), (bottom, right) = start, start + sides
        return slice(top, bottom), slice(left, right)

    def _cut(self, press: int, rows: slice, columns: slice) -> tuple[NDArray[np.float32], ...]:
        """Return features (h, w, PLANES), indentation (h, w), metres, and observed pixels (h, w) of a press's crop."""
        place = rows, columns
        seen = stack_features(self.images[press][place], self.background[place], self.fixed[place])
        indentation_m = self.shares[press][place].astype(np.float32) * np.float32(self.deepest_m)
        return seen, indentation_m, self.observed[place].astype(np.float32)

    def normalise(self, network: GelNetwork) -> None:
        """Set a network's statistics to those of the observed pixels of all presses."""
        whole = slice(None)
        sums = np.zeros((2, 3 + self.fixed.shape[-1] + 1))
        for press in range(len(self.images)):
            seen, indentation_m, _ = self._cut(press, whole, whole)
            values = np.concatenate([seen, indentation_m[..., None]], axis=-1)[self.observed].astype(np.float64)
            sums += np.stack([values.mean(axis=0), np.square(values).mean(axis=0)])
        mean, square = sums / len(self.images)
        std = np.sqrt(np.maximum(square - mean**2, 0))
        inputs = {"input_mean": mean[:-1], "input_std": np.maximum(std[:-1], LEAST_STD)}
        for name, value in {**inputs, "output_mean": mean[-1], "output_std": std[-1]}.items():
            buffer = getattr(network, name)
            buffer.copy_(torch.as_tensor(value, dtype=buffer.dtype).reshape(buffer.shape))


class CnnTrainer:
    """Trains a network on presses.

    The random numbers of an epoch depend only on the seed and the epoch's number. A resumed training therefore gives
    the same result as an uninterrupted training.
    """

    def __init__(
        self, recipe: CnnEstimator.Options, network: GelNetwork, samples: Samples, checkpoints: Checkpoints
    ) -> None:
        self.recipe, self.network, self.samples, self.checkpoints = recipe, network, samples, checkpoints
        self.optimizer = torch.optim.Adam(network.parameters(), recipe.rate)
        self.steps = -(-len(self.samples.images) // recipe.batch)
        self.epoch = 0

    def run(self, progress: Progress) -> None:
        """Train from the last checkpoint, if any, then set the network to evaluation mode.

        Raises TrainingError when the loss becomes NaN.
        """
        self.samples.normalise(self.network)
        self._resume()
        with progress.task("training the network", self.recipe.epochs) as advance:
            advance(self.epoch)
            while self.epoch < self.recipe.epochs:
                loss_m = self._train_epoch() * float(self.network.output_std)
                self.epoch += 1
                self._save_checkpoint()
                progress.note(f"RMS error {1e3 * loss_m:.4f} mm")
                log.info("epoch %d: RMS error %.4f mm", self.epoch, 1e3 * loss_m)
                advance(1)
        self.network.eval()

    def _train_epoch(self) -> float:
        """Train one epoch. Return the normalised RMS error. Raises TrainingError when the loss becomes NaN."""
        self.network.train()
        rng = np.random.default_rng([self.recipe.seed, self.epoch])
        losses = []
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(rng.integers(2**62)))  # for the dropout
            for step, chosen in enumerate(np.array_split(rng.permutation(len(self.samples.images)), self.steps)):
                losses.append(self._step(*self.samples.draw_crops(chosen, rng, self.recipe.crop_px), step))
                if not math.isfinite(losses[-1]):
                    raise TrainingError(
                        f"the loss became NaN in epoch {self.epoch + 1} of training; lower the estimator's rate"
                    )
        return math.sqrt(float(np.mean(np.square(losses))))

    def _step(self, features: torch.Tensor, indentation_m: torch.Tensor, observed: torch.Tensor, step: int) -> float:
        for group in self.optimizer.param_groups:
            group["lr"] = self._schedule_rate(self.epoch + step / self.steps)
        network = self.network
        found = network(features)
        rms = _rms(found - (indentation_m - network.output_mean) / network.output_std, observed)
        found_m = found * network.output_std + network.output_mean
        loss = rms + EDGE_WEIGHT * _rms(self._take_root(found_m) - self._take_root(indentation_m), observed)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        return float(rms.detach())

    def _take_root(self, indentation_m: torch.Tensor) -> torch.Tensor:
        """Return the square root of an indentation's share of the maximal depth, plus EDGE_SHARE under the root."""
        return (indentation_m.clamp(min=0) / self.samples.deepest_m + EDGE_SHARE).sqrt()

    def _schedule_rate(self, epochs_done: float) -> float:
        """Return the learning rate, which decreases along a cosine to a hundredth of the highest rate."""
        return self.recipe.rate * (0.505 + 0.495 * math.cos(math.pi * epochs_done / self.recipe.epochs))

    def _save_checkpoint(self) -> None:
        tensors = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        for number, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{number}.{k}": torch.as_tensor(v) for k, v in state.items()}
        copies = {k: v.detach().clone(memory_format=torch.contiguous_format) for k, v in tensors.items()}
        self.checkpoints.save(lambda path: save_file(copies, path, {"epoch": str(self.epoch)}))

    def _resume(self) -> None:
        path = self.checkpoints.load()
        if path is None:
            return
        with safe_open(path, framework="pt") as file:
            tensors = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118
            self.epoch = int(file.metadata()["epoch"])
        self.network.load_state_dict({k[8:]: v for k, v in tensors.items() if k.startswith("network.")})
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in tensors.items():
            if name.startswith("optimizer."):
                _, number, key = name.split(".")
                state.setdefault(int(number), {})[key] = tensor
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": state})
        log.info("resumed training after epoch %d", self.epoch)


def _rms(off: torch.Tensor, observed: torch.Tensor) -> torch.Tensor:
    """Return the root mean square of errors (B, h, w) at the observed pixels (B, h, w)."""
    return ((observed * off.square()).sum() / observed.sum().clamp(min=1) + 1e-12).sqrt()  # keeps the gradient finite


class CnnEstimator(GelEstimator):
    """Estimates the contact's indentation from colour difference, background and position by a convolutional network.

    The indentation is 0 outside the contact, even where the gel around the contact is pressed down, too.
    """

    name = "cnn"
    sees_skirt: ClassVar[bool] = False

    class Options(ComponentOptions):
        """The network and its training."""

        channels: int = Field(default=32, ge=1, le=512, description="channels of each of the five convolutions")
        dilations: tuple[Dilation, Dilation, Dilation, Dilation, Dilation] = Field(
            default=(1, 2, 4, 8, 16), description="dilations of the five convolutions, pixels"
        )
        dropout: float = Field(default=0.5, ge=0, lt=1, description="dropout after the fifth convolution, share")
        epochs: int = Field(default=30, ge=1, description="epochs, each over all presses")
        batch: int = Field(default=8, ge=1, description="presses in each training step")
        crop_px: int = Field(default=96, ge=8, description="side of the crops to train on, pixels")
        rate: float = Field(default=2e-3, gt=0, description="highest learning rate of Adam; the paper's is 1e-4")
        seed: int = Field(default=0, ge=0, description="seed of the training")

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        super().__init__(geometry, background, options)
        chosen = self.options
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(chosen.seed)
            self._network: GelNetwork = GelNetwork(chosen.channels, chosen.dilations, chosen.dropout).eval()

    def fit(self, presses: LabelledPresses, progress: Progress, checkpoints: Checkpoints) -> None:
        """Learn the contact's indentation at all observed pixels.

        Raises CalibrationError when no press shows contact, and TrainingError when the loss becomes NaN.
        """
        samples = Samples.of(presses, self._fixed, progress)
        CnnTrainer(self.options, self._network, samples, checkpoints).run(progress)

    def list_weights(self) -> Mapping[str, NDArray[np.generic]]:
        """Return the network's weights by name."""
        return {name: tensor.numpy() for name, tensor in self._network.state_dict().items()}

    def read(self, image: Image) -> tuple[Float32, None]:
        """Return the contact's indentation (H, W), metres, and None, because slopes are not estimated."""
        planes = stack_features(image, self.untouched, self._fixed)
        with torch.inference_mode():
            found = self._network.predict_m(torch.from_numpy(planes).permute(2, 0, 1)[None])
        return found[0].numpy(), None
