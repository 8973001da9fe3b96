"""The geometry of a sensor's camera and its gel.

The origin of the sensor frame is the virtual camera. +z points out of the sensor, towards the object. In the image, x
points right and y points down. The undeformed sensing surface is the plane z = standoff. Pixel centres lie at half
integers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.runtime.errors import SensorError
from tactile_loc.core.sensing.gel import RIGID, SOLVER_VERSION, Gel

Depth = Float32

LARGEST_PX = 8192
FEWEST_PX_M, MOST_PX_M = 1e-1, 1e7  # limits of plausible pixels per metre
SAME_RELIEF_M = 5e-5  # two gels count as the same if their surfaces differ by less


@dataclass(frozen=True, eq=False)
class SensorGeometry:
    """A sensor's virtual camera and gel, with or without an object that is pressed in.

    `fx` and `fy` are in pixels for a pinhole camera, and in pixels per metre for an orthographic camera. `cx` and `cy`
    are in pixels. `standoff_m` is the distance, metres, from the camera to the undeformed surface. `max_depth_m` is the
    deepest press, metres.

    `press` returns the sensor with an object pressed in by `indentation_m` metres. In that sensor, the object's deepest
    point is at z = `standoff_m`, and the sensor sees `max_depth_m` metres beyond this point. The undeformed surface is
    at z = `surface_m`.

    `rectangle_m` (x_min, x_max, y_min, y_max), metres, bounds the gel on the sensing surface. By default, the gel fills
    the image. `observed` (H, W), bool, is False at pixels without information. By default, all pixels on the rectangle
    have information. `relief_m` (H, W), float32, metres, describes a curved gel. At each pixel, it is the distance
    along z from `surface_m` to the undeformed gel. `gel` is the gel's elasticity. Raises SensorError if a number is
    implausible or contradicts another.
    """

    camera: Literal["pinhole", "orthographic"]
    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    standoff_m: float
    max_depth_m: float
    rectangle_m: tuple[float, float, float, float] | None = None
    observed: Bools | None = field(default=None, repr=False)
    indentation_m: float = 0.0
    relief_m: Depth | None = field(default=None, repr=False)
    gel: Gel = RIGID

    def __post_init__(self) -> None:
        if self.camera not in ("pinhole", "orthographic"):
            raise SensorError(f"the camera is {self.camera!r}; it must be 'pinhole' or 'orthographic'")
        positive = ("width_px", "height_px", "fx", "fy", "standoff_m", "max_depth_m")
        for name in positive:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SensorError(f"the sensor's {name} is {value}; give a positive number")
        if max(self.shape) > LARGEST_PX:
            raise SensorError(
                f"the sensor's image is {self.width_px} x {self.height_px} pixels; give at most {LARGEST_PX} per side"
            )
        if self.observed is not None and (self.observed.shape != self.shape or self.observed.dtype != np.bool_):
            raise SensorError(
                f"the mask of observed pixels is {self.observed.shape} {self.observed.dtype}; "
                f"it must be bool and as large as the image, {self.shape} (rows, columns)"
            )
        self._check_relief()
        if not all(FEWEST_PX_M <= scale <= MOST_PX_M for scale in self.scale_at_surface):
            x, y = (1e-3 * scale for scale in self.scale_at_surface)
            raise SensorError(
                f"the sensor sees {x:.3g} x {y:.3g} pixels per mm of its surface; check the camera's numbers"
            )
        x0, x1, y0, y1 = self.rectangle
        if not (x0 < x1 and y0 < y1):
            raise SensorError(f"the sensing rectangle {self.rectangle} is empty; give x_min < x_max and y_min < y_max")
        if not self.observed_mask.any():
            raise SensorError("no pixel of the sensor is observed; check the sensing rectangle and the mask")

    def _check_relief(self) -> None:
        if self.relief_m is None:
            return
        if self.relief_m.shape != self.shape or not np.isfinite(self.relief_m).all():
            raise SensorError(
                f"the undeformed surface is an array of shape {self.relief_m.shape}; give a number, metres, for each "
                f"pixel of the image, {self.shape} (rows, columns)"
            )
        if self.relief_m.min() <= -self.standoff_m:
            raise SensorError(
                f"the undeformed surface comes {-1e3 * self.relief_m.min():.3g} mm towards the camera, which is only "
                f"{1e3 * self.standoff_m:.3g} mm behind it; check its unit (metres) or the standoff"
            )

    @property
    def is_curved(self) -> bool:
        """True if the undeformed gel is curved."""
        return self.relief_m is not None

    @property
    def full_penetration_m(self) -> float | Depth:
        """The z, metres, from which contact depths are measured: one number, or (H, W) if the gel is curved."""
        return self.standoff_m if self.relief_m is None else np.float32(self.standoff_m) + self.relief_m

    @cached_property
    def band(self) -> SensorGeometry:
        """The same sensor with a flat gel, for renderers. Its contact band includes the band of this sensor."""
        if self.relief_m is None:
            return self
        least, most = float(self.relief_m.min()), float(self.relief_m.max())
        return dataclasses.replace(
            self, standoff_m=self.standoff_m + least, max_depth_m=self.max_depth_m + most - least, relief_m=None
        )

    @property
    def surface_m(self) -> float:
        """The distance, metres, from the camera to the undeformed surface, also while an object is pressed in."""
        return self.standoff_m + self.indentation_m

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (H, W) in pixels."""
        return self.height_px, self.width_px

    @property
    def is_pinhole(self) -> bool:
        """True if the rays spread from one point (pinhole), False if they are parallel (orthographic)."""
        return self.camera == "pinhole"

    @property
    def scale_at_surface(self) -> tuple[float, float]:
        """Pixels per metre (x, y) on the undeformed sensing surface."""
        k = self.surface_m if self.is_pinhole else 1.0
        return self.fx / k, self.fy / k

    @property
    def pixel_pitch_m(self) -> float:
        """Mean size of a pixel on the undeformed sensing surface, metres."""
        sx, sy = self.scale_at_surface
        return 0.5 * (1.0 / sx + 1.0 / sy)

    @property
    def view(self) -> tuple[float, float, float, float]:
        """The part of the undeformed surface that the image sees (x_min, x_max, y_min, y_max), metres."""
        sx, sy = self.scale_at_surface
        return -self.cx / sx, (self.width_px - self.cx) / sx, -self.cy / sy, (self.height_px - self.cy) / sy

    @property
    def rectangle(self) -> tuple[float, float, float, float]:
        """The sensing rectangle (x_min, x_max, y_min, y_max) in metres on the undeformed surface."""
        return self.view if self.rectangle_m is None else self.rectangle_m

    @cached_property
    def gel_middle_m(self) -> Floats:
        """The middle (3,) of the sensing rectangle on the undeformed surface, metres, in the sensor frame."""
        x0, x1, y0, y1 = self.rectangle
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2, self.surface_m])

    @cached_property
    def pixel_slopes(self) -> tuple[Floats, Floats]:
        """The x/z of each column's rays (W,) and the y/z of each row's rays (H,); x and y, metres, if orthographic."""
        u = np.arange(self.width_px, dtype=np.float64) + 0.5
        v = np.arange(self.height_px, dtype=np.float64) + 0.5
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

    @cached_property
    def on_rectangle(self) -> Bools:
        """Pixels (H, W) on the sensing rectangle."""
        k = self.surface_m if self.is_pinhole else 1.0
        x, y = (s * k for s in self.pixel_slopes)
        x0, x1, y0, y1 = self.rectangle
        return ((y >= y0) & (y <= y1))[:, None] & ((x >= x0) & (x <= x1))[None, :]

    @cached_property
    def observed_mask(self) -> Bools:
        """Pixels (H, W) with information: on the sensing rectangle and not masked."""
        return self.on_rectangle if self.observed is None else self.on_rectangle & self.observed

    def backproject(self, depth_m: NDArray[np.floating[Any]]) -> Floats:
        """Convert depths z (..., H, W), metres, to points (..., H, W, 3) in the sensor frame, metres."""
        x, y = np.meshgrid(*self.pixel_slopes)
        z = np.asarray(depth_m, float)
        k = z if self.is_pinhole else np.ones_like(z)
        return np.stack([x * k, y * k, z], axis=-1)

    def resize(self, width_px: int, height_px: int) -> SensorGeometry:
        """Return the same sensor with another image size in pixels. fx, fy, cx and cy scale exactly."""
        kx, ky = width_px / self.width_px, height_px / self.height_px
        observed = None
        if self.observed is not None:
            rows = ((np.arange(height_px) + 0.5) / ky).astype(int)
            columns = ((np.arange(width_px) + 0.5) / kx).astype(int)
            observed = self.observed[np.ix_(rows, columns)]
        relief_m = self._resize_relief(width_px, height_px)
        return dataclasses.replace(
            self,
            width_px=width_px,
            height_px=height_px,
            observed=observed,
            relief_m=relief_m,
            fx=self.fx * kx,
            fy=self.fy * ky,
            cx=self.cx * kx,
            cy=self.cy * ky,
        )

    def _resize_relief(self, width_px: int, height_px: int) -> Depth | None:
        """Return the relief, metres, at another image size, interpolated linearly between pixel centres."""
        if self.relief_m is None or (height_px, width_px) == self.shape:
            return self.relief_m
        from scipy.ndimage import map_coordinates

        sizes = zip((height_px, width_px), self.shape, strict=True)
        at = np.meshgrid(*((np.arange(new) + 0.5) * old / new - 0.5 for new, old in sizes), indexing="ij")
        return np.asarray(map_coordinates(self.relief_m, at, np.float32, order=1, mode="nearest"))

    def subsample(self, step: int) -> SensorGeometry:
        """Return the sensor with only the pixels that [::step, ::step] selects from an image."""
        rows, columns = len(range(0, self.height_px, step)), len(range(0, self.width_px, step))
        observed = None if self.observed is None else self.observed[::step, ::step]
        relief_m = None if self.relief_m is None else self.relief_m[::step, ::step]
        return dataclasses.replace(
            self,
            width_px=columns,
            height_px=rows,
            fx=self.fx / step,
            fy=self.fy / step,
            cx=(self.cx - 0.5) / step + 0.5,
            cy=(self.cy - 0.5) / step + 0.5,
            rectangle_m=self.rectangle,
            observed=observed,
            relief_m=relief_m,
        )

    def press(self, indentation_m: float, press_depth_m: float | None = None) -> SensorGeometry:
        """Return the sensor with an object that is pressed `indentation_m` metres into the gel.

        The visible range begins at the object's deepest point, at z = surface - indentation. It ends `press_depth_m`
        metres beyond this point, by default at the undeformed surface. The camera, the rectangle and the observed
        pixels do not change. Raises SensorError if the indentation is not positive or reaches the camera.
        """
        if not 0 < indentation_m < self.surface_m:
            raise SensorError(
                f"an object cannot be pressed in by {indentation_m * 1e3:.3g} mm; the camera is "
                f"{self.surface_m * 1e3:.3g} mm behind the surface"
            )
        return dataclasses.replace(
            self,
            standoff_m=self.surface_m - indentation_m,
            indentation_m=indentation_m,
            max_depth_m=indentation_m if press_depth_m is None else press_depth_m,
        )

    def resize_long_side(self, pixels: int) -> SensorGeometry:
        """Return the same sensor, resized so that the longer side of its image has `pixels` pixels."""
        k = pixels / max(self.shape)
        return self.resize(max(1, round(self.width_px * k)), max(1, round(self.height_px * k)))

    def is_same_sensor(self, other: SensorGeometry) -> bool:
        """Return whether `other` has the same camera model, gel and field of view, to within a pixel.

        The image size, the mask and the press may differ.
        """
        ours, theirs = ((g.surface_m, *g.rectangle) for g in (self, other))
        same = self.camera == other.camera and np.allclose(ours, theirs, rtol=1e-6, atol=1e-9)
        if self.indentation_m == other.indentation_m:
            same = same and math.isclose(self.max_depth_m, other.max_depth_m, rel_tol=1e-6)
        same = same and self.gel == other.gel and self._is_as_curved(other)
        apart_m = np.abs(np.subtract(self.view, other.view)).max()
        return bool(same and apart_m < max(self.pixel_pitch_m, other.pixel_pitch_m))

    def _is_as_curved(self, other: SensorGeometry) -> bool:
        if self.relief_m is None or other.relief_m is None:
            return self.relief_m is other.relief_m
        theirs_m = np.asarray(other._resize_relief(self.width_px, self.height_px))
        return bool(np.abs(self.relief_m - theirs_m).max() < SAME_RELIEF_M)

    def describe(self) -> dict[str, Any]:
        """Return what identifies the sensor, as JSON values: metres, pixels, and digests of the mask and the relief."""
        arrays = {"observed": self.observed, "relief_m": self.relief_m}
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in {*arrays, "gel"}}
        digests = {
            name: None if array is None else hashlib.sha256(_pack_bytes(array)).hexdigest()
            for name, array in arrays.items()
        }
        if self.relief_m is None:  # so that flat sensors keep their keys in the store
            del digests["relief_m"]
        rectangle = None if self.rectangle_m is None else list(self.rectangle_m)
        elastic = {"gel": {**self.gel.describe(), "solver": SOLVER_VERSION}}
        gel = elastic if self.gel.is_elastic else {}  # so that rigid gels keep their keys
        return {**fields, "rectangle_m": rectangle, **digests, **gel}


def _pack_bytes(array: NDArray[Any]) -> bytes:
    return (np.packbits(array) if array.dtype == np.bool_ else array).tobytes()
