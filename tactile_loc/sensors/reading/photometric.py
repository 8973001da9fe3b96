"""Estimates the gel's slope from the colour of each pixel, and integrates the slopes to the gel's indentation.

The network learns from a few dozen presses of a ball. The method is photometric stereo with measured instead of
modelled light, after Johnson and Adelson (CVPR 2009). Wang et al. (GelSight Wedge, ICRA 2021) found that a small
network and few presses are enough. Poisson integration gives the heights. The drift of the heights is estimated where
the gel is untouched, and subtracted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from scipy.ndimage import gaussian_filter

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.compiled import use_one_blas_thread
from tactile_loc.core.runtime.errors import CalibrationError, TrainingError, WeightsError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Image, PressLabel
from tactile_loc.sensors.reading.surface import find_indentation
from tactile_loc.slots.options import validate_options

SMOOTHINGS_PX = (1.0, 3.0)  # Gaussian widths that smooth the colour difference: against noise, and for the surroundings
FIXED = 5  # number of features that no touch changes
FEATURES = 3 * len(SMOOTHINGS_PX) + FIXED
COLOUR_STEP = 64.0  # colour difference that is scaled to 1, counts of 255
BACKGROUND_M = 2e-4  # standard deviation of the smoothing that removes the background's grain
OUTLIER_RAD = 0.1  # error of the angle above which the loss is linear
STEPS_A_PRESS, MOST_STEPS = 150, 7500
BETAS, DECAY = (0.9, 0.999), 1e-3  # of AdamW: the means' memory, and the weights' decay
REPORT_EVERY = 50  # steps
LEAST_SLOPE = 0.02  # of the gel beside a contact; flatter pixels count as untouched
SEAM_PX = 20.0  # distance from a seam of two presses up to which pixels count


@dataclass(frozen=True)
class EstimatorRecipe:
    """How to learn an estimator: its options by name, and the seed that draws the held-out presses."""

    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


class SlopeNetwork:
    """Maps features (N, FEATURES) to slopes (N, 2) by a linear map, which extrapolates, plus a nonlinear correction.

    The correction has two hidden layers of tanh units. `weights` are the weights by name, as views of one vector. The
    network is trained without torch, because a step on a thousand pixels takes half the time in numpy.
    """

    def __init__(self, hidden: int, rng: np.random.Generator) -> None:
        layers = (
            ("linear", FEATURES, 2),
            ("bent.0", FEATURES, hidden),
            ("bent.2", hidden, hidden),
            ("bent.4", hidden, 2),
        )
        self._shapes: dict[str, tuple[int, ...]] = {}
        for name, inputs, outputs in layers:
            self._shapes |= {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
        self._values = np.zeros(sum(math.prod(shape) for shape in self._shapes.values()), np.float32)
        self.weights = self._divide(self._values)
        for name, inputs, outputs in layers[1:3]:  # the others start at zero, and so do the slopes
            bound = 1 / math.sqrt(inputs)
            self.weights[f"{name}.weight"][:] = rng.uniform(-bound, bound, (outputs, inputs))
            self.weights[f"{name}.bias"][:] = rng.uniform(-bound, bound, outputs)

    def predict(self, features: Float32) -> Float32:
        """Return slopes (N, 2), unitless, for features (N, FEATURES)."""
        return self._run(features)[0]

    def train(self, draw: Callable[[], tuple[Float32, Float32]], rates: Iterable[float]) -> Iterator[Float32]:
        """Train with AdamW, one step for each learning rate. Yield the errors of the angles (P, 2), radians.

        `draw` returns features (P, FEATURES) and angles (P, 2), radians. Raises TrainingError when an error is NaN.
        """
        values, mean, square = self._values, np.zeros_like(self._values), np.zeros_like(self._values)
        gradient = np.zeros_like(values)
        parts = self._divide(gradient)
        for step, rate in enumerate(rates, 1):
            features, angles = draw()
            slopes, first, second = self._run(features)
            off_rad = np.arctan(slopes) - angles
            if not math.isfinite(float(off_rad.sum())):
                raise TrainingError(f"the loss became NaN in step {step}; lower the estimator's rate")
            back = np.clip(off_rad, -OUTLIER_RAD, OUTLIER_RAD) / (1 + slopes**2) / np.float32(off_rad.size)
            deeper = (back @ self.weights["bent.4.weight"]) * (1 - second**2)
            deepest = (deeper @ self.weights["bent.2.weight"]) * (1 - first**2)
            layers = {"linear": (back, features), "bent.0": (deepest, features)}
            layers |= {"bent.2": (deeper, first), "bent.4": (back, second)}
            for name, (errors, inputs) in layers.items():
                np.matmul(errors.T, inputs, out=parts[f"{name}.weight"])
                errors.sum(axis=0, out=parts[f"{name}.bias"])
            mean += (1 - BETAS[0]) * (gradient - mean)
            square += (1 - BETAS[1]) * (gradient**2 - square)
            width = np.sqrt(square / np.float32(1 - BETAS[1] ** step)) + np.float32(1e-8)
            values *= np.float32(1 - rate * DECAY)
            values -= np.float32(rate / (1 - BETAS[0] ** step)) * mean / width
            yield off_rad

    def _divide(self, vector: Float32) -> dict[str, Float32]:
        """Return views of a vector as weights by name."""
        ends = np.cumsum([math.prod(shape) for shape in self._shapes.values()])[:-1]
        parts = zip(self._shapes.items(), np.split(vector, ends), strict=True)
        return {name: part.reshape(shape) for (name, shape), part in parts}

    def _run(self, features: Float32) -> tuple[Float32, Float32, Float32]:
        """Return slopes (N, 2) and the values of both hidden layers (N, hidden)."""
        one = self.weights
        first = np.tanh(features @ one["bent.0.weight"].T + one["bent.0.bias"])
        second = np.tanh(first @ one["bent.2.weight"].T + one["bent.2.bias"])
        slopes = features @ one["linear.weight"].T + second @ one["bent.4.weight"].T
        return slopes + (one["linear.bias"] + one["bent.4.bias"]), first, second


class PhotometricEstimator:
    """Estimates each pixel's slope from its colour difference, background and position, and integrates the slopes.

    `background` (H, W, 3) shows the untouched gel at the time of training. Images are compared with `untouched`, which
    is the same image or a newer image of the untouched gel. Raises ConfigError for unknown or ill-typed options.
    """

    class Options(ComponentOptions):
        """The network and its training."""

        hidden: int = Field(default=48, ge=4, le=512, description="units of each of the two hidden layers")
        steps: int | None = Field(
            default=None, ge=1, description="training steps; by default 150 for each press, at most 7500"
        )
        pixels: int = Field(default=1024, ge=64, description="pixels in each step")
        rate: float = Field(default=3e-3, gt=0, description="highest learning rate")
        untouched: float = Field(default=0.5, ge=0, le=10, description="untouched pixels for each pixel in contact")
        seed: int = Field(default=0, ge=0, description="seed of the training")

    def __init__(self, geometry: SensorGeometry, background: Image, options: Mapping[str, Any] | None = None) -> None:
        self.options = validate_options(self.Options, options or {}, "the estimator")
        self.geometry, self.background, self.untouched = geometry, background, background
        self._fixed = stack_fixed_features(background, geometry)
        self._network = SlopeNetwork(self.options.hidden, np.random.default_rng(self.options.seed))

    def fit(self, presses: Iterable[tuple[Image, PressLabel]], progress: Progress) -> None:
        """Learn from labelled images the slopes of the pixels in contact and of some untouched pixels.

        Raises CalibrationError when no press shows contact, and TrainingError when the loss becomes NaN.
        """
        features, slopes, count = self._collect_samples(presses)
        angles = np.arctan(slopes)
        rng = np.random.default_rng(self.options.seed)
        steps = self.options.steps or min(STEPS_A_PRESS * count, MOST_STEPS)
        rates = (self.options.rate * 0.5 * (1.003 + math.cos(math.pi * step / steps)) for step in range(steps))

        def draw() -> tuple[Float32, Float32]:
            chosen = rng.integers(len(features), size=self.options.pixels)
            return features[chosen], angles[chosen]

        with use_one_blas_thread(), progress.task("learning slope from colour", steps) as advance:
            for step, off_rad in enumerate(self._network.train(draw, rates)):
                if step % REPORT_EVERY == 0:
                    progress.note(f"mean error of the angle {math.degrees(float(np.abs(off_rad).mean())):.2f}°")
                advance(1)

    def estimate_slopes(self, image: Image) -> Float32:
        """Return the slopes (H, W, 2) of the gel's surface along x and y, unitless."""
        return self._network.predict(self._stack_features(image).reshape(-1, FEATURES)).reshape(*image.shape[:2], 2)

    def read(self, image: Image) -> tuple[Float32, Float32]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless, that were integrated.

        The indentation is about 0 where the gel is untouched.
        """
        slopes = self.estimate_slopes(image)
        return find_indentation(slopes, self.geometry), slopes

    def save(self, path: Path) -> None:
        """Write the network's weights to a safetensors file."""
        save_file({name: np.asarray(one, order="C") for name, one in self._network.weights.items()}, path)

    def load(self, path: Path) -> None:
        """Read the network's weights from a safetensors file.

        Raises WeightsError when the file is damaged or belongs to another network.
        """
        mine = self._network.weights
        try:
            stored = load_file(path)
            if {name: one.shape for name, one in stored.items()} != {name: one.shape for name, one in mine.items()}:
                raise ValueError("its tensors have other names or shapes")
        except (SafetensorError, ValueError, OSError) as error:
            reason = str(error).splitlines()[0]
            raise WeightsError(
                f"{path} cannot be read as the weights of an estimator ({reason}); calibrate the sensor again"
            ) from error
        for name, one in mine.items():
            np.copyto(one, stored[name])

    def _stack_features(self, image: Image) -> Float32:
        difference = (image.astype(np.float32) - self.untouched) / np.float32(COLOUR_STEP)
        planes = np.ascontiguousarray(np.moveaxis(difference, -1, 0))  # twice as fast
        smooth = [gaussian_filter(planes, (0, s, s), mode="nearest", truncate=3) for s in SMOOTHINGS_PX]
        return np.concatenate([np.moveaxis(np.concatenate(smooth), 0, -1), self._fixed], axis=-1)

    def _collect_samples(self, presses: Iterable[tuple[Image, PressLabel]]) -> tuple[Float32, Float32, int]:
        """Return features (P, FEATURES) and slopes (P, 2) of the training pixels, and the number of presses.

        These are all pixels with a known label that are in contact or slope, some other pixels, and pixels at seams of
        every two presses.
        """
        rng, at_seams = (np.random.default_rng([self.options.seed, part]) for part in range(2))
        features, slopes, touched, count = [], [], 0, 0
        alone: tuple[Image, PressLabel] | None = None
        for image, label in presses:
            count += 1
            inside = label.known & (label.contact | _slopes_visibly(label.slope))
            touched += int((label.known & label.contact).sum())
            outside = np.flatnonzero(label.known & ~inside)
            wanted = int(self.options.untouched * max(int(inside.sum()), 1000))
            chosen = inside.ravel()
            chosen[rng.permutation(outside)[:wanted]] = True
            features.append(self._stack_features(image).reshape(-1, FEATURES)[chosen])
            slopes.append(label.slope.reshape(-1, 2)[chosen])
            if alone is None or not label.contact.any():
                alone = image, label
                continue
            for values, more in zip((features, slopes), self._join(image, label, *alone, at_seams), strict=True):
                values.append(more)
            alone = None
        if not touched:
            raise CalibrationError("no press is in contact with the gel; check the poses or circles of the presses")
        return np.concatenate(features), np.concatenate(slopes), count

    def _join(
        self, image: Image, label: PressLabel, other: Image, beside: PressLabel, rng: np.random.Generator
    ) -> tuple[Float32, Float32]:
        """Return features (P, FEATURES) and slopes (P, 2) of the pixels along a seam of two presses.

        The seam is a random line through a contact. There, colours and slopes change suddenly, as at the edges of an
        object. A ball has no edges, so without seams the network learns to smooth them.
        """
        rows, columns = np.nonzero(label.contact)
        at, turn = rng.integers(len(rows)), rng.uniform(0, 2 * math.pi)
        y, x = np.ogrid[: image.shape[0], : image.shape[1]]
        away_px = (x - columns[at]) * math.cos(turn) + (y - rows[at]) * math.sin(turn)
        side = away_px > 0
        slope = np.where(side[..., None], label.slope, beside.slope)
        known = np.where(side, label.known, beside.known)
        touched = np.where(side, label.contact, beside.contact) | _slopes_visibly(slope)
        chosen = known & touched & (np.abs(away_px) < SEAM_PX)
        return self._stack_features(np.where(side[..., None], image, other))[chosen], slope[chosen]


def _slopes_visibly(slope: Float32) -> NDArray[np.bool_]:
    """Mark the pixels (H, W) at which the slope (H, W, 2) is that of touched gel."""
    return np.asarray(np.hypot(slope[..., 0], slope[..., 1]) > LEAST_SLOPE)


def stack_fixed_features(background: Image, geometry: SensorGeometry) -> Float32:
    """Return the constant features (H, W, FIXED): the smoothed background's colours and the pixels' x and y.

    The values are between -1 and 1.
    """
    sigma = BACKGROUND_M / geometry.pixel_pitch_m
    colour = gaussian_filter(background.astype(np.float32), (sigma, sigma, 0), mode="nearest") / 127.5 - 1
    height, width = geometry.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return np.concatenate([colour, x[..., None], y[..., None]], axis=-1).astype(np.float32)
