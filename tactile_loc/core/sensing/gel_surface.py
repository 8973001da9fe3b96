"""Gel surfaces: what an elastic gel shows of an object pressed into it, and where the gel touches the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.gel import ITERATIONS, Float32, GelSolver, make_solver
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


def find_touching(depth_m: Float32, indentation_m: float, geometry: SensorGeometry) -> NDArray[np.bool_]:
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


def mark_touching(depth_m: Float32, shown_m: Float32, indentation_m: float) -> NDArray[np.bool_]:
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
    def around(cls, pressed: NDArray[np.bool_], geometry: SensorGeometry, margin_m: float) -> Window:
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
    at = np.clip((np.arange(many) - first) / step, 0, few - 1)
    low = np.minimum(at.astype(int), max(few - 2, 0))
    weights = np.zeros((many, few), np.float32)
    weights[np.arange(many), low] = 1 - (at - low)
    if few > 1:
        weights[np.arange(many), low + 1] = at - low
    return weights
