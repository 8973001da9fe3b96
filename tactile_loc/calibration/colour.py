"""What an estimator sees of an image: how its colour differs from the untouched gel's, that gel's colour, the place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.estimator import Image
from tactile_loc.core.sensing import SensorGeometry

Float32 = NDArray[np.float32]

DIFFERENCE, FIXED = 3, 5  # planes that a touch changes, and that none does
FEATURES = DIFFERENCE + FIXED
COLOUR_STEP = 64.0  # counts of 255: a difference of this size is one
BACKGROUND_M = 2e-4  # the background's own grain is not looked at: standard deviation of its smoothing


def colour_difference(image: Image, background: Image) -> Float32:
    """Return how an image (H, W, 3), or a part of it, differs from the untouched gel's (H, W, 3): about -1 to 1."""
    return (image.astype(np.float32) - background) / np.float32(COLOUR_STEP)


def features(image: Image, background: Image, fixed: Float32) -> Float32:
    """Return what an estimator sees of an image (H, W, 3), or of a part of it: (H, W, FEATURES), about -1 to 1.

    The colour's difference from the `background` (H, W, 3), and what no touch changes, `fixed` (H, W, 5).
    """
    return np.concatenate([colour_difference(image, background), fixed], axis=-1)


def fixed_features(background: Image, geometry: SensorGeometry) -> Float32:
    """Return what no touch changes, (H, W, 5): the smoothed background's colour, and the place; about -1 to 1."""
    from scipy.ndimage import gaussian_filter

    sigma = BACKGROUND_M / geometry.pixel_pitch_m
    colour = gaussian_filter(background.astype(np.float32), (sigma, sigma, 0), mode="nearest") / 127.5 - 1
    height, width = geometry.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return np.concatenate([colour, x[..., None], y[..., None]], axis=-1).astype(np.float32)
