"""The patch of a touch that is compared with those of places, turned back by many yaws; compiled (numba)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.places import PATCH_PX, PITCH_M, Float32
from tactile_loc.core.sensing import Touch

# mypy: disable-error-code="no-untyped-def,no-untyped-call"


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
