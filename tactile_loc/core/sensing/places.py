"""The places of an object that can touch first, and what surrounds them.

A touch shows where its deepest point is, and turning it tries a yaw: what is left to search of all poses is the place
of the object that touches first, and the direction from which it does. Around each such place a patch of the object's
height map is kept, whatever the sensor and the press.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Float32 = NDArray[np.float32]

PATCH_PX, PITCH_M = 41, 5e-4  # a patch's side, its place in the middle of the middle pixel
STEP_M, BELOW = 1.25e-5, 15  # heights are kept in such steps; so many of them lower than the place
FAR = 255  # steps: as high, or no surface at all
HIGHEST_M = (FAR - BELOW) * STEP_M
PRESS_STEP_M = 1e-4  # between the press depths at which touches are compared

CAMERA = SensorGeometry(
    "orthographic", PATCH_PX, PATCH_PX, 1 / PITCH_M, 1 / PITCH_M, PATCH_PX / 2, PATCH_PX / 2, 0.1, HIGHEST_M
)
"""What sees a patch: parallel rays, the place at x = y = 0, as deep as the sensing surface."""


@dataclass(frozen=True, eq=False)
class Places:
    """N places of an object, each seen along the direction from which it touches.

    `T_place_object` (N, 4, 4), metres: the place is the origin, z points from the sensor into the object. `patches` (N,
    PATCH_PX, PATCH_PX) uint8 say how much farther than the place the surface around it is, in steps of STEP_M from
    BELOW steps nearer; FAR is that far, or nothing.
    """

    T_place_object: Poses
    patches: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.patches)

    def depths(self, press_depth_m: float, some: slice = slice(None)) -> Float32:
        """Return the contact depths (K, PATCH_PX, PATCH_PX), metres, of `some` places, cut at a press depth."""
        rise_m = (np.arange(FAR + 1, dtype=np.float32) - BELOW) * np.float32(STEP_M)
        rise_m[FAR] = np.inf
        depths: Float32 = np.clip(rise_m, 0.0, np.float32(press_depth_m))[self.patches[some]]
        return depths

    def poses(self, numbers: NDArray[np.int64], yaw_rad: NDArray[np.float64]) -> Poses:
        """Return the poses (K, 4, 4) in which places `numbers` (K,), turned by yaws (K,), are at the origin."""
        turn = rotation_about([0.0, 0.0, 1.0], yaw_rad)
        poses: Poses = make_transform(turn, np.zeros(3)) @ self.T_place_object[numbers]
        return poses


def make_patches(rise_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Turn how much farther than its place a surface is (..., metres) into what `Places.patches` keeps of it."""
    with np.errstate(invalid="ignore"):
        steps = np.clip(np.rint(rise_m / STEP_M) + BELOW, 0, FAR)
    return np.where(np.isfinite(rise_m), steps, FAR).astype(np.uint8)
