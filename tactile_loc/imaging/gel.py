"""The elastomer's surface under a press: the object's where it touches, and a smooth way back to rest around it.

No elastomer follows a step. Outside the contact its surface falls off, steeply at first and with a long tail. Here this
is found by blurs of decreasing width, after each of which what the object pushes in is put back: wide blurs make the
tail, narrow ones lead it up to the contact's edge. All widths are metres on the sensing surface.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.simulation.noise import Gel

Float32 = NDArray[np.float32]

SOFTNESS_M = 8e-4  # fitted to photos of a flat prism, pressed 0.25 to 1 mm into a GelSlim
WIDTHS = (2.0, 1.0, 0.5, 0.25)  # of the blurs, in softnesses
ROUNDING = 0.06  # width of the last blur, in softnesses


def find_indentation(depth_m: NDArray[np.floating[Any]], press_depth_m: ArrayLike) -> Float32:
    """Return how far the object reaches below the undeformed surface (N, H, W), metres: press - depth, 0 off contact.

    `depth_m` (N, H, W) are contact depths, `press_depth_m` (N,) the presses. Raises ConfigError when these do not fit.
    """
    depth, press = np.asarray(depth_m, np.float32), np.asarray(press_depth_m, np.float32)
    if depth.ndim != 3 or press.shape != depth.shape[:1]:
        raise ConfigError(
            f"contact depths of shape {depth.shape} do not go with press depths of shape {press.shape}; "
            "give (N, H, W) depths and (N,) presses, one for each"
        )
    indentation: Float32 = np.maximum(press[:, None, None] - depth, np.float32(0))
    return indentation


def press_gel(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    softness_m: float = SOFTNESS_M,
) -> Float32:
    """Return how far the elastomer's surface is pushed in (N, H, W) float32, metres, at least 0.

    `depth_m` (N, H, W) are contact depths at presses `press_depth_m` (N,), both metres. The surface goes back to rest
    over about `softness_m` metres, and its edges are rounded by a small share of that; zero follows the object exactly.
    Off the sensing rectangle there is no elastomer and nothing is pushed in. Raises ConfigError for sizes that do not
    fit.
    """
    contact = find_indentation(depth_m, press_depth_m)
    if contact.shape[1:] != geometry.shape:
        raise ConfigError(f"depths of {contact.shape[1:]} pixels do not fit the sensor's image of {geometry.shape}")
    if not (math.isfinite(softness_m) and softness_m >= 0):
        raise ConfigError(f"the gel's softness_m is {softness_m}; it must be zero or a positive number")
    gel = Gel.of(geometry)
    surface = np.zeros_like(contact)
    pushed = contact[:, gel.rows, gel.columns]
    if softness_m > 0:
        pushed = gel.blur(relax(pushed, gel, softness_m), ROUNDING * softness_m)
    surface[:, gel.rows, gel.columns] = pushed
    return surface


def relax(contact_m: Float32, gel: Gel, softness_m: float) -> Float32:
    """Return the surface (N, h, w), metres, around what the object pushes in (N, h, w), metres; nowhere below it.

    Where it lies above, inside the contact's outline too, the object has a gap that the elastomer bridges.
    """
    surface = contact_m
    for width in WIDTHS:
        surface = np.maximum(gel.blur(surface, width * softness_m), contact_m)
    return surface
