"""The observations of a sensor: contact shapes and touches."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import NoContactError, TouchError
from tactile_loc.core.geometry.rigid import require_rigid
from tactile_loc.core.sensing.sensor_geometry import Depth, SensorGeometry

TINY_M = 2e-6  # smallest plausible range of a touch's depths


@keep_old_names(every="subsample", pressed_to="press_to")
@dataclass(frozen=True, eq=False)
class ContactShape:
    """An image of the distance of the object's surface from full penetration.

    `depth_m` (H, W), float32, is in metres, from 0 to `press_depth_m`. A pixel at `press_depth_m` is not in contact.
    Before you compare two contact shapes, cut both at the same press depth with `press_to`. `indentation_m` is the
    object's true indentation, metres, if the shape was cut at less. None means that it equals `press_depth_m`.
    `indentation_std_m` is the standard deviation of the indentation's error, metres, if the sensor knows it.
    """

    depth_m: Depth
    press_depth_m: float
    indentation_m: float | None = None
    indentation_std_m: float = 0.0

    @property
    def contact(self) -> NDArray[np.bool_]:
        """A mask (H, W), True at pixels in contact, whose depth is below the press depth."""
        return self.depth_m < np.float32(self.press_depth_m)

    def subsample(self, step: int) -> ContactShape:
        """Return the shape with every `step`-th pixel. `SensorGeometry.subsample` returns the sensor for this shape."""
        return dataclasses.replace(self, depth_m=self.depth_m[::step, ::step])

    def contact_iou(self, other: ContactShape, observed: NDArray[np.bool_]) -> float:
        """Return the intersection over union, 0 to 1, of both shapes' contacts over the observed pixels (H, W)."""
        ours, theirs = self.contact & observed, other.contact & observed
        return float((ours & theirs).sum() / max(1, (ours | theirs).sum()))

    def press_to(self, press_depth_m: float) -> ContactShape:
        """Return the shape cut at `press_depth_m` metres from full penetration. The indentation does not change."""
        cut_m = min(press_depth_m, self.press_depth_m)
        depth_m = np.minimum(self.depth_m, np.float32(cut_m))
        return ContactShape(depth_m, cut_m, self.deepest_m, self.indentation_std_m)

    @property
    def deepest_m(self) -> float:
        """Indentation of the object's deepest point, metres."""
        return self.press_depth_m if self.indentation_m is None else self.indentation_m


def compute_contact_depth(depth_m: NDArray[np.floating[Any]], geometry: SensorGeometry, press_depth_m: float) -> Depth:
    """Convert rendered camera depths (..., H, W) to contact depths (..., H, W): clip(z - standoff, 0, press depth).

    All values are in metres. A ray that meets no surface has the depth inf, which becomes `press_depth_m`: no contact.
    For a curved gel, the relief is subtracted too.
    """
    shape = np.subtract(depth_m, geometry.full_penetration_m, dtype=np.float32)
    return np.clip(shape, 0.0, np.float32(press_depth_m), out=shape)


@keep_old_names(thinned="thin")
@dataclass(frozen=True, eq=False)
class Touch:
    """One tactile observation.

    `contact_shape` was seen by the sensor `geometry`. The touch replaces `geometry` by the pressed sensor, in which the
    object's deepest point is at z = surface - indentation (see `SensorGeometry.press`).

    `T_base_sensor` (4, 4), metres, is the sensor's pose, if known. `T_base_sensor_std_m` and `T_base_sensor_std_rad`
    are the standard deviations of its error along and about each axis through the touch. `T_sensor_object` (4, 4),
    metres, is the true pose of the pressed object, which simulations and some experiments know. `image` (H, W, 3),
    uint8, is the photo from which the contact shape was estimated, if any.

    Raises NoContactError if no observed pixel is in contact. Raises TouchError in three other cases: the shape does not
    fit the sensor, all observed pixels are in contact at the same depth, or a pose is not a rigid transform.
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
                f"{self.name} is {got} pixels, but the sensor's image is {want} (rows x columns); "
                "choose the sensor that took it, or set its image_size_px"
            )
        contact = self.contact_shape.contact[self.geometry.observed_mask]
        if not contact.any():
            raise NoContactError(
                f"{self.name} shows no contact: no observed pixel is nearer than its press depth of "
                f"{self.contact_shape.press_depth_m * 1e3:.3g} mm; press the object on the sensor, or check the unit"
            )
        range_m = float(np.ptp(depth[self.geometry.observed_mask]))
        flat = range_m < 0.05 * self.contact_shape.press_depth_m
        if contact.all() and 0 < range_m < TINY_M:
            raise TouchError(
                f"all depths of {self.name} are within {1e3 * range_m:.1g} mm of each other; their unit is probably "
                "too small (mm instead of um: --touch-unit mm), or the touch is on a flat face"
            )
        if contact.all() and flat:
            raise TouchError(
                f"{self.name} has the same depth at every pixel, which fits any flat face; touch an edge or a "
                "feature, or check how the file marks pixels without contact"
            )
        if self.geometry.indentation_m != self.indentation_m or self.geometry.max_depth_m != self.press_depth_m:
            pressed = self.geometry.press(self.indentation_m, self.press_depth_m)
            object.__setattr__(self, "geometry", pressed)
        for pose in ("T_base_sensor", "T_sensor_object"):
            if getattr(self, pose) is not None:
                T = require_rigid(getattr(self, pose), f"{pose} of {self.name}", TouchError)
                object.__setattr__(self, pose, T)

    @property
    def press_depth_m(self) -> float:
        """Press depth of the contact shape, metres."""
        return self.contact_shape.press_depth_m

    @property
    def indentation_m(self) -> float:
        """Indentation of the object's deepest point, metres."""
        return self.contact_shape.deepest_m

    @cached_property
    def touching_shape(self) -> ContactShape:
        """The part of the contact shape at which the gel touches the object, cut at the indentation.

        A rigid gel touches wherever it is pressed. An elastic gel is pressed in around the contact, too.
        """
        shape = self.contact_shape
        if not self.geometry.gel.is_elastic:
            return shape
        from tactile_loc.core.sensing.gel_surface import find_touching

        press = np.float32(self.indentation_m)
        depth_m = np.where(shape.contact & self.geometry.observed_mask, shape.depth_m, press)
        touching = find_touching(depth_m, self.indentation_m, self.geometry)
        return ContactShape(np.where(touching, depth_m, press), self.indentation_m)

    def thin(self, pixels: int) -> tuple[SensorGeometry, ContactShape]:
        """Return the sensor and the touching shape with fewer pixels: about `pixels` on the longer side."""
        step = self._find_step(pixels)
        return self.geometry.subsample(step), self.touching_shape.subsample(step)

    def find_known(self, cut_m: float) -> NDArray[np.bool_]:
        """Return the observed pixels (H, W) that show whether the object is nearer than `cut_m` metres.

        Around the contact, an elastic gel may be pressed in deeper than `cut_m` without the object being there.
        """
        observed = self.geometry.observed_mask
        if not self.geometry.gel.is_elastic:
            return observed
        return observed & (self.touching_shape.contact | (self.contact_shape.depth_m >= np.float32(cut_m)))

    def thin_surface(self, pixels: int) -> ContactShape:
        """Return the gel's surface, nearer to which the object cannot be, with the pixels of `thin`."""
        return self.contact_shape.subsample(self._find_step(pixels))

    def _find_step(self, pixels: int) -> int:
        return max(1, round(max(self.geometry.shape) / pixels))


def contact_shape_from_array(
    values: ArrayLike, max_depth_m: float, press_depth_m: float | None = None, name: str = "touch",
    states_unit: bool = False,
) -> ContactShape:  # fmt: skip
    """Make a contact shape from depths (H, W), metres, where 0 is full penetration.

    NaN, or a depth of at least `max_depth_m`, means no contact. If `press_depth_m` is None, the press depth is the
    largest depth in contact. It is at least a quarter of `max_depth_m`, because a flat imprint does not show how deep
    it was pressed. If every pixel is in contact and the depths differ, the pixels at the largest depth are taken to be
    out of contact. `states_unit` says whether the touch's file states its unit, for advice in messages. Raises
    TouchError if the array has a wrong type or shape, or if its depths do not fit the sensor.
    """
    depth = np.asarray(values)
    if depth.ndim != 2 or depth.size == 0 or depth.dtype.kind not in "fiu":
        raise TouchError(
            f"{name} is an array of shape {depth.shape} and type {depth.dtype}; a contact shape is (H, W) numbers, "
            "depth from full penetration"
        )
    with np.errstate(over="ignore"):  # depths that are too large for float32 are beyond the sensor too
        depth = np.where(np.isnan(depth), np.inf, depth).astype(np.float32)
    if (depth < -1e-6).any():
        raise TouchError(f"{name} has negative depths (least {depth.min():.3g} m); give 0 for full penetration")
    finite = depth[np.isfinite(depth)]
    if finite.size and finite.max() > 100 * max_depth_m:
        advice = (
            "check the unit in the file, and max_depth_mm (in mm) of the sensor" if states_unit
            else "its unit is probably wrong; give --touch-unit mm or um"
        )  # fmt: skip
        raise TouchError(
            f"{name} has depths up to {finite.max():.3g} m, far beyond the sensor's {max_depth_m * 1e3:.3g} mm; "
            f"{advice}"
        )
    if press_depth_m is None:
        press_depth_m = _find_deepest_step(depth, max_depth_m)
    if not 0 < press_depth_m <= max_depth_m * (1 + 1e-6):
        raise TouchError(
            f"{name} has a press depth of {press_depth_m * 1e3:.3g} mm, but the sensor's range is 0 to "
            f"{max_depth_m * 1e3:.3g} mm; choose the sensor that took it"
        )
    depth[_reaches(depth, press_depth_m)] = press_depth_m
    return ContactShape(np.clip(depth, 0, np.float32(press_depth_m)), float(press_depth_m))


def _reaches(depth_m: Depth, limit_m: float) -> NDArray[np.bool_]:
    """Return which depths reach a limit, with a tolerance for rounding in unit conversions."""
    return depth_m >= np.float32(limit_m) * (1 - 1e-6)


def _find_deepest_step(depth_m: Depth, max_depth_m: float) -> float:
    contact = depth_m[~_reaches(depth_m, max_depth_m)]
    deepest = float(contact.max(initial=0.0))
    if contact.size == depth_m.size and np.ptp(depth_m) > 0.1 * max_depth_m:
        return deepest
    return min(max_depth_m, max(1.0001 * deepest, 0.25 * max_depth_m))
