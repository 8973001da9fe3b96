"""Slope from colour, pixel by pixel, then height by integration: learned from a few dozen presses of a ball.

Photometric stereo with the light measured instead of modelled, after Johnson and Adelson (CVPR 2009); that a small
network is enough for it, and needs few presses, is Wang et al.'s finding (GelSight Wedge, ICRA 2021). Slopes become
heights by Poisson integration, and the drift is taken out where the gel is untouched.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import nn

from tactile_loc.calibration.estimator import (
    DIFFERENCE,
    FIXED,
    CalibrationProblem,
    GelEstimator,
    colour_difference,
    fixed_features,
    load_network,
    save_network,
)
from tactile_loc.calibration.labels import Float32, Image
from tactile_loc.calibration.surface import integrate
from tactile_loc.core.errors import CalibrationError, TrainingError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.slots.component import ComponentOptions

ROUNDS = 3
DRIFT_M = 2.5e-3  # drift is smooth over this distance: standard deviation of a Gaussian
TOUCHED_M = 4e-5  # an indentation of this depth is not drift
TOUCHED_SLOPE = 0.05  # nor is a surface of this slope; the walls of a light press of a flat face have about 0.1
RISING_SLOPE = 0.02  # a flat part up to which its border rises by this is a plateau, not untouched
SMOOTHING_M = 1.2e-4  # of the slope, in deciding where the gel is touched
NOISES = 4.0  # medians of the magnitude: what is beyond is no noise
LEAST_UNTOUCHED = 0.05  # of the image
COARSE_PX = 80  # longer image side on which drift is estimated
SMOOTHINGS_PX = (1.0, 3.0)  # of the colour difference: against noise, and to see a little of what is around
FEATURES = DIFFERENCE * len(SMOOTHINGS_PX) + FIXED
OUTLIER_RAD = 0.1  # an error of the angle from which on it counts by its size, not its square
STEPS_A_PRESS, MOST_STEPS = 100, 5000
PIXELS_AT_ONCE = 1 << 16
REPORT_EVERY = 50  # steps


def indentation_from_slopes(slope: NDArray[np.floating], geometry: SensorGeometry) -> Float32:
    """Return the indentation (H, W), metres, of one surface of slopes (H, W, 2), zero where the gel is untouched.

    Small errors of the slopes add up to a slow drift of the surface, deeper than a light imprint. Where the gel is
    untouched the drift is seen as it is; there it is smoothed and, under the imprint, continued. Touched is what is
    steep or, once most of the drift is gone, deep, and what that encloses: the flat middle of an imprint. One that
    reaches over the image's border is told from the untouched gel beside it by the side on which the steep is higher.
    """
    surface = integrate(slope, geometry)
    steepness = _steepness(slope, geometry)
    steep = steepness > _threshold(steepness, TOUCHED_SLOPE)
    touched = _filled(steep)
    touched |= _plateaus(touched, slope)
    for _ in range(ROUNDS):
        surface = surface - _drift(surface, ~touched, geometry)
        away = np.abs(surface)
        touched = _filled(steep | (away > _threshold(away[~touched], TOUCHED_M)))
    return surface.astype(np.float32)


def _filled(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What is marked (H, W), and what it encloses: a quarter of the time of scipy's binary_fill_holes."""
    from scipy.ndimage import label

    parts, count = label(~marked)
    outside = np.zeros(count + 1, bool)
    for border in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        outside[border] = True
    return marked | ~outside[parts]


def _plateaus(steep: NDArray[np.bool_], slope: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Parts (H, W) of the flat rest up to which the steep pixels (H, W) rise; none when no untouched gel were left."""
    from scipy.ndimage import label

    parts, count = label(~steep)
    rise, pixels = np.zeros(count + 1), np.zeros(count + 1)
    for along, before, after in (
        (slope[..., 0], np.s_[:, :-1], np.s_[:, 1:]),
        (slope[..., 1], np.s_[:-1, :], np.s_[1:, :]),
    ):
        for flat, rim, sign in ((before, after, -1), (after, before, 1)):
            edge = (parts[flat] > 0) & steep[rim]
            rise += sign * np.bincount(parts[flat][edge], along[rim][edge], count + 1)
            pixels += np.bincount(parts[flat][edge], minlength=count + 1)
    plateaus = (rise > RISING_SLOPE * pixels)[parts]
    untouched = ~(steep | plateaus)
    return np.asarray(plateaus & (untouched.mean() > LEAST_UNTOUCHED))


def _steepness(slope: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.float64]:
    """The slope's magnitude (H, W), unitless, its noise smoothed away."""
    from scipy.ndimage import gaussian_filter

    sigma = SMOOTHING_M / geometry.pixel_pitch_m
    return np.asarray(np.hypot(*(gaussian_filter(slope[..., i], sigma) for i in (0, 1))))


def _threshold(values: NDArray[np.float64], least: float) -> float:
    """What stands out among magnitudes of which most are noise: at least `least`; a quarter tells the median."""
    return max(least, NOISES * float(np.median(values.ravel()[::4])) if values.size else least)


def _drift(
    surface_m: NDArray[np.float64], untouched: NDArray[np.bool_], geometry: SensorGeometry
) -> NDArray[np.float64]:
    """The smooth surface (H, W), metres, through the untouched pixels (H, W), continued where there are none."""
    step = max(1, round(max(geometry.shape) / COARSE_PX))
    sigma = DRIFT_M / (step * geometry.pixel_pitch_m)
    weight = untouched.astype(float)
    seen, weights = (_blocks(a, step) for a in (surface_m * weight, weight))
    down, across = (_smoothing(blocks, sigma) for blocks in seen.shape)
    coarse = (down @ seen @ across.T) / np.maximum(down @ weights @ across.T, 1e-9)
    height, width = surface_m.shape
    rows, columns = (
        _between(blocks, step, pixels) for blocks, pixels in zip(coarse.shape, (height, width), strict=True)
    )
    return rows @ coarse @ columns.T


@lru_cache(maxsize=8)
def _smoothing(blocks: int, sigma: float) -> NDArray[np.float64]:
    """Weights (blocks, blocks) of a Gaussian of `sigma` blocks; beyond the borders they go on."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(np.eye(blocks), sigma, axis=0, mode="nearest", truncate=6))


@lru_cache(maxsize=8)
def _between(blocks: int, step: int, pixels: int) -> NDArray[np.float64]:
    """Weights (pixels, blocks) that interpolate linearly between the middles of blocks; constant beyond the last."""
    middles = (np.arange(blocks) + 0.5) * step - 0.5
    return np.stack([np.interp(np.arange(pixels), middles, one) for one in np.eye(blocks)], axis=1)


def _blocks(image: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Mean of blocks of `step` x `step` pixels of (H, W); the last rows and columns are repeated to fill them."""
    height, width = image.shape
    padded = np.pad(image, [(0, -height % step), (0, -width % step)], mode="edge")
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    return np.asarray(blocks.mean(axis=(1, 3)))


class SlopeNetwork(nn.Module):
    """Slopes (N, 2) of features (N, FEATURES): a linear map, which carries on beyond what was seen, and the rest."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.linear = nn.Linear(FEATURES, 2)
        layers = [nn.Linear(FEATURES, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, 2)]
        self.bent = nn.Sequential(*layers)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return slopes (N, 2), unitless."""
        slopes: torch.Tensor = self.linear(features) + self.bent(features)
        return slopes


class PhotometricEstimator(GelEstimator):
    """A network a pixel: from colour difference, background and place to slope; the slopes are integrated."""

    name = "photometric"

    class Options(ComponentOptions):
        """How the network is made and trained."""

        hidden: int = Field(default=48, ge=4, le=512, description="units of each of the two hidden layers")
        steps: int | None = Field(
            default=None, ge=1, description="training steps; by default 100 a press, at most 5000"
        )
        pixels: int = Field(default=4096, ge=64, description="pixels a step")
        rate: float = Field(default=3e-3, gt=0, description="learning rate at its highest")
        untouched: float = Field(
            default=0.5, ge=0, le=10, description="untouched pixels learned from, a pixel of contact"
        )
        seed: int = Field(default=0, ge=0, description="of all that is drawn in training")

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        super().__init__(geometry, background, options)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed)
            self._network = SlopeNetwork(self.options.hidden)
        self._fixed = fixed_features(background, geometry)

    def fit(self, problem: CalibrationProblem) -> None:
        """Learn the slope of pixels in contact and of some untouched ones. Raises CalibrationError, TrainingError."""
        features, slopes = self._samples(problem)
        angles = slopes.atan()
        generator = torch.Generator().manual_seed(self.options.seed)
        optimizer = torch.optim.AdamW(self._network.parameters(), self.options.rate, weight_decay=1e-3)
        steps = self.options.steps or min(STEPS_A_PRESS * len(problem.presses), MOST_STEPS)
        with problem.progress.task("learning slope from colour", steps) as advance:
            for step in range(steps):
                for group in optimizer.param_groups:
                    group["lr"] = self.options.rate * 0.5 * (1.003 + math.cos(math.pi * step / steps))
                chosen = torch.randint(len(features), (self.options.pixels,), generator=generator)
                off_rad = self._network(features[chosen]).atan() - angles[chosen]
                loss = nn.functional.huber_loss(off_rad, torch.zeros_like(off_rad), delta=OUTLIER_RAD)
                if not math.isfinite(float(loss.detach())):
                    raise TrainingError("the loss became NaN; lower the estimator's rate")
                optimizer.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
                if step % REPORT_EVERY == 0:
                    mean_rad = float(off_rad.detach().abs().mean())
                    problem.progress.note(f"mean error of the angle {math.degrees(mean_rad):.2f}°")
                advance(1)

    def slopes(self, image: Image) -> Float32:
        """Return the slope (H, W, 2) of the gel's surface along x and y, unitless."""
        pixels = torch.from_numpy(self._features(image).reshape(-1, FEATURES))
        with torch.inference_mode():
            parts = [self._network(part) for part in torch.split(pixels, PIXELS_AT_ONCE)]
        return torch.cat(parts).numpy().reshape(*image.shape[:2], 2)

    def indentation(self, image: Image) -> Float32:
        """Return how far the gel is pressed in (H, W), metres, about 0 where it is untouched."""
        return self.read(image)[0]

    def read(self, image: Image) -> tuple[Float32, Float32]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless, that it comes from."""
        slopes = self.slopes(image)
        return indentation_from_slopes(slopes, self.geometry), slopes

    def save(self, path: Path) -> None:
        """Write the network to a safetensors file."""
        save_network(self._network, path)

    def load(self, path: Path) -> None:
        """Read the network. Raises WeightsError when the file is damaged or of another estimator."""
        load_network(self._network, path, self.name)

    def _features(self, image: Image) -> Float32:
        from scipy.ndimage import gaussian_filter

        planes = np.ascontiguousarray(np.moveaxis(colour_difference(image, self.untouched), -1, 0))  # twice as fast
        smooth = [gaussian_filter(planes, (0, s, s), mode="nearest", truncate=3) for s in SMOOTHINGS_PX]
        return np.concatenate([np.moveaxis(np.concatenate(smooth), 0, -1), self._fixed], axis=-1)

    def _samples(self, problem: CalibrationProblem) -> tuple[torch.Tensor, torch.Tensor]:
        """Features (P, FEATURES) and slopes (P, 2) of all known pixels in contact and of some without."""
        rng = np.random.default_rng(self.options.seed)
        features, slopes, touched = [], [], 0
        for image, label in problem.presses.presses():
            inside = label.contact & label.known
            touched += int(inside.sum())
            outside = np.flatnonzero(label.known & ~label.contact)
            wanted = int(self.options.untouched * max(int(inside.sum()), 1000))
            chosen = inside.ravel()
            chosen[rng.permutation(outside)[:wanted]] = True
            features.append(self._features(image).reshape(-1, FEATURES)[chosen])
            slopes.append(label.slope.reshape(-1, 2)[chosen])
        if not touched:
            raise CalibrationError("no press shows any contact; a calibration needs presses of known shape")
        return torch.from_numpy(np.concatenate(features)), torch.from_numpy(np.concatenate(slopes))
