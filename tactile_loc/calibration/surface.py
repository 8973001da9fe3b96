"""Slopes of a surface, the surface that has given slopes, and how far the gel is pressed in by it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Float32 = NDArray[np.float32]

ROUNDS = 3
DRIFT_M = 2.5e-3  # drift is smooth over this distance: standard deviation of a Gaussian
TOUCHED_M = 4e-5  # an indentation of this depth is not drift
TOUCHED_SLOPE = 0.05  # nor is a surface of this slope; the walls of a light press of a flat face have about 0.1
RISING_SLOPE = 0.02  # a flat part up to which its border rises by this is a plateau, not untouched
SMOOTHING_M = 1.2e-4  # of the slope, in deciding where the gel is touched
NOISES = 4.0  # medians of the magnitude: what is beyond is no noise
LEAST_UNTOUCHED = 0.05  # of the image
COARSE_PX = 80  # longer image side on which drift is estimated


def differentiate(height_m: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.floating]:
    """Return how steep a surface (H, W), metres, is along x and y (H, W, 2), unitless, by central differences."""
    sx, sy = geometry.scale_at_surface
    down, across = np.gradient(height_m)
    return np.stack([across * sx, down * sy], axis=-1)


def integrate(slope: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the surface (..., H, W), metres, of zero mean, whose slopes (..., H, W, 2) come nearest to those given.

    Least squares with free borders: the Poisson equation with the slope across the border given, solved by a cosine
    transform; each step between two pixels is the mean of their slopes.
    """
    from scipy.fft import dctn, idctn

    sx, sy = geometry.scale_at_surface
    across, down = slope[..., 0] / sx, slope[..., 1] / sy  # metres a pixel
    pad = [(0, 0)] * (slope.ndim - 3)
    steps_x = np.pad(0.5 * (across[..., 1:] + across[..., :-1]), [*pad, (0, 0), (1, 1)])
    steps_y = np.pad(0.5 * (down[..., 1:, :] + down[..., :-1, :]), [*pad, (1, 1), (0, 0)])
    divergence = np.diff(steps_x, axis=-1) + np.diff(steps_y, axis=-2)
    height, width = divergence.shape[-2:]
    k, m = (2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in (width, height))
    eigenvalues = k[None, :] + m[:, None]
    eigenvalues[0, 0] = np.inf  # the mean is free
    spectrum = dctn(divergence, type=2, axes=(-2, -1), norm="ortho") / eigenvalues
    return np.asarray(idctn(spectrum, type=2, axes=(-2, -1), norm="ortho"))


def find_indentation(slope: NDArray[np.floating], geometry: SensorGeometry) -> Float32:
    """Return the indentation (H, W), metres, of one surface of slopes (H, W, 2), zero where the gel is untouched.

    Small errors of the slopes add up to a slow drift of the surface, deeper than a light imprint. Where the gel is
    untouched the drift is seen as it is; there it is smoothed and, under the imprint, continued. Touched is what is
    steep or, once most of the drift is gone, deep, and what that encloses: the flat middle of an imprint. One that
    reaches over the image's border is told from the untouched gel beside it by the side on which the steep is higher.
    """
    surface = integrate(slope, geometry)
    steepness = _measure_steepness(slope, geometry)
    steep = steepness > _choose_threshold(steepness, TOUCHED_SLOPE)
    touched = _fill_holes(steep)
    touched |= _find_plateaus(touched, slope)
    for _ in range(ROUNDS):
        surface = surface - _fit_drift(surface, ~touched, geometry)
        away = np.abs(surface)
        touched = _fill_holes(steep | (away > _choose_threshold(away[~touched], TOUCHED_M)))
    return surface.astype(np.float32)


def _fill_holes(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What is marked (H, W), and what it encloses: a quarter of the time of scipy's binary_fill_holes."""
    from scipy.ndimage import label

    parts, count = label(~marked)
    outside = np.zeros(count + 1, bool)
    for border in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        outside[border] = True
    return marked | ~outside[parts]


def _find_plateaus(steep: NDArray[np.bool_], slope: NDArray[np.floating]) -> NDArray[np.bool_]:
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


def _measure_steepness(slope: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.float64]:
    """The slope's magnitude (H, W), unitless, its noise smoothed away."""
    from scipy.ndimage import gaussian_filter

    sigma = SMOOTHING_M / geometry.pixel_pitch_m
    return np.asarray(np.hypot(*(gaussian_filter(slope[..., i], sigma) for i in (0, 1))))


def _choose_threshold(values: NDArray[np.float64], least: float) -> float:
    """What stands out among magnitudes of which most are noise: at least `least`; a quarter tells the median."""
    return max(least, NOISES * float(np.median(values.ravel()[::4])) if values.size else least)


def _fit_drift(
    surface_m: NDArray[np.float64], untouched: NDArray[np.bool_], geometry: SensorGeometry
) -> NDArray[np.float64]:
    """The smooth surface (H, W), metres, through the untouched pixels (H, W), continued where there are none."""
    step = max(1, round(max(geometry.shape) / COARSE_PX))
    sigma = DRIFT_M / (step * geometry.pixel_pitch_m)
    weight = untouched.astype(float)
    seen, weights = (_average_blocks(a, step) for a in (surface_m * weight, weight))
    down, across = (_weigh_gaussian(blocks, sigma) for blocks in seen.shape)
    coarse = (down @ seen @ across.T) / np.maximum(down @ weights @ across.T, 1e-9)
    height, width = surface_m.shape
    rows, columns = (
        _weigh_linear(blocks, step, pixels) for blocks, pixels in zip(coarse.shape, (height, width), strict=True)
    )
    return rows @ coarse @ columns.T


@lru_cache(maxsize=8)
def _weigh_gaussian(blocks: int, sigma: float) -> NDArray[np.float64]:
    """Weights (blocks, blocks) of a Gaussian of `sigma` blocks; beyond the borders they go on."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(np.eye(blocks), sigma, axis=0, mode="nearest", truncate=6))


@lru_cache(maxsize=8)
def _weigh_linear(blocks: int, step: int, pixels: int) -> NDArray[np.float64]:
    """Weights (pixels, blocks) that interpolate linearly between the middles of blocks; constant beyond the last."""
    middles = (np.arange(blocks) + 0.5) * step - 0.5
    return np.stack([np.interp(np.arange(pixels), middles, one) for one in np.eye(blocks)], axis=1)


def _average_blocks(image: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Mean of blocks of `step` x `step` pixels of (H, W); the last rows and columns are repeated to fill them."""
    height, width = image.shape
    padded = np.pad(image, [(0, -height % step), (0, -width % step)], mode="edge")
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    return np.asarray(blocks.mean(axis=(1, 3)))
