"""Estimates the gel's slope from the colour of each pixel, and integrates the slopes to heights.

A map from colours to angles is learned from a few dozen presses of a ball. The method is photometric stereo with
measured instead of modelled light, after Johnson and Adelson (CVPR 2009). The map is a sum of many random smooth steps
(Rahimi and Recht, NIPS 2007), whose factors follow from one linear equation. Poisson integration gives the heights. The
drift of the heights is estimated where the gel is untouched, and subtracted.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.linalg import solve
from scipy.ndimage import gaussian_filter

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Float32, Image, LabelledPresses, PressLabel
from tactile_loc.sensors.reading.estimator import DIFFERENCE, FIXED, GelEstimator, scale_difference
from tactile_loc.sensors.reading.surface import find_indentation
from tactile_loc.slots.encoder import Checkpoints

SMOOTHINGS_PX = (1.0, 3.0)  # Gaussian widths that smooth the colour difference: against noise, and around a pixel
FEATURES = DIFFERENCE * len(SMOOTHINGS_PX) + FIXED
STEEPNESS, FARTHEST = 0.7, 1.5  # of the random steps, and their largest offset, standard deviations of the features
PIXELS_AT_ONCE = 2048  # fits into the processor's cache
STEEPEST_RAD = 1.4  # largest estimated angle
LEAST_SLOPE = 0.02  # of the gel beside a contact; flatter pixels count as untouched


class PhotometricEstimator(GelEstimator):
    """Estimates each pixel's slope from its colour difference, background and position, and integrates the slopes."""

    name = "photometric"

    class Options(ComponentOptions):
        """The map from colours to slopes."""

        units: int = Field(default=500, ge=4, le=4000, description="random steps that the map consists of")
        smoothness: float = Field(default=1e-4, gt=0, description="penalty of the map's factors; larger is smoother")
        pixels: int = Field(default=60_000, ge=64, description="largest number of pixels to learn from")
        untouched: float = Field(default=0.5, ge=0, le=10, description="untouched pixels for each pixel in contact")
        seed: int = Field(default=0, ge=0, description="seed of the random steps and of the chosen pixels")

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        super().__init__(geometry, background, options)
        rng, units = np.random.default_rng(self.options.seed), self.options.units
        self.weights = {
            "mean": np.zeros(FEATURES, np.float32),
            "scale": np.ones(FEATURES, np.float32),
            "directions": (STEEPNESS / np.sqrt(FEATURES) * rng.normal(size=(FEATURES, units))).astype(np.float32),
            "offsets": rng.uniform(-FARTHEST, FARTHEST, units).astype(np.float32),
            "factors": np.zeros((FEATURES + units + 1, 2), np.float32),
        }

    def fit(self, presses: LabelledPresses, progress: Progress, checkpoints: Checkpoints) -> None:
        """Learn the slopes of the pixels in contact and of some untouched pixels.

        Raises CalibrationError when no press shows contact.
        """
        rng, samples = np.random.default_rng(self.options.seed), []
        with progress.task("learning slope from colour", 2 * len(presses)) as advance:
            for image, label in presses.read_presses():
                samples.append(self._sample_pixels(image, label, rng, len(presses)))
                advance(1)
            if not any(touched for _, _, touched in samples):
                raise CalibrationError("no press is in contact with the gel; check the poses or circles of the presses")
            every = np.concatenate([features for features, _, _ in samples])
            self.weights |= {"mean": every.mean(axis=0), "scale": np.maximum(every.std(axis=0), 1e-6)}
            size = len(self.weights["factors"])
            squares, moments = np.zeros((size, size)), np.zeros((size, 2))
            for features, angles, _ in samples:
                terms = self._expand(features)
                squares += terms.T @ terms / np.float32(len(every))
                moments += terms.T @ angles / np.float32(len(every))
                advance(1)
        squares[np.diag_indices(size)] += self.options.smoothness
        self.weights["factors"] = solve(squares, moments, assume_a="sym").astype(np.float32)

    def list_weights(self) -> Mapping[str, NDArray[np.generic]]:
        """Return what was learned, by name."""
        return self.weights

    def set_weights(self, weights: Mapping[str, NDArray[np.generic]]) -> None:
        """Replace what was learned. Raises ValueError when the weights are of another estimator."""
        shapes, wanted = ({name: one.shape for name, one in each.items()} for each in (weights, self.weights))
        if shapes != wanted:
            raise ValueError(f"the file has the arrays {shapes}, not {wanted}")
        self.weights = {name: one.astype(np.float32) for name, one in weights.items()}

    def estimate_slopes(self, image: Image) -> Float32:
        """Return the slopes (H, W, 2) of the gel's surface along x and y, unitless."""
        pixels = self._stack_features(image).reshape(-1, FEATURES)
        parts = np.split(pixels, range(PIXELS_AT_ONCE, len(pixels), PIXELS_AT_ONCE))
        angles = np.concatenate([self._expand(part) @ self.weights["factors"] for part in parts])
        return np.tan(np.clip(angles, -STEEPEST_RAD, STEEPEST_RAD)).reshape(*image.shape[:2], 2)

    def read(self, image: Image) -> tuple[Float32, Float32]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless, that were integrated."""
        slopes = self.estimate_slopes(image)
        return find_indentation(slopes, self.geometry), slopes

    def _stack_features(self, image: Image) -> Float32:
        planes = np.ascontiguousarray(np.moveaxis(scale_difference(image, self.untouched), -1, 0))  # twice as fast
        smooth = [gaussian_filter(planes, (0, s, s), mode="nearest", truncate=3) for s in SMOOTHINGS_PX]
        return np.concatenate([np.moveaxis(np.concatenate(smooth), 0, -1), self._fixed], axis=-1)

    def _expand(self, features: Float32) -> Float32:
        """Return the map's terms (P, FEATURES + units + 1) at features (P, FEATURES): steps, linear and constant."""
        units = self.options.units
        terms = np.empty((len(features), FEATURES + units + 1), np.float32)
        linear = (features - self.weights["mean"]) / self.weights["scale"]
        np.tanh(linear @ self.weights["directions"] + self.weights["offsets"], out=terms[:, :units])
        terms[:, units:-1], terms[:, -1] = linear, 1
        return terms

    def _sample_pixels(
        self, image: Image, label: PressLabel, rng: np.random.Generator, presses: int
    ) -> tuple[Float32, Float32, int]:
        """Return features (P, FEATURES) and angles (P, 2) of pixels of one of `presses` presses, and the touched ones.

        These are the pixels with a known label that are in contact or slope, and some other pixels. If there are more
        than the press's share of the largest number, a random part is returned.
        """
        slopes_visibly = np.hypot(label.slope[..., 0], label.slope[..., 1]) > LEAST_SLOPE
        inside = label.known & (label.contact | slopes_visibly)
        outside = rng.permutation(np.flatnonzero(label.known & ~inside))
        few = int(self.options.untouched * max(int(inside.sum()), 1000))
        chosen = np.concatenate([np.flatnonzero(inside), outside[:few]])
        chosen = rng.permutation(chosen)[: max(1, self.options.pixels // presses)]
        features = self._stack_features(image).reshape(-1, FEATURES)[chosen]
        angles = np.arctan(label.slope.reshape(-1, 2)[chosen])
        return features, angles.astype(np.float32), int((label.known & label.contact).sum())
