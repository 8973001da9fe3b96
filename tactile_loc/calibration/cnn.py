"""Depth from the whole image: six convolutions, as in Bauza et al. (CoRL 2020), learned from many simulated presses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import nn

from tactile_loc.calibration.cnn_training import CnnTrainer, Recipe
from tactile_loc.calibration.colour import FEATURES, features, fixed_features
from tactile_loc.calibration.estimator import CalibrationProblem, GelEstimator, Image
from tactile_loc.calibration.networks import load_network, save_network
from tactile_loc.core.interfaces import ComponentOptions
from tactile_loc.core.sensing import SensorGeometry

Float32 = NDArray[np.float32]

PLANES = FEATURES

Dilation = Annotated[int, Field(ge=1, le=256)]


class GelNetwork(nn.Module):
    """From features (N, PLANES, H, W) to indentation (N, H, W), both normalised by the statistics in its buffers.

    The paper's network: five convolutions of 3 x 3 pixels with ReLU, dropout, one of 1 x 1. Plain ones would see 11 px:
    in the middle of a flat contact nothing of its edge, which alone tells it from untouched gel. The dilated ones that
    are the default see 63 px at the same cost.
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
        """Return normalised indentations (N, H, W) of features (N, PLANES, H, W)."""
        scaled = (features - self.input_mean) / self.input_std
        found: torch.Tensor = self.layers(scaled.contiguous(memory_format=torch.channels_last))  # twice as fast
        return found[:, 0]

    def metres(self, features: torch.Tensor) -> torch.Tensor:
        """Return indentations (N, H, W) in metres, at least 0."""
        return (self(features) * self.output_std + self.output_mean).clamp(min=0)


class CnnEstimator(GelEstimator):
    """A convolutional network: from colour difference, background and place to the indentation of the contact.

    It is 0 where nothing touches, also where the gel hangs down around the contact.
    """

    name = "cnn"
    sees_skirt: ClassVar[bool] = False

    class Options(ComponentOptions):
        """How the network is made and trained."""

        channels: int = Field(default=32, ge=1, le=512, description="channels of each of the five convolutions")
        dilations: tuple[Dilation, Dilation, Dilation, Dilation, Dilation] = Field(
            default=(1, 2, 4, 8, 16), description="of the five convolutions, in pixels"
        )
        dropout: float = Field(default=0.5, ge=0, lt=1, description="share of the fifth convolution that is dropped")
        epochs: int = Field(default=30, ge=1, description="how often every press is learned from")
        batch: int = Field(default=8, ge=1, description="presses a training step")
        crop_px: int = Field(default=96, ge=8, description="side of the part of an image that is learned from, pixels")
        rate: float = Field(
            default=2e-3, gt=0, description="learning rate of Adam, at its highest; the paper's is 1e-4"
        )
        seed: int = Field(default=0, ge=0, description="of all that is drawn in training")

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        super().__init__(geometry, background, options)
        chosen = self.options
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(chosen.seed)
            self._network = GelNetwork(chosen.channels, chosen.dilations, chosen.dropout).eval()
        self._fixed = fixed_features(background, geometry)

    def fit(self, problem: CalibrationProblem) -> None:
        """Learn the contact's indentation at all observed pixels. Raises CalibrationError, TrainingError."""
        chosen = self.options
        recipe = Recipe(chosen.epochs, chosen.batch, chosen.crop_px, chosen.rate, chosen.seed)
        CnnTrainer(recipe, problem, self._network, self._fixed).run()

    def indentation(self, image: Image) -> Float32:
        """Return how far the gel is pressed in by the contact (H, W), metres, 0 outside of it."""
        planes = features(image, self.background, self._fixed)
        with torch.inference_mode():
            found = self._network.metres(torch.from_numpy(planes).permute(2, 0, 1)[None])
        return found[0].numpy()

    def save(self, path: Path) -> None:
        """Write the network, with the statistics that it normalises by, to a safetensors file."""
        save_network(self._network, path)

    def load(self, path: Path) -> None:
        """Read the network. Raises WeightsError when the file is damaged or of another estimator."""
        load_network(self._network, path, self.name)
