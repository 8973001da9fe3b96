"""Places: the points of an object that can touch first, with height maps of the surface around them.

A place touches at the deepest point of the touch, which gives the position. All yaws are tried by rotating the touch. A
search over places finds the rest: which point of the object touches first, and along which direction. Each place has a
patch, which is a height map of the surface around the place. A patch does not depend on the sensor or on the press.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats, Ints, Poses, align_to_z, make_transform, rotation_about
from tactile_loc.core.runtime.compiled import njit, run_in_threads
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

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

    @classmethod
    def at(cls, placements: NDArray[np.floating[Any]], patches: NDArray[np.uint8]) -> Self:
        """Return the places at `placements` (N, 6), as the property. Each is seen without a turn about its direction.

        The rotation that maps the direction to +z is the smallest one.
        """
        position_m, direction = np.split(placements.astype(float), 2, axis=1)
        R = align_to_z(direction)
        return cls(make_transform(R, -np.einsum("nij,nj->ni", R, position_m)), patches)

    def __len__(self) -> int:
        return len(self.patches)

    @property
    def placements(self) -> Floats:
        """The positions, metres, and the unit directions (N, 6) of the places, in the object frame."""
        R, t = self.T_place_object[:, :3, :3], self.T_place_object[:, :3, 3]
        return np.concatenate([-np.einsum("nij,ni->nj", R, t), R[:, 2]], axis=1)

    def depths(self, press_depth_m: float, some: slice = slice(None)) -> Float32:
        """Return the contact depths (K, PATCH_PX, PATCH_PX), metres, of the places `some`, cut at the press depth."""
        return cut_patches(self.patches[some], press_depth_m)

    def poses(self, numbers: Ints, yaw_rad: Floats) -> Poses:
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


def average_patches(patches: NDArray[np.uint8], signal: Float32, rows: Float32, columns: Float32) -> Float32:
    """Return weighted sums of a signal over cells of patches: an array (N, R, C), in the unit of the signal.

    A pixel of the patches (N, H, W) with the value v has the signal (256,) of v. The sums of a patch are `rows` (R, H)
    @ signals (H, W) @ `columns` (C, W) transposed. A pixel may have a weight in at most two cells, one after the other.
    High values without signal are skipped, so this is fast if most pixels have them. Raises ValueError if a pixel is
    in more cells.
    """
    sums = np.empty((len(patches), len(rows), len(columns)), np.float32)
    end = int(np.flatnonzero(signal).max(initial=-1)) + 1
    parts = signal[:end], _split_weights(rows), _split_weights(columns)
    run_in_threads(_fill_sums, len(patches), np.ascontiguousarray(patches), *parts, sums)
    return sums


def _split_weights(weights: Float32) -> tuple[Ints, Float32, Float32]:
    """Return the first cell of each pixel (P,), and its weights (P,) in this and the next cell, from (cells, P)."""
    cells, pixels = weights.shape
    firsts = np.minimum((weights != 0).argmax(axis=0), max(0, cells - 2))
    here = weights[firsts, np.arange(pixels)]
    after = weights[firsts + 1, np.arange(pixels)] if cells > 1 else np.zeros_like(here)
    if np.count_nonzero(weights) > np.count_nonzero(here) + np.count_nonzero(after):
        raise ValueError("a pixel is in more than two cells, or in two that are apart; average over fewer cells")
    return firsts.astype(np.int64), here, after


@njit(fast=True)
def _fill_sums(first, last, patches, signal, rows, columns, sums):
    """Fill `sums` (N, R, C) for the patches (N, H, W) from first to last: see `average_patches`.

    Values beyond those of `signal` have no signal. `rows` are the first cell (H,) of each pixel row, and its weights
    (H,) in this and the next cell. `columns` are the same for pixel columns.
    """
    (row, row_here, row_after), (column, here, after), end = rows, columns, len(signal)
    height, width = patches.shape[1], patches.shape[2]
    line, cells = np.empty(sums.shape[2], np.float32), np.empty(sums.shape[1:], np.float32)
    for n in range(first, last):
        cells[:] = np.float32(0)
        for r in range(height):
            least = np.uint8(255)
            for c in range(width):
                least = min(least, patches[n, r, c])
            if least >= end:
                continue
            line[:] = np.float32(0)
            for c in range(width):
                value = patches[n, r, c]
                if value < end:
                    line[column[c]] += here[c] * signal[value]
                    if after[c] != 0:
                        line[column[c] + 1] += after[c] * signal[value]
            for j in range(len(line)):
                cells[row[r], j] += row_here[r] * line[j]
            if row_after[r] != 0:
                for j in range(len(line)):
                    cells[row[r] + 1, j] += row_after[r] * line[j]
        sums[n] = cells


def split_patches(patches: NDArray[np.uint8]) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Split patches (N, PATCH_PX, PATCH_PX) into two arrays that compress well: see `join_patches`.

    Three of four pixels show no surface. The others differ little from the pixel before.
    """
    seen = (patches != FAR).ravel()
    starts = np.flatnonzero(np.diff(seen, prepend=False))
    runs = np.diff(starts, prepend=0, append=seen.size).astype(np.uint32)
    return runs, np.diff(patches.ravel()[seen], prepend=np.uint8(0))


def join_patches(runs: NDArray[np.uint32], changes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the patches (N, PATCH_PX, PATCH_PX) that `split_patches` split.

    `runs` are the numbers of consecutive pixels without surface and with surface, in turn, beginning with pixels
    without surface. `changes` are the differences, modulo 256, between consecutive pixels with surface.
    """
    pixels = np.full(int(runs.sum(dtype=np.int64)), FAR, np.uint8)
    _fill_pixels(runs, changes, pixels)
    return pixels.reshape(-1, PATCH_PX, PATCH_PX)


@njit
def _fill_pixels(runs, changes, pixels):
    """Fill the pixels (P,) with surface from `runs` and `changes`; the others are FAR."""
    pixel, change, value = 0, 0, np.uint8(0)
    for k in range(1, len(runs), 2):
        pixel += runs[k - 1]
        for _ in range(runs[k]):
            value = np.uint8(value + changes[change])
            pixels[pixel] = value
            pixel, change = pixel + 1, change + 1
