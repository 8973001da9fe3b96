"""A touch's patch, rotated back by many yaws, and its comparison with the patches of places; compiled with numba.

On a curved gel, the patch is seen along the gel's normal at the contact, like the patches of places.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import math
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Ints, Poses, align_to_z, make_transform
from tactile_loc.core.places.places import BELOW, PATCH_PX, PITCH_M, STEP_M, Places
from tactile_loc.core.runtime.compiled import njit, run_in_threads
from tactile_loc.core.sensing.gel_surface import SLACK
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch


def find_anchor(touch: Touch) -> tuple[Floats, Floats]:
    """Return the deepest point (3,) of a touch, metres, in the sensor frame, and the gel's orientation there.

    The orientation is R_sensor_gel (3, 3). Its third axis is the gel's normal, which points out of the sensor.
    """
    geometry, shape = touch.geometry, touch.contact_shape
    depth = np.where(shape.contact & geometry.observed_mask, shape.depth_m, np.inf)
    row, column = np.unravel_index(depth.argmin(), depth.shape)
    z = float(np.broadcast_to(geometry.full_penetration_m, depth.shape)[row, column])
    x, y = (slopes[i] for slopes, i in zip(geometry.pixel_slopes, (column, row), strict=True))
    k = z if geometry.is_pinhole else 1.0
    return np.array([x * k, y * k, z]), _find_gel_frame(geometry, int(row), int(column))


def _find_gel_frame(geometry: SensorGeometry, row: int, column: int) -> Floats:
    if geometry.relief_m is None:
        return np.eye(3)
    rows, columns = (slice(max(0, i - 1), i + 2) for i in (row, column))
    around = geometry.relief_m[rows, columns].astype(float)
    sx, sy = geometry.scale_at_surface
    down, across = np.diff(around, axis=0).mean() * sy, np.diff(around, axis=1).mean() * sx
    return align_to_z(np.array([-across, -down, 1.0])).T


def rotate_patches(
    touch: Touch, anchor_m: Floats, R_sensor_gel: Floats, yaw_rad: Floats, known: Bools | None = None
) -> tuple[Float32, Bools]:
    """Return a touch's patch around its anchor (3,), metres, rotated back by each of M yaws (M,), as CAMERA sees it.

    The patches (M, PATCH_PX, PATCH_PX) are contact depths, metres, cut at the touch's press depth. They are measured
    from the anchor along the gel's normal, the third axis of R_sensor_gel (3, 3). Also returns which pixels, of the
    same shape, the sensor observes. All other pixels are out of contact. With `known` (H, W), only these pixels count
    as observed: see `Touch.find_known`.
    """
    geometry, shape = touch.geometry, touch.contact_shape
    observed = geometry.observed_mask if known is None else known
    depth_m = np.empty((len(yaw_rad), PATCH_PX, PATCH_PX), np.float32)
    seen = np.empty(depth_m.shape, np.bool_)
    camera = (geometry.is_pinhole, geometry.fx, geometry.fy, geometry.cx, geometry.cy)
    deepest_m = np.broadcast_to(np.asarray(geometry.full_penetration_m, np.float64), geometry.shape)
    shown = shape.depth_m, np.float32(shape.press_depth_m), observed, camera, deepest_m
    frame = anchor_m, R_sensor_gel
    run_in_threads(_fill_patches, len(yaw_rad), shown, frame, np.asarray(yaw_rad, float), depth_m, seen)
    return depth_m, seen


# Each round finds the pixel that sees a point of the patch, with the depth from the last round. On a flat gel, parallel
# rays need one round. A pinhole needs two, because the pixel depends on the depth.
@njit
def _fill_patches(first, last, shown, frame, yaws, patches, seen):
    """Fill `patches` (M, S, S) for the yaws from first to last, and `seen` with which pixels the sensor observes."""
    (depth, press, observed, camera, deepest), (at, R) = shown, frame
    pinhole, fx, fy, cx, cy = camera
    side, half = patches.shape[1], (patches.shape[1] - 1) / 2
    tilted = R[2, 2] < 1.0
    rounds = 4 if tilted else 2 if pinhole else 1
    for k in range(first, last):
        cosine, sine = math.cos(yaws[k]), math.sin(yaws[k])
        for r in range(side):
            for c in range(side):
                u, v = (c - half) * PITCH_M, (r - half) * PITCH_M
                a, b = cosine * u - sine * v, sine * u + cosine * v
                h, touched, known = press, False, False
                for _ in range(rounds):
                    z = at[2] + R[2, 0] * a + R[2, 1] * b + R[2, 2] * h
                    scale = 1.0 / z if pinhole else 1.0
                    x = at[0] + R[0, 0] * a + R[0, 1] * b + R[0, 2] * h
                    y = at[1] + R[1, 0] * a + R[1, 1] * b + R[1, 2] * h
                    column, row = math.floor(fx * x * scale + cx), math.floor(fy * y * scale + cy)
                    known = 0 <= column < depth.shape[1] and 0 <= row < depth.shape[0] and observed[row, column]
                    if not known:
                        break
                    touched = depth[row, column] < press
                    h += (deepest[row, column] + min(depth[row, column], press) - z) / R[2, 2]
                seen[k, r, c] = known
                patches[k, r, c] = min(max(h, 0.0), press) if known and touched else press


@njit(fast=True)
def _fill_excess(first, last, patches, pairs, bounds, most, excess):
    """Fill `excess` (K,) for the pairs from first to last. Heights are in the steps of the patches (N, S, S)."""
    (numbers, yaws), (low, high) = pairs, bounds
    side, zero = patches.shape[1], np.float32(0)
    columns = np.empty(side, np.float32)  # one sum for each column, so that the compiler handles several at once
    for k in range(first, last):
        n, m = numbers[k], yaws[k]
        columns[:] = zero
        for r in range(side):
            for c in range(side):
                height = np.float32(patches[n, r, c])
                under, over = low[m, r, c] - height, height - high[m, r, c]
                out = under if under > over else over
                out = out if out > zero else zero
                out = out if out < most else most
                columns[c] += out * out
        total = zero
        for c in range(side):
            total += columns[c]
        excess[k] = total


MOST_EXCESS = 0.3  # share of the press beyond which a place's distance from the gel's surface counts as equal


@dataclass(frozen=True, eq=False)
class TouchBounds:
    """The bounds of a touch for the surface of a place, for each of M yaws by which a place may be rotated.

    The surface of a place must lie between `low_m` and `high_m` (M, PATCH_PX, PATCH_PX), metres from the touch's
    deepest point. Unbounded pixels have infinite bounds. A pixel counts at most `most_m` metres. The yaws are about the
    z axis of the frame at the deepest point, `T_sensor_anchor` (4, 4), metres.
    """

    T_sensor_anchor: Poses
    low_m: Float32
    high_m: Float32
    most_m: float

    def measure_excess(self, places: Places, numbers: Ints, yaws: Ints) -> Float32:
        """Return how far rotated places leave the bounds, squared and summed over the patch (K,), square metres.

        Pair k is the place `numbers[k]` at the yaw number `yaws[k]`.
        """
        bounds = tuple(np.asarray(b / np.float32(STEP_M) + BELOW, np.float32) for b in (self.low_m, self.high_m))
        excess, most = np.empty(len(numbers), np.float32), np.float32(self.most_m / STEP_M)
        run_in_threads(_fill_excess, len(excess), places.patches, (numbers, yaws), bounds, most, excess)
        return excess * np.float32(STEP_M**2)


def bound_touch(touch: Touch, yaws_rad: Floats) -> TouchBounds:
    """Return the bounds of what an elastic gel shows, at M yaws.

    Where the gel touches, a place must be at the gel's surface. Elsewhere, it must be beyond the surface.
    """
    anchor_m, R_sensor_gel = find_anchor(touch)
    surface_m, seen = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad)
    contact = touch.geometry.observed_mask & touch.touching_shape.contact
    touching = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad, contact)[1]
    far = np.float32(np.inf)
    beyond_m = surface_m - np.float32(SLACK * touch.indentation_m)
    low_m = np.where(touching, surface_m, np.where(seen, beyond_m, -far))
    high_m = np.where(touching, surface_m, far)
    T_sensor_anchor = make_transform(R_sensor_gel, anchor_m)
    return TouchBounds(T_sensor_anchor, low_m, high_m, MOST_EXCESS * touch.indentation_m)
