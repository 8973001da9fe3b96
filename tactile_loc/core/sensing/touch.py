"""Observations of a sensor: the contact shape, and the touch."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import NoContactError, TouchError
from tactile_loc.core.geometry.rigid import require_rigid
from tactile_loc.core.sensing.sensor_geometry import Depth, SensorGeometry


@keep_old_names(every="subsample", pressed_to="press_to")
@dataclass(frozen=True, eq=False)
class ContactShape:
    """Distance of the object's surface from full penetration: `depth_m` (H, W) float32, metres, 0 to press depth.

    A pixel at `press_depth_m` or beyond is not in contact. Two contact shapes are comparable if both are cut at the
    same press depth: see `press_to`. `indentation_m` is the true indentation of the object, if the shape shows less;
    None means that nothing was cut off.
    """

    depth_m: Depth
    press_depth_m: float
    indentation_m: float | None = None

    @property
    def contact(self) -> NDArray[np.bool_]:
        """The pixels (H, W) in contact: depth below the press depth in metres."""
        return self.depth_m < np.float32(self.press_depth_m)

    def subsample(self, step: int) -> ContactShape:
        """Return every `step`-th pixel; goes with `SensorGeometry.subsample`."""
        return dataclasses.replace(self, depth_m=self.depth_m[::step, ::step])

    def contact_iou(self, other: ContactShape, observed: NDArray[np.bool_]) -> float:
        """Return the intersection over union (0 to 1, unitless) of two contacts over the observed pixels (H, W)."""
        ours, theirs = self.contact & observed, other.contact & observed
        return float((ours & theirs).sum() / max(1, (ours | theirs).sum()))

    def press_to(self, press_depth_m: float) -> ContactShape:
        """Return the shape cut at `press_depth_m` metres from full penetration; the indentation stays."""
        cut_m = min(press_depth_m, self.press_depth_m)
        return ContactShape(np.minimum(self.depth_m, np.float32(cut_m)), cut_m, self.deepest_m)

    @property
    def deepest_m(self) -> float:
        """Indentation of the object's deepest point, metres."""
        return self.press_depth_m if self.indentation_m is None else self.indentation_m


def compute_contact_depth(depth_m: NDArray[np.floating[Any]], geometry: SensorGeometry, press_depth_m: float) -> Depth:
    """Convert rendered camera depths (..., H, W) to contact depths (..., H, W): clip(z - standoff, 0, press depth).

    All are in metres. A pixel whose ray meets no surface has depth inf and becomes `press_depth_m`, no contact. A
    curved gel's relief is subtracted too.
    """
    shape = np.subtract(depth_m, geometry.full_penetration_m, dtype=np.float32)
    return np.clip(shape, 0.0, np.float32(press_depth_m), out=shape)


@keep_old_names(thinned="thin")
@dataclass(frozen=True, eq=False)
class Touch:
    """One tactile observation.

    `contact_shape` is seen by a sensor of `geometry`, which is changed to that of the pressed sensor: the object's
    deepest point is at z = surface - indentation. `T_base_sensor` (4, 4) is the sensor's pose, if known, with the
    standard deviations of its error along (metres) and about (radians) each axis through the touch. `T_sensor_object`
    (4, 4) is the true pose while it was pressed, known in simulation or experiments. Lengths are in metres. `image`
    (H, W, 3) uint8 is the photo from which the contact shape was estimated, if any.
    Raises TouchError when the shape does not fit the sensor, has no contact or nothing but contact, and for a pose that
    is not a rigid transform: a reflection would turn the object into its mirror image.
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
        flat = np.ptp(depth[self.geometry.observed_mask]) < 0.05 * self.contact_shape.press_depth_m
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

    def thin(self, pixels: int) -> tuple[SensorGeometry, ContactShape]:
        """Return the sensor and the contact shape with fewer pixels: about `pixels` on the longer side."""
        step = max(1, round(max(self.geometry.shape) / pixels))
        return self.geometry.subsample(step), self.contact_shape.subsample(step)


def contact_shape_from_array(
    values: ArrayLike, max_depth_m: float, press_depth_m: float | None = None, name: str = "touch"
) -> ContactShape:
    """Make a contact shape from depths (H, W), metres, 0 = deepest; NaN or at least `max_depth_m` = no contact.

    Without `press_depth_m`, the press depth is the deepest step of the shape: its largest depth, but at least a quarter
    of `max_depth_m`, because a flat imprint shows no step. If no pixel is out of contact and the shape is not flat, it
    was cut at its largest depth. Raises TouchError for a wrong type, unit or size.
    """
    depth = np.asarray(values)
    if depth.ndim != 2 or depth.size == 0 or depth.dtype.kind not in "fiu":
        raise TouchError(
            f"{name} is an array of shape {depth.shape} and type {depth.dtype}; a contact shape is (H, W) numbers, "
            "depth from full penetration"
        )
    with np.errstate(over="ignore"):  # depths beyond float32 are beyond the sensor too
        depth = np.where(np.isnan(depth), np.inf, depth).astype(np.float32)
    if (depth < -1e-6).any():
        raise TouchError(f"{name} has negative depths (least {depth.min():.3g} m); give 0 for full penetration")
    finite = depth[np.isfinite(depth)]
    if finite.size and finite.max() > 100 * max_depth_m:
        raise TouchError(
            f"{name} has depths up to {finite.max():.3g} m, far beyond the sensor's {max_depth_m * 1e3:.3g} mm; "
            "its unit is probably wrong; give --touch-unit mm or um"
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
    """Whether depths are at a limit or beyond; rounding in the conversion of units must not make contact."""
    return depth_m >= np.float32(limit_m) * (1 - 1e-6)


def _find_deepest_step(depth_m: Depth, max_depth_m: float) -> float:
    contact = depth_m[~_reaches(depth_m, max_depth_m)]
    deepest = float(contact.max(initial=0.0))
    if contact.size == depth_m.size and np.ptp(depth_m) > 0.1 * max_depth_m:
        return deepest
    return min(max_depth_m, max(1.0001 * deepest, 0.25 * max_depth_m))
