"""Places: the points of an object that can touch first, with height maps of the surface around them.

A place touches at the deepest point of the touch, which gives the position. All yaws are tried by rotating the touch. A
search over places finds the rest: which point of the object touches first, and along which direction. Each place has a
patch, which is a height map of the surface around the place. A patch does not depend on the sensor or on the press.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Float32 = NDArray[np.float32]

PATCH_PX, PITCH_M = 41, 5e-4  # side of a patch, size of a pixel; the place is at the centre of the middle pixel
STEP_M, BELOW = 1.25e-5, 15  # size of a height step; number of steps kept for surface nearer than the place
FAR = 255  # value of a pixel without surface, or whose surface is at least HIGHEST_M beyond the place
HIGHEST_M = (FAR - BELOW) * STEP_M
PRESS_STEP_M = 1e-4  # step between the press depths at which touches are compared

CAMERA = SensorGeometry(
    "orthographic", PATCH_PX, PATCH_PX, 1 / PITCH_M, 1 / PITCH_M, PATCH_PX / 2, PATCH_PX / 2, 0.1, HIGHEST_M
)
"""The camera of a patch. It has parallel rays, and the place is at x = y = 0 on its sensing surface."""


@dataclass(frozen=True, eq=False)
class Places:
    """N places of an object, each seen along the direction from which it touches.

    The frame of `T_place_object` (N, 4, 4), metres, has its origin at the place. Its z axis points from the sensor into
    the object. `patches` (N, PATCH_PX, PATCH_PX), uint8, are heights of the surface along this axis, in steps of
    STEP_M. The place itself has the value BELOW. FAR means that there is no surface below HIGHEST_M.
    """

    T_place_object: Poses
    patches: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.patches)

    @property
    def placements(self) -> NDArray[np.float64]:
        """The positions, metres, and the unit directions (N, 6) of the places, in the object frame."""
        R, t = self.T_place_object[:, :3, :3], self.T_place_object[:, :3, 3]
        return np.concatenate([-np.einsum("nij,ni->nj", R, t), R[:, 2]], axis=1)

    def depths(self, press_depth_m: float, some: slice = slice(None)) -> Float32:
        """Return the contact depths (K, PATCH_PX, PATCH_PX), metres, of the places `some`, cut at the press depth."""
        return cut_patches(self.patches[some], press_depth_m)

    def poses(self, numbers: NDArray[np.int64], yaw_rad: NDArray[np.float64]) -> Poses:
        """Return poses (K, 4, 4), metres, that bring the places `numbers` (K,) to the origin, rotated by yaws (K,)."""
        R = rotation_about([0.0, 0.0, 1.0], yaw_rad)
        return np.asarray(make_transform(R, np.zeros(3)) @ self.T_place_object[numbers])


def cut_patches(patches: NDArray[np.uint8], press_depth_m: float) -> Float32:
    """Return the contact depths (...), metres, of values (...) of `Places.patches`, cut at the press depth."""
    press = np.float32(press_depth_m)
    depths_m = patches.astype(np.float32)
    depths_m -= BELOW
    depths_m *= np.float32(STEP_M)
    np.clip(depths_m, 0.0, press, out=depths_m)
    if (FAR - BELOW) * np.float32(STEP_M) < press:
        depths_m[patches == FAR] = press
    return depths_m


def make_patches(rise_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Convert heights (...), metres, of a surface above its place to the steps of `Places.patches`."""
    with np.errstate(invalid="ignore"):
        steps = np.clip(np.rint(rise_m / STEP_M) + BELOW, 0, FAR)
    return np.where(np.isfinite(rise_m), steps, FAR).astype(np.uint8)
