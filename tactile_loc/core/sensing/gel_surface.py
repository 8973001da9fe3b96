"""Gel surfaces: what an elastic gel shows of an object pressed into it, and where the gel touches the object.

The inverse recovers the pressure and the displacement from the slopes that a camera sees. The camera sees the underside
of the gel's coating, whose displacement is v = F^-1[K C F[p]] (see `core.sensing.gel`). The pressure is the p >= 0 for
which the slopes of v are nearest to the seen slopes, in the least-squares sense. Slopes determine the pressure well:
both are of the same order, because C falls with the wave number. The displacement of the surface, u = F^-1[C F[p]],
then has its absolute level, which an integral of the slopes does not have, and the sharp features that the coating
hides. The solver is the accelerated projected gradient method of Beck and Teboulle (SIAM J. Imaging Sciences 2, 2009).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32
from tactile_loc.core.sensing.gel import (
    ITERATIONS,
    Contact,
    Gel,
    GelSolver,
    compute_smoothing,
    list_wave_numbers,
    make_solver,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

PITCH_M = 2e-4  # the contact is solved on pixels of about this size
LEAST_SLACK_M, SLACK = 1.2e-5, 0.1  # by which a gel surface is lowered to find the contact: metres; share of the press
LIFTED_M = 1e-6  # a gel that is farther than this from the object does not touch it
MARGIN = 2.0  # thicknesses of the layer around a contact beyond which the gel does not move
STEP_PX = 16  # windows grow by this much, so that few sizes occur

Indentation = float | NDArray[np.floating[Any]]


def deform_gel(
    depth_m: Float32, indentation_m: Indentation, geometry: SensorGeometry, iterations: int = ITERATIONS
) -> Float32:
    """Return the contact depths (N, H, W), metres, that the gel shows of objects pressed in by `indentation_m` metres.

    `depth_m` (N, H, W), metres, are the contact depths in a rigid gel. The indentations are one number or (N,). An
    elastic gel is also displaced around the contact. There is no gel beyond the sensing rectangle.
    """
    if not geometry.gel.is_elastic or not len(depth_m):
        return depth_m
    press = np.asarray(indentation_m, np.float32).reshape(-1, 1, 1)
    pressed = np.asarray((depth_m < press) & geometry.on_rectangle)
    reach = np.where(pressed, press - depth_m, np.float32(-np.inf))
    window = Window.around(np.asarray(pressed.any(axis=0)), geometry, MARGIN * float(geometry.gel.thickness_m or 0))
    contact = window.solver.press(window.reduce(reach), iterations)
    # where the gel touches the object, it has the object's shape at the full resolution
    touching = window.enlarge((contact.pressure > 0).astype(np.float32)) == 1
    moved = np.maximum(window.enlarge(contact.displacement_m), reach)
    moved = np.where(touching & pressed, reach, moved)
    return np.where(geometry.on_rectangle, np.clip(press - moved, 0, press), press)


def find_touching(depth_m: Float32, indentation_m: float, geometry: SensorGeometry) -> Bools:
    """Mark the pixels (H, W) at which an elastic gel touches the object, given contact depths (H, W), metres.

    The gel surface itself is pressed into the gel as a rigid object. The pressure of a contact is unique, so there is
    pressure only where the real object touches. The surface is lowered a little, so that its errors beside the real
    contact touch nothing.
    """
    reach = np.float32(indentation_m - max(LEAST_SLACK_M, SLACK * indentation_m)) - depth_m
    pressed = (reach > 0) & geometry.on_rectangle
    window = Window.around(pressed, geometry, 0.0)
    reach = np.where(pressed, reach, np.float32(-np.inf))
    pressure = window.solver.press(window.reduce(reach[None]), 3 * ITERATIONS).pressure
    return np.asarray(window.enlarge((pressure > 0).astype(np.float32))[0] > 0.5) & pressed


def mark_touching(depth_m: Float32, shown_m: Float32, indentation_m: float) -> Bools:
    """Mark the pixels (N, H, W) at which an elastic gel touches objects, whose shape is known.

    `depth_m` (N, H, W), metres, are the contact depths in a rigid gel, and `shown_m` those that the elastic gel shows
    (`deform_gel`).
    """
    return np.asarray((depth_m < np.float32(indentation_m)) & (shown_m > depth_m - np.float32(LIFTED_M)))


@dataclass(frozen=True, eq=False)
class Window:
    """The part of a sensor's image in which a contact is solved: every `step`-th pixel of `rows` and `columns`."""

    geometry: SensorGeometry
    rows: slice
    columns: slice
    step: int

    @classmethod
    def around(cls, pressed: Bools, geometry: SensorGeometry, margin_m: float) -> Window:
        """Return the window around pixels (H, W), with a margin in metres."""
        step = max(1, round(PITCH_M / geometry.pixel_pitch_m))
        spans = []
        for axis, scale in ((0, geometry.scale_at_surface[1]), (1, geometry.scale_at_surface[0])):
            where, side = np.flatnonzero(pressed.any(axis=1 - axis)), pressed.shape[axis]
            first, last = (where[0], where[-1] + 1) if len(where) else (0, 1)
            margin = side if math.isinf(margin_m) else math.ceil(margin_m * scale) + step
            wanted = STEP_PX * step * math.ceil((min(last + margin, side) - max(first - margin, 0)) / (STEP_PX * step))
            start = max(0, min(first - margin, side - wanted))
            spans.append(slice(start, min(side, start + wanted)))
        return cls(geometry, spans[0], spans[1], step)

    @cached_property
    def _shape(self) -> tuple[int, int]:
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @cached_property
    def _first(self) -> int:
        return (self.step - 1) // 2

    @cached_property
    def solved(self) -> tuple[tuple[int, int], tuple[float, float]]:
        """The shape (h, w) of the solved pixels, and their pitch (x, y), metres."""
        height, width = (len(range(self._first, side, self.step)) for side in self._shape)
        x, y = (self.step / scale for scale in self.geometry.scale_at_surface)
        return (height, width), (x, y)

    @cached_property
    def solver(self) -> GelSolver:
        """The solver of the window's contacts."""
        return make_solver(self.geometry.gel, *self.solved)

    def reduce(self, images: Float32) -> Float32:
        """Return the solved pixels (N, h, w) of images (N, H, W)."""
        return images[:, self.rows, self.columns][:, self._first :: self.step, self._first :: self.step]

    def enlarge(self, images: Float32) -> Float32:
        """Interpolate images (N, h, w) linearly at all pixels (N, H, W); beyond the window they are 0."""
        if self.step > 1:
            rows, columns = (
                _make_interpolation(few, many, self.step, self._first)
                for few, many in zip(images.shape[1:], self._shape, strict=True)
            )
            images = np.asarray(rows @ images @ columns.T)
        whole = np.zeros((len(images), *self.geometry.shape), np.float32)
        whole[:, self.rows, self.columns] = images
        return whole


@lru_cache(maxsize=64)
def _make_interpolation(few: int, many: int, step: int, first: int) -> Float32:
    """Return weights (many, few) of linear interpolation; beyond the outer pixels, their values continue."""
    at = (np.arange(many) - first) / step
    return np.stack([np.interp(at, np.arange(few), one) for one in np.eye(few)], axis=1).astype(np.float32)


STEPS = 20  # of each of the two searches for the pressure
CONTINUED = 4  # steps after which the slopes beyond the image are predicted anew
LEAST = 0.5  # pressure at the contact's border, as a share of the contact's median pressure
RIDGE = 0.01  # weight of the squared pressure, as a share of the steepest response; it damps ringing at edges
SMOOTHING_PX = 1.0  # standard deviation of the smoothing of the pressure before the contact's border is sought

Mask = Bools


def recover_contact(slopes: Float32, candidates: Mask, geometry: SensorGeometry) -> Contact:
    """Return the contact, with displacements and pressures (H, W), given seen slopes (H, W, 2) along x and y, unitless.

    Only the `candidates` (H, W) can touch the object. After a first search, pixels with little pressure no longer
    count as candidates. Slopes are ignored where the sensor does not observe the gel.
    """
    from scipy.ndimage import gaussian_filter

    window = Window.around(np.ones(geometry.shape, bool), geometry, 0.0)
    planes = np.moveaxis(np.where(geometry.observed_mask[..., None], slopes, 0), -1, 0).astype(np.float32)
    few = window.reduce(gaussian_filter(planes, (0, *2 * [0.3 * window.step])))
    masks = np.stack([geometry.observed_mask, candidates & geometry.observed_mask])
    seen, allowed = window.reduce(masks.astype(np.float32)) > 0.5
    inverse = _make_inverse(geometry.gel, *window.solved)
    pressure = inverse.search(few, seen, allowed, np.zeros(few.shape[1:], np.float32))
    smooth = gaussian_filter(pressure, SMOOTHING_PX)
    pressed = allowed & (smooth > 0)
    if pressed.any():
        touching = allowed & (smooth > LEAST * np.median(smooth[pressed]))
        pressure = inverse.search(few, seen, touching, np.where(touching, pressure, np.float32(0)))
    both = window.enlarge(np.stack([inverse.solver.displace(pressure[None])[0], pressure]))
    return Contact(both[0], np.where(candidates, both[1], np.float32(0)))


class _Inverse:
    """Finds pressures on a window of `shape` (H, W) pixels with `pitch_m` (x, y) metres."""

    def __init__(self, gel: Gel, shape: tuple[int, int], pitch_m: tuple[float, float]) -> None:
        self.shape, self.solver = shape, make_solver(gel, shape, pitch_m)
        qx, qy = list_wave_numbers(self.solver.padded, pitch_m)
        seen = self.solver.compliance * compute_smoothing(np.hypot(qx, qy), gel)
        steps = (np.sin(qx * pitch_m[0]) / pitch_m[0], np.sin(qy * pitch_m[1]) / pitch_m[1])  # central differences
        self._slopes = np.stack([1j * step * seen for step in steps]).astype(np.complex64)
        power = (np.abs(self._slopes) ** 2).sum(axis=0)
        self._power = power + RIDGE * power.max()
        self._steepest = np.float32(self._power.max())

    def search(self, slopes: Float32, seen: Mask, allowed: Mask, pressure: Float32) -> Float32:
        """Return the pressures (H, W) that explain slopes (2, H, W) at the `seen` pixels (H, W) best.

        The pressure is zero except at the `allowed` pixels (H, W). `pressure` (H, W) is a guess to start from.
        """
        from scipy import fft

        height, width = self.shape
        known = np.zeros((2, *self.solver.padded), bool)
        known[:, :height, :width] = seen
        measured = np.zeros(known.shape, np.float32)
        measured[:, :height, :width] = slopes
        ahead, last, momentum = pressure, pressure, 1.0
        for step in range(STEPS):
            if step % CONTINUED == 0:  # the model's own slopes continue the seen slopes
                modelled = fft.irfft2(self._slopes * fft.rfft2(last, self.solver.padded), self.solver.padded)
                spectrum = fft.rfft2(np.where(known, measured, modelled))
                wanted = (np.conj(self._slopes) * spectrum).sum(axis=0)
            rest = fft.irfft2(self._power * fft.rfft2(ahead, self.solver.padded) - wanted, self.solver.padded)
            found = np.where(allowed, np.maximum(ahead - rest[:height, :width] / self._steepest, np.float32(0)), 0)
            after = 0.5 * (1 + math.sqrt(1 + 4 * momentum**2))
            ahead = (found + np.float32((momentum - 1) / after) * (found - last)).astype(np.float32)
            last, momentum = found.astype(np.float32), after
        return last


_make_inverse = lru_cache(maxsize=8)(_Inverse)
