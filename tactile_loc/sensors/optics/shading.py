"""Renders the camera's image of the gel's surface: normals, Lambert's law, gloss, lens and camera noise."""

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.sensing.noise import GelPixels
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.optics.lamps import Light, Optics

WHITE = 255.0  # counts of a full white pixel


def render_images(
    indentation_m: NDArray[np.floating[Any]], geometry: SensorGeometry, optics: Optics, rng: np.random.Generator
) -> Image:
    """Return the camera's images (N, H, W, 3) uint8 RGB of indentations (N, H, W), metres.

    Outside the sensing rectangle, a press changes pixels only by the lens's blur.
    """
    return _expose(_compute_brightness(np.asarray(indentation_m, np.float32), geometry, optics), optics, rng)


def render_background(geometry: SensorGeometry, optics: Optics) -> Image:
    """Return the image (H, W, 3) uint8 RGB of the unpressed gel, without noise."""
    unpressed = np.zeros((1, *geometry.shape), np.float32)
    picture: Image = render_images(unpressed, geometry, optics.remove_noise(), np.random.default_rng(0))[0]
    return picture


def measure_slopes(indentation_m: Float32, geometry: SensorGeometry) -> tuple[Float32, Float32]:
    """Return the indentation's slopes (N, H, W) along x and y, unitless, by central differences.

    The slopes are zero outside the sensing rectangle.
    """
    gel = GelPixels.of(geometry)
    slope_x, slope_y = np.zeros_like(indentation_m), np.zeros_like(indentation_m)
    inside = indentation_m[:, gel.rows, gel.columns]
    for slopes, axis, pitch_m in ((slope_x, 2, gel.pitch_m[0]), (slope_y, 1, gel.pitch_m[1])):
        if inside.shape[axis] > 1:
            slopes[:, gel.rows, gel.columns] = np.gradient(inside, pitch_m, axis=axis)
    return slope_x, slope_y


def _compute_brightness(indentation_m: Float32, geometry: SensorGeometry, optics: Optics) -> Float32:
    """Return the brightness (3, N, H, W), counts, of gels with indentations (N, H, W), metres.

    The brightness is neither clipped nor noisy.
    """
    whole = GelPixels.of(dataclasses.replace(geometry, rectangle_m=None))
    x0, x1, y0, y1 = geometry.rectangle
    radius_m = math.hypot(x1 - x0, y1 - y0) / 2
    x = ((whole.x_m - (x0 + x1) / 2) / radius_m).astype(np.float32)[None, :]  # from the middle of the sensing rectangle
    y = ((whole.y_m - (y0 + y1) / 2) / radius_m).astype(np.float32)[:, None]
    relief_m = geometry.relief_m
    slope_x, slope_y = measure_slopes(indentation_m if relief_m is None else indentation_m - relief_m, geometry)
    if relief_m is None:  # then the dome describes the gel's curvature
        slope_x += np.float32(optics.dome) * x
        slope_y += np.float32(optics.dome) * y
    upright = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)  # the normal's component towards the camera
    counts = np.empty((3, *indentation_m.shape), np.float32)
    counts[:] = np.reshape(optics.ambient, (3, 1, 1, 1))
    for light in optics.lights:
        shade = _shade(light, slope_x, slope_y, upright, optics)
        for channel, share in enumerate(light.colour):
            if share > 0:
                counts[channel] += np.float32(light.strength * share) * shade
    seen = 1 - np.float32(optics.vignetting) * (x**2 + y**2)
    counts *= np.float32(WHITE) * np.maximum(seen, 0)  # an image may reach beyond the field
    if optics.blur_m > 0:
        for channel in counts:
            channel[...] = whole.blur(channel, optics.blur_m)
    return counts


def _shade(light: Light, slope_x: Float32, slope_y: Float32, upright: Float32, optics: Optics) -> Float32:
    """Return the share (N, H, W) of a light of strength 1 that the surface reflects, by Lambert's law and gloss.

    The normal is (-slope_x, -slope_y, 1) / length. The z axes of normals and of the light's direction point towards the
    camera.
    """
    x, y, z = (np.asarray(light.direction) / np.linalg.norm(light.direction)).astype(np.float32)
    shade: Float32 = slope_x * -x
    shade -= slope_y * y
    shade += z
    shade *= upright
    np.maximum(shade, 0, out=shade)
    if optics.specular > 0:
        length = np.sqrt(x * x + y * y + (1 + z) ** 2)  # length of the sum of the directions to light and camera
        half = np.maximum(((1 + z) - x * slope_x - y * slope_y) * upright / length, 0)
        shade += np.where(shade > 0, np.float32(optics.specular) * half ** np.float32(optics.shininess), 0)
    return shade


def _expose(counts: Float32, optics: Optics, rng: np.random.Generator) -> Image:
    """Add the camera's noise to the brightness (3, N, H, W) in counts, and return images (N, H, W, 3) uint8."""
    if optics.read_noise > 0 or optics.shot_noise > 0:
        signal = np.clip(counts, 0, np.float32(WHITE))
        variance = np.float32(optics.read_noise**2) + np.float32(optics.shot_noise**2 / WHITE) * signal
        counts += np.sqrt(variance) * rng.standard_normal(counts.shape, dtype=np.float32)
    pictures = np.clip(np.rint(counts, out=counts), 0, np.float32(WHITE), out=counts).astype(np.uint8)
    return np.ascontiguousarray(np.moveaxis(pictures, 0, -1))
