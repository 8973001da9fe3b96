"""The places of an object that can touch first, with the surface around them.

A touch is aligned by its deepest point, and rotating it tries the yaws. Only the place of the object that touches
first, and its direction, are left to search. Around each such place, a patch of the object's height map is kept,
independent of the sensor and the press.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Float32 = NDArray[np.float32]

PATCH_PX, PITCH_M = 41, 5e-4  # a patch's side; its place is in the middle of the middle pixel
STEP_M, BELOW = 1.25e-5, 15  # resolution of heights; steps that are lower than the place
FAR = 255  # steps: this high or higher, or no surface
HIGHEST_M = (FAR - BELOW) * STEP_M
PRESS_STEP_M = 1e-4  # between the press depths at which touches are compared

CAMERA = SensorGeometry(
    "orthographic", PATCH_PX, PATCH_PX, 1 / PITCH_M, 1 / PITCH_M, PATCH_PX / 2, PATCH_PX / 2, 0.1, HIGHEST_M
)
"""The camera that sees a patch: parallel rays, the place at x = y = 0 on the sensing surface."""


@dataclass(frozen=True, eq=False)
class Places:
    """N places of an object, each seen along the direction from which it touches.

    `T_place_object` (N, 4, 4), metres: the place is the origin, and z points from the sensor into the object. `patches`
    (N, PATCH_PX, PATCH_PX) uint8 are the heights of the surface around it, in steps of STEP_M, from BELOW steps nearer
    to the sensor than the place; FAR means that far, or no surface.
    """

    T_place_object: Poses
    patches: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.patches)

    def depths(self, press_depth_m: float, some: slice = slice(None)) -> Float32:
        """Return the contact depths (K, PATCH_PX, PATCH_PX), metres, of `some` places, cut at a press depth."""
        rise_m = (np.arange(FAR + 1, dtype=np.float32) - BELOW) * np.float32(STEP_M)
        rise_m[FAR] = np.inf
        return np.asarray(np.clip(rise_m, 0.0, np.float32(press_depth_m))[self.patches[some]])

    def poses(self, numbers: NDArray[np.int64], yaw_rad: NDArray[np.float64]) -> Poses:
        """Return the poses (K, 4, 4) in which places `numbers` (K,), rotated by yaws (K,), are at the origin."""
        R = rotation_about([0.0, 0.0, 1.0], yaw_rad)
        return np.asarray(make_transform(R, np.zeros(3)) @ self.T_place_object[numbers])


def make_patches(rise_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Convert heights of a surface beyond its place (..., metres) to the steps of `Places.patches`."""
    with np.errstate(invalid="ignore"):
        steps = np.clip(np.rint(rise_m / STEP_M) + BELOW, 0, FAR)
    return np.where(np.isfinite(rise_m), steps, FAR).astype(np.uint8)
