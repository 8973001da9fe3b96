"""What a sensor sees: its camera geometry, the contact shape, and the touch.

The sensor frame is the virtual camera's: origin at the camera, +z out of the sensor towards the object, x right and
y down in the image. The undeformed sensing surface is the plane z = standoff. Pixel centres lie at half integers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.errors import NoContactError, SensorError, TouchError
from tactile_loc.core.geometry import is_rigid

Depth = NDArray[np.float32]

LARGEST_PX = 8192
FEWEST_PX_M, MOST_PX_M = 1e-1, 1e7  # pixels a metre: what lies beyond is no length, whatever its unit
SAME_RELIEF_M = 5e-5  # two gels whose surfaces differ by less are one


@dataclass(frozen=True, eq=False)
class SensorGeometry:
    """The virtual camera behind the sensing surface.

    `fx`, `fy` are pixels for a pinhole camera and pixels per metre for an orthographic one; `cx`, `cy` are pixels.
    `standoff_m` is the distance from the camera to the undeformed surface, `max_depth_m` the deepest press in metres.
    While an object is pressed in by `indentation_m` metres (see `pressed`), its deepest point is at z = `standoff_m`
    and it is seen up to `max_depth_m` metres beyond; `surface_m` is where the undeformed surface is.
    `rectangle_m` (x_min, x_max, y_min, y_max) bounds the gel on the sensing surface; by default all that the image
    sees of it. `observed` (H, W) bool is False at pixels that carry no information; by default all pixels whose view
    of the sensing surface lies on the rectangle count. `relief_m` (H, W) float32 is how much farther along z than
    `surface_m` a pixel sees the undeformed gel, in metres, where that is not flat. Raises SensorError when the numbers
    contradict one another.
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
    observed: NDArray[np.bool_] | None = field(default=None, repr=False)
    indentation_m: float = 0.0
    relief_m: Depth | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.camera not in ("pinhole", "orthographic"):
            raise SensorError(f"the camera is {self.camera!r}; it must be 'pinhole' or 'orthographic'")
        positive = ("width_px", "height_px", "fx", "fy", "standoff_m", "max_depth_m")
        for name in positive:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SensorError(f"the sensor's {name} is {value}; it must be a positive number")
        if max(self.shape) > LARGEST_PX:
            raise SensorError(
                f"the sensor's image is {self.width_px} x {self.height_px} pixels; at most {LARGEST_PX} a side"
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
                f"the sensor sees {x:.3g} x {y:.3g} pixels a mm of its surface; check the camera's numbers"
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
                f"the undeformed surface is an array of shape {self.relief_m.shape}; it must hold a number, metres, "
                f"for each pixel of the image, {self.shape} (rows, columns)"
            )
        if self.relief_m.min() <= -self.standoff_m:
            raise SensorError(
                f"the undeformed surface comes {-1e3 * self.relief_m.min():.3g} mm towards the camera, which is only "
                f"{1e3 * self.standoff_m:.3g} mm behind it; check its unit (metres) or the standoff"
            )

    @property
    def is_curved(self) -> bool:
        """Whether the undeformed gel is not flat."""
        return self.relief_m is not None

    @property
    def full_penetration_m(self) -> float | Depth:
        """Where contact depths begin: z at the deepest point of contact; at each pixel (H, W) if the gel is curved."""
        return self.standoff_m if self.relief_m is None else np.float32(self.standoff_m) + self.relief_m

    @cached_property
    def band(self) -> SensorGeometry:
        """The sensor with a flat gel whose contact band holds all of this one's: what renderers are given."""
        if self.relief_m is None:
            return self
        least, most = float(self.relief_m.min()), float(self.relief_m.max())
        return dataclasses.replace(
            self, standoff_m=self.standoff_m + least, max_depth_m=self.max_depth_m + most - least, relief_m=None
        )

    @property
    def surface_m(self) -> float:
        """Distance from the camera to the undeformed surface, metres, pressed or not."""
        return self.standoff_m + self.indentation_m

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (H, W) in pixels."""
        return self.height_px, self.width_px

    @property
    def is_pinhole(self) -> bool:
        """Whether rays spread from one point (pinhole) rather than run parallel (orthographic)."""
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
        """What the image sees (x_min, x_max, y_min, y_max), in metres, of the undeformed surface."""
        sx, sy = self.scale_at_surface
        return -self.cx / sx, (self.width_px - self.cx) / sx, -self.cy / sy, (self.height_px - self.cy) / sy

    @property
    def rectangle(self) -> tuple[float, float, float, float]:
        """The sensing rectangle (x_min, x_max, y_min, y_max) in metres on the undeformed surface."""
        return self.view if self.rectangle_m is None else self.rectangle_m

    @cached_property
    def pixel_slopes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Per column (W,) and per row (H,): x/z and y/z of a pinhole's rays, or x and y in metres (orthographic)."""
        u = np.arange(self.width_px, dtype=np.float64) + 0.5
        v = np.arange(self.height_px, dtype=np.float64) + 0.5
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

    @cached_property
    def observed_mask(self) -> NDArray[np.bool_]:
        """Pixels (H, W) that carry information: on the sensing rectangle and not masked."""
        k = self.surface_m if self.is_pinhole else 1.0
        x, y = (s * k for s in self.pixel_slopes)
        x0, x1, y0, y1 = self.rectangle
        inside = ((y >= y0) & (y <= y1))[:, None] & ((x >= x0) & (x <= x1))[None, :]
        return inside if self.observed is None else inside & self.observed

    def backproject(self, depth_m: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Turn depths z (..., H, W) in metres into points (..., H, W, 3) in the sensor frame, metres."""
        x, y = np.meshgrid(*self.pixel_slopes)
        z = np.asarray(depth_m, float)
        k = z if self.is_pinhole else np.ones_like(z)
        return np.stack([x * k, y * k, z], axis=-1)

    def resized(self, width_px: int, height_px: int) -> SensorGeometry:
        """Return the same sensor with another image size in pixels; intrinsics scale exactly."""
        kx, ky = width_px / self.width_px, height_px / self.height_px
        observed = None
        if self.observed is not None:
            rows = ((np.arange(height_px) + 0.5) / ky).astype(int)
            columns = ((np.arange(width_px) + 0.5) / kx).astype(int)
            observed = self.observed[np.ix_(rows, columns)]
        relief_m = self._relief_at(width_px, height_px)
        return dataclasses.replace(
            self, width_px=width_px, height_px=height_px, observed=observed, relief_m=relief_m,
            fx=self.fx * kx, fy=self.fy * ky, cx=self.cx * kx, cy=self.cy * ky,
        )  # fmt: skip

    def _relief_at(self, width_px: int, height_px: int) -> Depth | None:
        """The relief (height, width) at another image size, metres: linear between the pixels' centres."""
        if self.relief_m is None or (height_px, width_px) == self.shape:
            return self.relief_m
        from scipy.ndimage import map_coordinates

        sizes = zip((height_px, width_px), self.shape, strict=True)
        at = np.meshgrid(*((np.arange(new) + 0.5) * old / new - 0.5 for new, old in sizes), indexing="ij")
        return np.asarray(map_coordinates(self.relief_m, at, np.float32, order=1, mode="nearest"))

    def every(self, step: int) -> SensorGeometry:
        """Return the sensor that sees only every `step`-th pixel, from the first: what [::step, ::step] keeps."""
        rows, columns = len(range(0, self.height_px, step)), len(range(0, self.width_px, step))
        observed = None if self.observed is None else self.observed[::step, ::step]
        relief_m = None if self.relief_m is None else self.relief_m[::step, ::step]
        return dataclasses.replace(
            self, width_px=columns, height_px=rows, fx=self.fx / step, fy=self.fy / step,
            cx=(self.cx - 0.5) / step + 0.5, cy=(self.cy - 0.5) / step + 0.5, rectangle_m=self.rectangle,
            observed=observed, relief_m=relief_m,
        )  # fmt: skip

    def pressed(self, indentation_m: float, press_depth_m: float | None = None) -> SensorGeometry:
        """Return the sensor as it sees an object that is pressed `indentation_m` metres into the gel.

        What is seen begins at the object's deepest point, at z = surface - indentation, and ends `press_depth_m`
        metres behind it, by default at the undeformed surface. Camera, rectangle and observed pixels stay. Raises
        SensorError for an indentation that is not positive, or that reaches the camera.
        """
        if not 0 < indentation_m < self.surface_m:
            raise SensorError(
                f"an object cannot be pressed in by {indentation_m * 1e3:.3g} mm; the camera is "
                f"{self.surface_m * 1e3:.3g} mm behind the surface"
            )
        return dataclasses.replace(
            self, standoff_m=self.surface_m - indentation_m, indentation_m=indentation_m,
            max_depth_m=indentation_m if press_depth_m is None else press_depth_m,
        )  # fmt: skip

    def with_long_side(self, pixels: int) -> SensorGeometry:
        """Return the same sensor, its longer image side `pixels` long, the shorter in proportion."""
        k = pixels / max(self.shape)
        return self.resized(max(1, round(self.width_px * k)), max(1, round(self.height_px * k)))

    def is_same_sensor(self, other: SensorGeometry) -> bool:
        """Tell whether `other` sees the same field, to within a pixel, in the same way.

        The image's size, the mask, and how deep an object is pressed may differ.
        """
        ours, theirs = ((g.surface_m, *g.rectangle) for g in (self, other))
        same = self.camera == other.camera and np.allclose(ours, theirs, rtol=1e-6, atol=1e-9)
        if self.indentation_m == other.indentation_m:
            same = same and math.isclose(self.max_depth_m, other.max_depth_m, rel_tol=1e-6)
        same = same and self._is_as_curved(other)
        apart_m = np.abs(np.subtract(self.view, other.view)).max()
        return bool(same and apart_m < max(self.pixel_pitch_m, other.pixel_pitch_m))

    def _is_as_curved(self, other: SensorGeometry) -> bool:
        if self.relief_m is None or other.relief_m is None:
            return self.relief_m is other.relief_m
        theirs_m = np.asarray(other._relief_at(self.width_px, self.height_px))
        return bool(np.abs(self.relief_m - theirs_m).max() < SAME_RELIEF_M)

    def describe(self) -> dict[str, Any]:
        """Return the numbers as JSON values (metres, pixels), with digests of mask and relief: what identifies it."""
        arrays = {"observed": self.observed, "relief_m": self.relief_m}
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in arrays}
        digests = {
            name: None if array is None else hashlib.sha256(_bytes(array)).hexdigest() for name, array in arrays.items()
        }
        if self.relief_m is None:  # flat sensors are described as ever
            del digests["relief_m"]
        rectangle = None if self.rectangle_m is None else list(self.rectangle_m)
        return {**fields, "rectangle_m": rectangle, **digests}


def _bytes(array: NDArray[Any]) -> bytes:
    return (np.packbits(array) if array.dtype == np.bool_ else array).tobytes()


Drawing = Literal["pressed", "paper"]


def as_drawn(
    T_sensor_object: NDArray[np.float64], geometry: SensorGeometry, drawing: Drawing
) -> tuple[NDArray[np.float64], SensorGeometry]:
    """Return poses (..., 4, 4), metres, and the sensor as what is compared with touches is drawn of them.

    "pressed" draws what the sensor sees: the pressed object. "paper" draws it as Bauza et al. (CoRL 2020) do, where it
    just touches: an indentation farther off, which a pinhole camera sees smaller; parallel rays see no difference.
    """
    if drawing == "pressed" or geometry.indentation_m == 0.0:
        return T_sensor_object, geometry
    raised = T_sensor_object.copy()
    raised[..., 2, 3] += geometry.indentation_m
    return raised, dataclasses.replace(geometry, standoff_m=geometry.surface_m, indentation_m=0.0)


@dataclass(frozen=True, eq=False)
class ContactShape:
    """How far the object's surface lies from full penetration: `depth_m` (H, W) float32 in metres, 0 ... press depth.

    A pixel at `press_depth_m` or beyond is not in contact. Two contact shapes are comparable when both are cut at the
    same press depth: see `pressed_to`. `indentation_m` is how deep the object really was pressed in, if it is more
    than what the shape shows: None means that nothing was cut off.
    """

    depth_m: Depth
    press_depth_m: float
    indentation_m: float | None = None

    @property
    def contact(self) -> NDArray[np.bool_]:
        """The pixels (H, W) in contact: depth below the press depth in metres."""
        return self.depth_m < np.float32(self.press_depth_m)

    def every(self, step: int) -> ContactShape:
        """Return every `step`-th pixel; goes with `SensorGeometry.every`."""
        return dataclasses.replace(self, depth_m=self.depth_m[::step, ::step])

    def contact_iou(self, other: ContactShape, observed: NDArray[np.bool_]) -> float:
        """Return intersection over union (0 to 1, unitless) of two contacts where pixels (H, W) are observed."""
        ours, theirs = self.contact & observed, other.contact & observed
        return float((ours & theirs).sum() / max(1, (ours | theirs).sum()))

    def pressed_to(self, press_depth_m: float) -> ContactShape:
        """Return what is nearer than `press_depth_m` metres to full penetration; the object is pressed as deep."""
        cut_m = min(press_depth_m, self.press_depth_m)
        return ContactShape(np.minimum(self.depth_m, np.float32(cut_m)), cut_m, self.deepest_m)

    @property
    def deepest_m(self) -> float:
        """How deep the object's deepest point is pressed in, metres."""
        return self.press_depth_m if self.indentation_m is None else self.indentation_m


def contact_depth(depth_m: NDArray[np.floating[Any]], geometry: SensorGeometry, press_depth_m: float) -> Depth:
    """Turn rendered camera depths (..., H, W) into contact depths (..., H, W): clip(z - standoff, 0, press depth).

    All in metres; a surface that no ray meets has depth inf and becomes `press_depth_m`, no contact. Where the gel is
    curved, its relief is taken off too.
    """
    shape = np.subtract(depth_m, geometry.full_penetration_m, dtype=np.float32)
    return np.clip(shape, 0.0, np.float32(press_depth_m), out=shape)


@dataclass(frozen=True, eq=False)
class Touch:
    """One tactile observation.

    `contact_shape` as seen by a sensor of `geometry`, which becomes that of the pressed sensor: the object's deepest
    point is at z = surface - indentation; `T_base_sensor` (4, 4) where the sensor was, if known, with the standard
    deviations of its error along (metres) and about (radians) each axis through the touch; `T_sensor_object`
    (4, 4) the true pose while it was pressed, known only in simulation or experiments. Lengths in metres. `image`
    (H, W, 3) uint8 is the photo that the contact shape was estimated from, if it was.
    Raises TouchError when the shape does not fit the sensor, has no contact, or nothing but contact, and for a pose
    that is no rigid transform: a reflection would make another object of the known one, its mirror image.
    """

    contact_shape: ContactShape
    geometry: SensorGeometry
    name: str = "touch"
    T_base_sensor: NDArray[np.float64] | None = None
    T_sensor_object: NDArray[np.float64] | None = None
    T_base_sensor_std_m: float = 2e-4
    T_base_sensor_std_rad: float = 3.5e-3
    image: NDArray[np.uint8] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        depth = self.contact_shape.depth_m
        if depth.shape != self.geometry.shape:
            got, want = " x ".join(map(str, depth.shape)), " x ".join(map(str, self.geometry.shape))
            raise TouchError(
                f"{self.name} is {got} pixels but the sensor's image is {want} (rows x columns); "
                "choose the sensor that took it, or set its image_size_px"
            )
        contact = self.contact_shape.contact[self.geometry.observed_mask]
        if not contact.any():
            raise NoContactError(
                f"{self.name} shows no contact: no observed pixel is nearer than its press depth of "
                f"{self.contact_shape.press_depth_m * 1e3:.3g} mm; press the object on the sensor, or check the unit"
            )
        flat = np.ptp(depth[self.geometry.observed_mask]) < 0.05 * self.contact_shape.press_depth_m
        if contact.all() and flat:
            raise TouchError(
                f"{self.name} is nothing but contact: every pixel has the same depth, which fits any flat face; "
                "touch where an edge or a feature is on the sensor, or check how the file marks 'no contact'"
            )
        if self.geometry.indentation_m != self.indentation_m or self.geometry.max_depth_m != self.press_depth_m:
            pressed = self.geometry.pressed(self.indentation_m, self.press_depth_m)
            object.__setattr__(self, "geometry", pressed)
        for pose in ("T_base_sensor", "T_sensor_object"):
            self._require_rigid(pose)

    def _require_rigid(self, pose: str) -> None:
        T = getattr(self, pose)
        if T is not None and (np.shape(T) != (4, 4) or not is_rigid(np.asarray(T, float))):
            raise TouchError(
                f"{pose} of {self.name} is no rigid transform; it must be (4, 4), in metres, its rotation no reflection"
            )

    @property
    def press_depth_m(self) -> float:
        """How deep the press is that the contact shape shows, metres."""
        return self.contact_shape.press_depth_m

    @property
    def indentation_m(self) -> float:
        """How deep the object's deepest point was pressed into the gel, metres."""
        return self.contact_shape.deepest_m

    def thinned(self, pixels: int) -> tuple[SensorGeometry, ContactShape]:
        """Return the sensor and the contact shape with so many pixels only that the longer side has about `pixels`."""
        step = max(1, round(max(self.geometry.shape) / pixels))
        return self.geometry.every(step), self.contact_shape.every(step)


def contact_shape_from_array(
    values: ArrayLike, max_depth_m: float, press_depth_m: float | None = None, name: str = "touch"
) -> ContactShape:
    """Make a contact shape from depths (H, W) in metres, 0 = deepest; NaN or at least `max_depth_m` = no contact.

    Without `press_depth_m` the press depth is the deepest step the contact shows: its largest depth, at least a
    quarter of `max_depth_m` because a flat imprint shows none. When no pixel is marked as out of contact, the shape
    was cut at its largest depth (unless it is flat). Raises TouchError for a wrong type, unit or size.
    """
    depth = np.asarray(values)
    if depth.ndim != 2 or depth.size == 0 or depth.dtype.kind not in "fiu":
        raise TouchError(
            f"{name} is an array of shape {depth.shape} and type {depth.dtype}; a contact shape is (H, W) numbers, "
            "depth from full penetration"
        )
    with np.errstate(over="ignore"):  # beyond float32 is beyond the sensor too
        depth = np.where(np.isnan(depth), np.inf, depth).astype(np.float32)
    if (depth < -1e-6).any():
        raise TouchError(f"{name} has negative depths (least {depth.min():.3g} m); 0 must mean full penetration")
    finite = depth[np.isfinite(depth)]
    if finite.size and finite.max() > 100 * max_depth_m:
        raise TouchError(
            f"{name} has depths up to {finite.max():.3g} m, far beyond the sensor's {max_depth_m * 1e3:.3g} mm; "
            "its unit is probably another (give --touch-unit mm or um)"
        )
    if press_depth_m is None:
        press_depth_m = _deepest_step(depth, max_depth_m)
    if not 0 < press_depth_m <= max_depth_m * (1 + 1e-6):
        raise TouchError(
            f"{name} has a press depth of {press_depth_m * 1e3:.3g} mm; "
            f"the sensor's range is 0 to {max_depth_m * 1e3:.3g} mm; choose the sensor that took it"
        )
    depth[_reaches(depth, press_depth_m)] = press_depth_m
    return ContactShape(np.clip(depth, 0, np.float32(press_depth_m)), float(press_depth_m))


def _reaches(depth_m: Depth, limit_m: float) -> NDArray[np.bool_]:
    """Return where depths are at a limit or beyond; the rounding of a unit's conversion must not make contact."""
    return depth_m >= np.float32(limit_m) * (1 - 1e-6)


def _deepest_step(depth_m: Depth, max_depth_m: float) -> float:
    contact = depth_m[~_reaches(depth_m, max_depth_m)]
    deepest = float(contact.max(initial=0.0))
    if contact.size == depth_m.size and np.ptp(depth_m) > 0.1 * max_depth_m:
        return deepest
    return min(max_depth_m, max(1.0001 * deepest, 0.25 * max_depth_m))
