"""Slopes of a surface, integration of slopes to a surface, and the gel's indentation."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, gaussian_filter1d, label

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

ROUNDS = 3
DRIFT_M = 2.5e-3  # standard deviation of the Gaussian that smooths the drift
TOUCHED_M = 4e-5  # least indentation of a touched pixel; drift is smaller
TOUCHED_SLOPE = 0.05  # least slope of a touched pixel; the border of a lightly pressed flat face has about 0.1
RISING_SLOPE = 0.02  # least mean slope at the border of a plateau, towards the plateau
SMOOTHING_M = 1.2e-4  # standard deviation of the smoothing of slopes before steep pixels are found
NOISES = 4.0  # threshold between noise and signal, as a multiple of the median magnitude
LEAST_UNTOUCHED = 0.05  # least share of the image that must be left untouched if plateaus are to count
COARSE_PX = 80  # longer image side for estimating the drift


def differentiate(height_m: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.floating]:
    """Return the slopes (H, W, 2), unitless, of a surface (H, W), metres, along x and y, by central differences."""
    sx, sy = geometry.scale_at_surface
    down, across = np.gradient(height_m)
    return np.stack([across * sx, down * sy], axis=-1)


def integrate(slope: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the surface (H, W), metres, with zero mean, whose slopes are nearest to the given slopes (H, W, 2).

    The surface is the least-squares solution with free borders. It solves a Poisson equation, by a cosine transform.
    The wanted step from one pixel to the next is the mean of the slopes at the two pixels.
    """
    sx, sy = geometry.scale_at_surface
    across, down = slope[..., 0] / sx, slope[..., 1] / sy  # metres per pixel
    steps_x = np.pad(0.5 * (across[:, 1:] + across[:, :-1]), [(0, 0), (1, 1)])
    steps_y = np.pad(0.5 * (down[1:] + down[:-1]), [(1, 1), (0, 0)])
    divergence = np.diff(steps_x, axis=1) + np.diff(steps_y, axis=0)
    m, k = (2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in divergence.shape)
    eigenvalues = k[None, :] + m[:, None]
    eigenvalues[0, 0] = np.inf  # the mean is free
    return np.asarray(idctn(dctn(divergence, norm="ortho") / eigenvalues, norm="ortho"))


def find_indentation(slope: NDArray[np.floating], geometry: SensorGeometry) -> Float32:
    """Return the indentation (H, W), metres, of a surface with slopes (H, W, 2): about 0 where the gel is untouched.

    Small errors of the slopes add up to a slow drift of the surface, which may exceed a light imprint. The drift is
    measured where the gel is untouched, smoothed, and continued under the imprint.

    A pixel counts as touched if it is steep, if it is deep after the drift is subtracted, or if touched pixels enclose
    it. An imprint that crosses the image's border is not enclosed. It is found as a plateau: a flat part towards which
    the steep pixels rise.
    """
    surface = integrate(slope, geometry)
    sigma = SMOOTHING_M / geometry.pixel_pitch_m
    steepness = np.hypot(*(gaussian_filter(slope[..., i], sigma) for i in (0, 1)))
    steep = steepness > _choose_threshold(steepness, TOUCHED_SLOPE)
    touched = _fill_holes(steep)
    touched |= _find_plateaus(touched, slope)
    for _ in range(ROUNDS):
        surface = surface - _fit_drift(surface, ~touched, geometry)
        away = np.abs(surface)
        touched = _fill_holes(steep | (away > _choose_threshold(away[~touched], TOUCHED_M)))
    return surface.astype(np.float32)


def _fill_holes(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the marked pixels (H, W) and the pixels that they enclose.

    The function is four times as fast as scipy's binary_fill_holes.
    """
    parts, count = label(~marked)
    outside = np.zeros(count + 1, bool)
    for border in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        outside[border] = True
    return marked | ~outside[parts]


def _find_plateaus(steep: NDArray[np.bool_], slope: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Mark the flat parts (H, W) towards which the steep pixels (H, W) rise, if they leave enough untouched gel."""
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


def _choose_threshold(values: NDArray[np.float64], least: float) -> float:
    """Return the threshold between noise and signal, at least `least`, for magnitudes that are mostly noise."""
    return max(least, NOISES * float(np.median(values.ravel()[::4])) if values.size else least)


def _fit_drift(
    surface_m: NDArray[np.float64], untouched: NDArray[np.bool_], geometry: SensorGeometry
) -> NDArray[np.float64]:
    """Return a smooth surface (H, W), metres, that fits the untouched pixels (H, W) and continues between them."""
    step = max(1, round(max(geometry.shape) / COARSE_PX))
    sigma = DRIFT_M / (step * geometry.pixel_pitch_m)
    weight = untouched.astype(float)
    seen, weights = (_average_blocks(a, step) for a in (surface_m * weight, weight))
    down, across = (_weigh_gaussian(blocks, sigma) for blocks in seen.shape)
    coarse = (down @ seen @ across.T) / np.maximum(down @ weights @ across.T, 1e-9)
    rows, columns = (_weigh_linear(n, step, pixels) for n, pixels in zip(coarse.shape, surface_m.shape, strict=True))
    return rows @ coarse @ columns.T


@lru_cache(maxsize=8)
def _weigh_gaussian(blocks: int, sigma: float) -> NDArray[np.float64]:
    """Return the matrix (blocks, blocks) that smooths by a Gaussian of `sigma` blocks and continues border values."""
    return np.asarray(gaussian_filter1d(np.eye(blocks), sigma, axis=0, mode="nearest", truncate=6))


@lru_cache(maxsize=8)
def _weigh_linear(blocks: int, step: int, pixels: int) -> NDArray[np.float64]:
    """Return the matrix (pixels, blocks) that interpolates linearly between the middles of blocks.

    The values are constant beyond the first and the last middle.
    """
    middles = (np.arange(blocks) + 0.5) * step - 0.5
    return np.stack([np.interp(np.arange(pixels), middles, one) for one in np.eye(blocks)], axis=1)


def _average_blocks(image: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Return the means of an image (H, W) over blocks of `step` x `step` pixels.

    Incomplete blocks at the border are filled with the image's last pixels.
    """
    height, width = image.shape
    padded = np.pad(image, [(0, -height % step), (0, -width % step)], mode="edge")
    blocks = padded.reshape(padded.shape[0] // step, step, padded.shape[1] // step, step)
    return np.asarray(blocks.mean(axis=(1, 3)))
