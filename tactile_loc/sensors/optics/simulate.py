"""Simulated images of contact shapes.

A gel shows the object's surface in the contact, and returns smoothly to rest around it. It cannot follow a step.
Outside the contact, the gel's surface falls off, steeply at first and then with a long tail. This shape is computed by
blurs of decreasing width. After each blur, the contact is restored. Wide blurs make the tail, and narrow blurs join the
tail to the contact's edge. All widths are in metres on the sensing surface.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.sensing.noise import GelPixels
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.shading import render_images

SOFTNESS_M = 8e-4  # fitted to photos of a flat prism, pressed 0.25 to 1 mm into a GelSlim
WIDTHS = (2.0, 1.0, 0.5, 0.25)  # widths of the blurs, as multiples of the softness
ROUNDING = 0.06  # width of the last blur, as a multiple of the softness


def press_gel(depth_m: NDArray[np.floating[Any]], press_depth_m: ArrayLike, geometry: SensorGeometry) -> Float32:
    """Return the indentation of the gel's surface (N, H, W) float32, metres, not below 0.

    `depth_m` (N, H, W) are contact depths at press depths `press_depth_m` (N,), both in metres. Those of an elastic gel
    already show the gel's surface. The surface of another gel returns to rest over a distance of about SOFTNESS_M
    around the contact, and edges are rounded by a small share of this distance. Outside the sensing rectangle, the
    indentation is 0.
    """
    press = np.asarray(press_depth_m, np.float32)[:, None, None]
    contact = np.maximum(press - np.asarray(depth_m, np.float32), np.float32(0))
    gel, surface = GelPixels.of(geometry), np.zeros_like(contact)
    pushed = contact[:, gel.rows, gel.columns]
    if not geometry.gel.is_elastic:
        pushed = gel.blur(relax(pushed, gel), ROUNDING * SOFTNESS_M)
    surface[:, gel.rows, gel.columns] = pushed
    return surface


def relax(contact_m: Float32, gel: GelPixels) -> Float32:
    """Return the indentation (N, h, w), metres, of a gel in which an object has the indentation `contact_m` (N, h, w).

    The gel's indentation is nowhere smaller than that of the object.
    """
    surface = contact_m
    for width in WIDTHS:
        surface = np.maximum(gel.blur(surface, width * SOFTNESS_M), contact_m)
    return surface


def render_touches(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    optics: Optics,
    rng: np.random.Generator,
) -> Image:
    """Return images (N, H, W, 3) uint8 RGB of contact depths (N, H, W), metres, as `press_gel` takes them."""
    return render_images(press_gel(depth_m, press_depth_m, geometry), geometry, optics, rng)
