"""The places of an object that can touch first, and the patch of a touch that is compared with what surrounds them.

A touch shows where its deepest point is, and turning it tries a yaw: what is left to search of all poses is the place
of the object that touches first, and the direction from which it does. Around each such place a patch of the object's
height map is kept, whatever the sensor and the press.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.geometry import make_transform, rotation_about
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry, Touch

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

Float32 = NDArray[np.float32]

PATCH_PX, PITCH_M = 41, 5e-4  # a patch's side, its place in the middle of the middle pixel
STEP_M, BELOW = 1.25e-5, 15  # heights are kept in such steps; so many of them lower than the place
FAR = 255  # steps: as high, or no surface at all
HIGHEST_M = (FAR - BELOW) * STEP_M

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
        rise_m = (self.patches[some].astype(np.float32) - BELOW) * np.float32(STEP_M)
        rise_m[self.patches[some] == FAR] = np.inf
        return np.clip(rise_m, 0.0, np.float32(press_depth_m))

    def poses(self, numbers: NDArray[np.int64], place_m: NDArray[np.float64], yaw_rad: NDArray[np.float64]) -> Poses:
        """Return the poses (K, 4, 4) in which places `numbers` (K,), turned by yaws (K,), are at place_m (K, 3)."""
        turn = rotation_about([0.0, 0.0, 1.0], yaw_rad)
        poses: Poses = make_transform(turn, place_m) @ self.T_place_object[numbers]
        return poses


def as_patches(rise_m: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Turn how much farther than its place a surface is (..., metres) into what `Places.patches` keeps of it."""
    with np.errstate(invalid="ignore"):
        steps = np.clip(np.rint(rise_m / STEP_M) + BELOW, 0, FAR)
    return np.where(np.isfinite(rise_m), steps, FAR).astype(np.uint8)


def turned_patches(
    touch: Touch, xy_m: NDArray[np.float64], yaw_rad: NDArray[np.float64]
) -> tuple[Float32, NDArray[np.bool_]]:
    """Return what a touch shows around xy_m (2,), metres, as CAMERA sees it turned back by each of M yaws (M,).

    That is contact depths (M, PATCH_PX, PATCH_PX), metres, cut at the touch's press depth, and which pixels the sensor
    observes; others are out of contact.
    """
    geometry, shape = touch.geometry, touch.contact_shape
    depth_m = np.empty((len(yaw_rad), PATCH_PX, PATCH_PX), np.float32)
    seen = np.empty(depth_m.shape, np.bool_)
    camera = (geometry.is_pinhole, geometry.fx, geometry.fy, geometry.cx, geometry.cy, geometry.standoff_m)
    in_threads(
        _turn, len(yaw_rad), shape.depth_m, shape.press_depth_m, geometry.observed_mask, camera,
        (float(xy_m[0]), float(xy_m[1])), np.asarray(yaw_rad, float), depth_m, seen,
    )  # fmt: skip
    return depth_m, seen


@njit
def _turn(first, last, depth, press, observed, camera, xy, yaws, patches, seen):
    """Fill the patches (M, S, S), and what is seen of them, of the yaws from first to last."""
    pinhole, fx, fy, cx, cy, standoff = camera
    side, half = patches.shape[1], (patches.shape[1] - 1) / 2
    for k in range(first, last):
        cosine, sine = math.cos(yaws[k]), math.sin(yaws[k])
        for r in range(side):
            for c in range(side):
                u, v = (c - half) * PITCH_M, (r - half) * PITCH_M
                x, y = xy[0] + cosine * u - sine * v, xy[1] + sine * u + cosine * v
                d, known = press, False
                for _ in range(2 if pinhole else 1):  # a pinhole camera sees what is deeper elsewhere
                    scale = 1.0 / (standoff + d) if pinhole else 1.0
                    column, row = math.floor(fx * x * scale + cx), math.floor(fy * y * scale + cy)
                    known = 0 <= column < depth.shape[1] and 0 <= row < depth.shape[0] and observed[row, column]
                    if not known:
                        break
                    d = min(depth[row, column], press)
                patches[k, r, c], seen[k, r, c] = (d if known else press), known
