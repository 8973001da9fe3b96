"""Estimates the gel's slope from the colour of each pixel, and integrates the slopes to heights.

The network learns from a few dozen presses of a ball. The method is photometric stereo with measured instead of
modelled light, after Johnson and Adelson (CVPR 2009). Wang et al. (GelSight Wedge, ICRA 2021) found that a small
network and few presses are enough. Poisson integration gives the heights. The drift of the heights is estimated where
the gel is untouched, and subtracted.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from pydantic import Field
from scipy.ndimage import gaussian_filter
from torch import nn

from tactile_loc.core.runtime.errors import CalibrationError, TrainingError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Float32, Image, LabelledPresses
from tactile_loc.sensors.reading.estimator import DIFFERENCE, FIXED, GelEstimator, scale_difference
from tactile_loc.sensors.reading.surface import find_indentation
from tactile_loc.slots.encoder import Checkpoints

SMOOTHINGS_PX = (1.0, 3.0)  # Gaussian widths that smooth the colour difference: against noise, and for the surroundings
FEATURES = DIFFERENCE * len(SMOOTHINGS_PX) + FIXED
OUTLIER_RAD = 0.1  # error of the angle above which the loss is linear
STEPS_A_PRESS, MOST_STEPS = 100, 5000
PIXELS_AT_ONCE = 1 << 16
REPORT_EVERY = 50  # steps
LEAST_SLOPE = 0.02  # of the gel beside a contact; flatter pixels count as untouched


class SlopeNetwork(nn.Module):
    """Maps features (N, FEATURES) to slopes (N, 2) by a linear map, which extrapolates, plus a nonlinear correction."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.linear = nn.Linear(FEATURES, 2)
        layers = [nn.Linear(FEATURES, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, 2)]
        self.bent = nn.Sequential(*layers)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return slopes (N, 2), unitless, for features (N, FEATURES)."""
        slopes: torch.Tensor = self.linear(features) + self.bent(features)
        return slopes


class PhotometricEstimator(GelEstimator):
    """Estimates each pixel's slope from its colour difference, background and position, and integrates the slopes."""

    name = "photometric"

    class Options(ComponentOptions):
        """The network and its training."""

        hidden: int = Field(default=48, ge=4, le=512, description="units of each of the two hidden layers")
        steps: int | None = Field(
            default=None, ge=1, description="training steps; by default 100 for each press, at most 5000"
        )
        pixels: int = Field(default=4096, ge=64, description="pixels in each step")
        rate: float = Field(default=3e-3, gt=0, description="highest learning rate")
        untouched: float = Field(default=0.5, ge=0, le=10, description="untouched pixels for each pixel in contact")
        seed: int = Field(default=0, ge=0, description="seed of the training")

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        super().__init__(geometry, background, options)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            self._network: SlopeNetwork = SlopeNetwork(self.options.hidden)

    def fit(self, presses: LabelledPresses, progress: Progress, checkpoints: Checkpoints) -> None:
        """Learn the slopes of the pixels in contact and of some untouched pixels.

        Raises CalibrationError when no press shows contact, and TrainingError when the loss becomes NaN.
        """
        features, slopes = self._collect_samples(presses)
        angles = slopes.atan()
        generator = torch.Generator().manual_seed(self.options.seed)
        optimizer = torch.optim.AdamW(self._network.parameters(), self.options.rate, weight_decay=1e-3)
        steps = self.options.steps or min(STEPS_A_PRESS * len(presses), MOST_STEPS)
        with progress.task("learning slope from colour", steps) as advance:
            for step in range(steps):
                for group in optimizer.param_groups:
                    group["lr"] = self.options.rate * 0.5 * (1.003 + math.cos(math.pi * step / steps))
                chosen = torch.randint(len(features), (self.options.pixels,), generator=generator)
                off_rad = self._network(features[chosen]).atan() - angles[chosen]
                loss = nn.functional.huber_loss(off_rad, torch.zeros_like(off_rad), delta=OUTLIER_RAD)
                if not math.isfinite(float(loss.detach())):
                    raise TrainingError(f"the loss became NaN in step {step + 1}; lower the estimator's rate")
                optimizer.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
                if step % REPORT_EVERY == 0:
                    mean_rad = float(off_rad.detach().abs().mean())
                    progress.note(f"mean error of the angle {math.degrees(mean_rad):.2f}°")
                advance(1)

    def estimate_slopes(self, image: Image) -> Float32:
        """Return the slopes (H, W, 2) of the gel's surface along x and y, unitless."""
        pixels = torch.from_numpy(self._stack_features(image).reshape(-1, FEATURES))
        with torch.inference_mode():
            parts = [self._network(part) for part in torch.split(pixels, PIXELS_AT_ONCE)]
        return torch.cat(parts).numpy().reshape(*image.shape[:2], 2)

    def read(self, image: Image) -> tuple[Float32, Float32]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless, that were integrated."""
        slopes = self.estimate_slopes(image)
        return find_indentation(slopes, self.geometry), slopes

    def _stack_features(self, image: Image) -> Float32:
        planes = np.ascontiguousarray(np.moveaxis(scale_difference(image, self.untouched), -1, 0))  # twice as fast
        smooth = [gaussian_filter(planes, (0, s, s), mode="nearest", truncate=3) for s in SMOOTHINGS_PX]
        return np.concatenate([np.moveaxis(np.concatenate(smooth), 0, -1), self._fixed], axis=-1)

    def _collect_samples(self, presses: LabelledPresses) -> tuple[torch.Tensor, torch.Tensor]:
        """Return features (P, FEATURES) and slopes (P, 2) of the training pixels.

        These are all pixels with a known label that are in contact or slope, and some other pixels.
        """
        rng = np.random.default_rng(self.options.seed)
        features, slopes, touched = [], [], 0
        for image, label in presses.read_presses():
            slopes_visibly = np.hypot(label.slope[..., 0], label.slope[..., 1]) > LEAST_SLOPE
            inside = label.known & (label.contact | slopes_visibly)
            touched += int((label.known & label.contact).sum())
            outside = np.flatnonzero(label.known & ~inside)
            wanted = int(self.options.untouched * max(int(inside.sum()), 1000))
            chosen = inside.ravel()
            chosen[rng.permutation(outside)[:wanted]] = True
            features.append(self._stack_features(image).reshape(-1, FEATURES)[chosen])
            slopes.append(label.slope.reshape(-1, 2)[chosen])
        if not touched:
            raise CalibrationError("no press is in contact with the gel; check the poses or circles of the presses")
        return torch.from_numpy(np.concatenate(features)), torch.from_numpy(np.concatenate(slopes))
