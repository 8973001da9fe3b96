"""Simulated images of contact shapes.

A gel shows the object's surface in the contact, and returns smoothly to rest around it. It cannot follow a step.
Outside the contact, the gel's surface falls off, steeply at first and then with a long tail. This shape is computed by
blurs of decreasing width. After each blur, the contact is restored. Wide blurs make the tail, and narrow blurs join the
tail to the contact's edge. All widths are in metres on the sensing surface.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.noise import GelPixels
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.shading import render_images

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]

SOFTNESS_M = 8e-4  # fitted to photos of a flat prism, pressed 0.25 to 1 mm into a GelSlim
WIDTHS = (2.0, 1.0, 0.5, 0.25)  # widths of the blurs, as multiples of the softness
ROUNDING = 0.06  # width of the last blur, as a multiple of the softness


def find_indentation(depth_m: NDArray[np.floating[Any]], press_depth_m: ArrayLike) -> Float32:
    """Return the object's indentation (N, H, W), metres: press depth minus depth, or 0 outside the contact.

    `depth_m` (N, H, W) are contact depths and `press_depth_m` (N,) are press depths, metres. Raises ConfigError for
    other shapes.
    """
    depth, press = np.asarray(depth_m, np.float32), np.asarray(press_depth_m, np.float32)
    if depth.ndim != 3 or press.shape != depth.shape[:1]:
        raise ConfigError(
            f"contact depths of shape {depth.shape} do not fit press depths of shape {press.shape}; "
            "give (N, H, W) depths and (N,) presses"
        )
    indentation: Float32 = np.maximum(press[:, None, None] - depth, np.float32(0))
    return indentation


def press_gel(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    softness_m: float = SOFTNESS_M,
) -> Float32:
    """Return the indentation of the gel's surface (N, H, W) float32, metres, not below 0.

    `depth_m` (N, H, W) are contact depths at press depths `press_depth_m` (N,), both in metres. Around the contact, the
    surface returns to rest over a distance of about `softness_m` metres. Edges are rounded by a small share of this
    distance. If the softness is zero, the surface is that of the object. Outside the sensing rectangle, the indentation
    is 0. Raises ConfigError for sizes that do not fit.
    """
    contact = find_indentation(depth_m, press_depth_m)
    if contact.shape[1:] != geometry.shape:
        raise ConfigError(
            f"contact depths of {contact.shape[1:]} pixels do not fit the sensor's image; give {geometry.shape}"
        )
    if not (math.isfinite(softness_m) and softness_m >= 0):
        raise ConfigError(f"the gel's softness_m is {softness_m}; it must be zero or positive")
    gel = GelPixels.of(geometry)
    surface = np.zeros_like(contact)
    pushed = contact[:, gel.rows, gel.columns]
    if softness_m > 0:
        pushed = gel.blur(relax(pushed, gel, softness_m), ROUNDING * softness_m)
    surface[:, gel.rows, gel.columns] = pushed
    return surface


def relax(contact_m: Float32, gel: GelPixels, softness_m: float) -> Float32:
    """Return the indentation (N, h, w), metres, of a gel in which an object has the indentation `contact_m` (N, h, w).

    The gel's indentation is nowhere smaller than that of the object.
    """
    surface = contact_m
    for width in WIDTHS:
        surface = np.maximum(gel.blur(surface, width * softness_m), contact_m)
    return surface


def render_touches(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    optics: Optics,
    rng: np.random.Generator,
) -> Image:
    """Return images (N, H, W, 3) uint8 RGB of contact depths (N, H, W) at press depths (N,), metres.

    The contact depths of an elastic gel already show the gel's surface. Otherwise, the gel has the softness SOFTNESS_M
    (see `press_gel`). Raises ConfigError for sizes that do not fit.
    """
    softness_m = 0.0 if geometry.gel.is_elastic else SOFTNESS_M
    surface = press_gel(depth_m, press_depth_m, geometry, softness_m)
    return render_images(surface, geometry, optics, rng)
