"""The observations of a sensor: contact shapes and touches."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.geometry.rigid import Bools, Floats, require_rigid
from tactile_loc.core.runtime.errors import NoContactError, TouchError
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.sensing.depth_maps import (
    METRES_PER_UNIT,
    OPPOSITE,
    DepthKind,
    DepthUnit,
    assume_press,
    find_contact,
    find_deepest_step,
    find_indentation,
    reaches,
    refuse_opposite,
    require_in_range,
    require_kind,
    require_numbers,
)
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.sensor_geometry import Depth, SensorGeometry

FROM_DEPTH = 'Touch.from_depth(..., kind="{}")'  # how to state the kind of an array that is read without one
TINY_M = 2e-6  # smallest plausible range of a touch's depths


@dataclass(frozen=True, eq=False)
class ContactShape:
    """An image of the distance of the object's surface from full penetration.

    `depth_m` (H, W), float32, is in metres, from 0 to `press_depth_m`. A pixel at `press_depth_m` is not in contact.
    Before you compare two contact shapes, cut both at the same press depth with `press_to`. `indentation_m` is the
    object's true indentation, metres, if the shape was cut at less. None means that it equals `press_depth_m`.
    `indentation_std_m` is the standard deviation of the indentation's error, metres, if the sensor knows it.

    If `depths_known` is False, the sensor knows only which pixels are in contact: see `Touch.from_mask`. The depth is
    then 0 at pixels in contact.

    `touching` (H, W) marks where an elastic gel touches the object, if the sensor knows; None leaves it to the gel's
    mechanics. If a sensor's gel was measured, `otherwise` are shapes of the same image by other laws of the gel, each
    with its gel. Only whole shapes have them: they are left out when a shape is cut or thinned.
    """

    depth_m: Depth
    press_depth_m: float
    indentation_m: float | None = None
    indentation_std_m: float = 0.0
    depths_known: bool = True
    touching: Bools | None = None
    otherwise: tuple[tuple[Gel, ContactShape], ...] = ()

    @property
    def contact(self) -> Bools:
        """A mask (H, W), True at pixels in contact, whose depth is below the press depth."""
        return self.depth_m < np.float32(self.press_depth_m)

    def subsample(self, step: int) -> ContactShape:
        """Return the shape with every `step`-th pixel. `SensorGeometry.subsample` returns the sensor for this shape."""
        touching = None if self.touching is None else self.touching[::step, ::step]
        return dataclasses.replace(self, depth_m=self.depth_m[::step, ::step], touching=touching, otherwise=())

    def contact_iou(self, other: ContactShape, observed: Bools) -> float:
        """Return the intersection over union, 0 to 1, of both shapes' contacts over the observed pixels (H, W)."""
        ours, theirs = self.contact & observed, other.contact & observed
        return float((ours & theirs).sum() / max(1, (ours | theirs).sum()))

    def press_to(self, press_depth_m: float) -> ContactShape:
        """Return the shape cut at `press_depth_m` metres from full penetration. The indentation does not change."""
        cut_m = min(press_depth_m, self.press_depth_m)
        depth_m = np.minimum(self.depth_m, np.float32(cut_m))
        return dataclasses.replace(
            self, depth_m=depth_m, press_depth_m=cut_m, indentation_m=self.deepest_m, otherwise=()
        )

    def assume(self, press_depth_m: float) -> ContactShape:
        """Return a contact mask with another assumed press depth, metres."""
        depth_m = np.where(self.contact, np.float32(0), np.float32(press_depth_m))
        return dataclasses.replace(self, depth_m=depth_m, press_depth_m=press_depth_m, indentation_m=None)

    @property
    def press_slack_m(self) -> float:
        """How far the true press of a contact mask may be from `deepest_m`, metres; 0 if the depths are known."""
        return 0.0 if self.depths_known else 2 * self.indentation_std_m

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


class HasGeometry(Protocol):
    """A sensor, such as a SensorModel."""

    @property
    def geometry(self) -> SensorGeometry:
        """The sensor's camera and gel."""


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
    T_base_sensor: Floats | None = None
    T_sensor_object: Floats | None = None
    T_base_sensor_std_m: float = 2e-4
    T_base_sensor_std_rad: float = 3.5e-3
    image: NDArray[np.uint8] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", show_name(self.name))
        depth = self.contact_shape.depth_m
        require_fit(depth.shape, self.geometry, self.name)
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
                "too small (mm instead of um: `touch_unit` mm), or the touch is on a flat face"
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

    @classmethod
    def from_depth(
        cls,
        array: ArrayLike,
        *,
        kind: DepthKind,
        sensor: SensorGeometry | HasGeometry,
        unit: DepthUnit = "m",
        press_depth_m: float | None = None,
        name: str = "touch",
        **poses: Any,
    ) -> Self:
        """Make a touch from a depth map (H, W) in `unit`, which `sensor` (a SensorModel or SensorGeometry) took.

        `kind` states what the values mean:

        - `distance`: distance of the surface from full penetration. The deepest pixel is about 0. No contact is NaN or
          any value of at least the press depth.
        - `indentation`: how far the gel is pressed in at each pixel. No contact is 0, a negative value or NaN.
        - `height`: height of the gel's surface above the untouched gel. It is negative where the gel is pressed in. No
          contact is 0, a positive value or NaN.

        By default, the press depth is the largest indentation, or estimated for `distance` as in
        `contact_shape_from_array`. A larger `press_depth_m`, metres, is the press depth of a tip between the pixels. A
        smaller one cuts the shape. The whole surface of an elastic gel is kept; `touching_shape` is the part that
        touches the object. `poses` are further fields of the touch, such as `T_base_sensor`.

        Raises NoContactError if nothing is pressed in. Raises TouchError if an argument is wrong, if the map does not
        fit the sensor, or if its values have the opposite meaning.
        """
        geometry = sensor if isinstance(sensor, SensorGeometry) else sensor.geometry
        if unit not in METRES_PER_UNIT:
            raise TouchError(f"the unit {unit!r} of {name} is unknown; the units are {', '.join(METRES_PER_UNIT)}")
        require_kind(kind, name)
        values = require_numbers(np.asarray(array), name) * METRES_PER_UNIT[unit]
        if kind != "distance":
            values = blank_unobserved(values, geometry)
        meaning = Meaning(kind, states_unit=True)
        shape = contact_shape_from_array(values, geometry.max_depth_m, press_depth_m, name, meaning, geometry.gel)
        return cls(shape, geometry, name, **poses)

    @classmethod
    def from_mask(
        cls,
        mask: ArrayLike,
        *,
        sensor: SensorGeometry | HasGeometry,
        press_depth_m: float | None = None,
        press_std_m: float | None = None,
        name: str = "touch",
        **poses: Any,
    ) -> Self:
        """Make a touch from a contact mask (H, W), whose pixels in contact are True or 1; all others are False or 0.

        The touch has no depths, so it is located by the outline of its contact. `press_depth_m`, metres, is how deep
        the object is pressed in, and `press_std_m` the standard deviation of its error. Without them, the press is
        taken from `assume_press`. `poses` are further fields of the touch, such as `T_base_sensor`.

        Raises NoContactError if no observed pixel is in contact. Raises TouchError if the array is not such a mask, if
        it does not fit the sensor, if all observed pixels are in contact, or if the sensor's gel is elastic.
        """
        geometry = sensor if isinstance(sensor, SensorGeometry) else sensor.geometry
        if geometry.gel.is_elastic:  # the depth at the outline is unknown
            raise TouchError(
                f"{name} is a contact mask, and masks are located only with a rigid gel; set the sensor's gel to "
                "'rigid', or give a depth map"
            )
        contact = find_contact(np.asarray(mask), name)
        press_m, std_m = assume_press(geometry.max_depth_m, press_depth_m, press_std_m)
        require_in_range(press_m, geometry.max_depth_m, name)
        depth_m = np.where(contact, np.float32(0), np.float32(press_m))
        return cls(ContactShape(depth_m, press_m, None, std_m, False), geometry, name, **poses)

    def read_otherwise(self) -> list[Touch]:
        """Return the touch by each other law of the gel by which its image was read; none if it was not measured."""
        return [
            dataclasses.replace(self, contact_shape=shape, geometry=dataclasses.replace(self.geometry, gel=gel))
            for gel, shape in self.contact_shape.otherwise
        ]

    def is_reading_of(self, other: Touch) -> bool:
        """Return whether this is the `other` touch, or this touch as another law of the gel reads its image."""
        shape = other.contact_shape
        return any(self.contact_shape is one for one in (shape, *(one for _, one in shape.otherwise)))

    @property
    def gel_law(self) -> str:
        """The law by which the gel is read: "rigid", "layer", or "outlined layer" if the contact's outline is known."""
        known = self.contact_shape.touching is not None
        return "outlined layer" if known else self.geometry.gel.kind

    @property
    def has_depths(self) -> bool:
        """Whether the touch has depths. Otherwise it has only a contact mask: see `from_mask`."""
        return self.contact_shape.depths_known

    @property
    def contact_share(self) -> float:
        """The share of the observed pixels that are in contact, 0 to 1."""
        return float(self.contact_shape.contact[self.geometry.observed_mask].mean())

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
        """The part of the contact shape at which the gel touches the object: see `cut_to_touching`."""
        return cut_to_touching(self.contact_shape, self.geometry)

    def thin(self, pixels: int) -> tuple[SensorGeometry, ContactShape]:
        """Return the sensor and the touching shape with fewer pixels: about `pixels` on the longer side."""
        return _thin(self, self._find_step(pixels))

    def find_known(self, cut_m: float) -> Bools:
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


@lru_cache(maxsize=32)  # several stages use the same few sizes of a touch
def _thin(touch: Touch, step: int) -> tuple[SensorGeometry, ContactShape]:
    return touch.geometry.subsample(step), touch.touching_shape.subsample(step)


def cut_to_touching(shape: ContactShape, geometry: SensorGeometry) -> ContactShape:
    """Return the part of a contact shape (H, W) at which the gel touches the object, cut at the indentation.

    A rigid gel touches wherever it is pressed. An elastic gel is pressed in around the contact, too.
    """
    if not geometry.gel.is_elastic:
        return shape
    from tactile_loc.core.sensing.gel_surface import find_touching

    pressed_m = shape.deepest_m
    depth_m = np.where(shape.contact & geometry.observed_mask, shape.depth_m, np.float32(pressed_m))
    touching = find_touching(depth_m, pressed_m, geometry) if shape.touching is None else shape.touching
    return ContactShape(np.where(touching, depth_m, np.float32(pressed_m)), pressed_m)


def require_depths(touch: Touch, task: str) -> None:
    """Raise TouchError if a touch has no depths, which a `task` needs."""
    if not touch.has_depths:
        raise TouchError(f"{touch.name} is a contact mask, but {task} needs depths; give a depth map")


@dataclass(frozen=True)
class Meaning:
    """The kind of a map's values, and how messages speak of them.

    `states_unit` says whether the unit is stated with the touch. `option` shows how the caller states another kind. If
    it is None, the kind is certain, so maps with the opposite meaning are not looked for.
    """

    kind: DepthKind = "distance"
    states_unit: bool = False
    option: str | None = 'kind="{}"'


DISTANCES = Meaning()


def contact_shape_from_array(
    values: ArrayLike,
    max_depth_m: float,
    press_depth_m: float | None = None,
    name: str = "touch",
    meaning: Meaning = DISTANCES,
    gel: Gel = RIGID,
) -> ContactShape:
    """Make a contact shape from values (H, W), metres. `Touch.from_depth` explains their kinds.

    For distances from full penetration, NaN, or a depth of at least `max_depth_m`, means no contact. If `press_depth_m`
    is None, the press depth is the largest depth in contact. It is at least a quarter of `max_depth_m`, because a flat
    imprint does not show how deep it was pressed. If every pixel is in contact and the depths differ, the pixels at the
    largest depth are taken to be out of contact. `gel` is used for the other kinds.

    Raises TouchError if the array has a wrong type or shape, or if its depths do not fit the sensor or the kind.
    """
    raw = require_numbers(np.asarray(values), name)
    if meaning.kind == "distance":
        depth = _read_distances(raw, name, meaning)
        largest_m = float(depth[np.isfinite(depth)].max(initial=0.0))
    else:
        indentation = find_indentation(raw.astype(np.float64), meaning.kind, gel)
        largest_m = float(indentation.max())
        if largest_m < TINY_M:
            kind, sign = meaning.kind, "negative" if meaning.kind == "height" else "positive"
            raise NoContactError(
                f"{name} shows no contact: the gel is pressed in by at most {1e3 * largest_m:.1g} mm; press the object "
                f"on the sensor, or check the unit and the sign ({kind}s are {sign} where the gel is pressed in)"
            )
    if largest_m > 100 * max_depth_m:
        advice = "its unit is probably wrong; give `touch_unit` mm or um"
        if meaning.states_unit:
            advice = "check its unit, and max_depth_mm (in mm) of the sensor"
        raise TouchError(
            f"{name} has depths up to {largest_m:.3g} m, far beyond the sensor's {max_depth_m * 1e3:.3g} mm; {advice}"
        )
    if meaning.kind == "distance":
        full_m = press_m = float(find_deepest_step(depth, max_depth_m) if press_depth_m is None else press_depth_m)
    else:
        press_m = largest_m if press_depth_m is None else press_depth_m
        full_m = max(largest_m, press_m)
        depth = (full_m - indentation).astype(np.float32)
    require_in_range(press_m, max_depth_m, name)
    depth[reaches(depth, full_m)] = full_m
    shape = ContactShape(np.clip(depth, 0, np.float32(full_m)), full_m)
    shape = shape if press_m == full_m else shape.press_to(press_m)
    if meaning.option is not None and meaning.kind in OPPOSITE:
        refuse_opposite(shape.depth_m, press_depth_m, name, meaning.kind, meaning.option)
    return shape


def require_fit(shape: tuple[int, ...], geometry: SensorGeometry, name: str) -> None:
    """Raise TouchError unless a touch of this shape, pixels, has the size of the sensor's image."""
    if shape != geometry.shape:
        got, want = " x ".join(map(str, shape)), " x ".join(map(str, geometry.shape))
        raise TouchError(
            f"{name} is {got} pixels, but the sensor's image is {want} (rows x columns); "
            "choose the sensor that took it, or set its image_size_px"
        )


def blank_unobserved(values: NDArray[Any], geometry: SensorGeometry) -> NDArray[Any]:
    """Return values (H, W) with NaN at unobserved pixels. Values of another size are returned as they are."""
    fits = values.shape == geometry.shape
    return np.where(geometry.observed_mask, values, np.nan) if fits else values


def _read_distances(values: NDArray[Any], name: str, meaning: Meaning) -> Depth:
    """Return distances from full penetration as float32, metres, and inf where nothing is in contact."""
    with np.errstate(over="ignore"):  # depths that are too large for float32 are beyond the sensor too
        depth = np.where(np.isnan(values), np.inf, values).astype(np.float32)
    if (depth < -1e-6).any():
        height = "" if meaning.option is None else meaning.option.format("height")
        others = f", or {height} if the untouched gel has the value 0" if height else ""
        raise TouchError(f"{name} has negative depths (least {depth.min():.3g} m); give 0 for full penetration{others}")
    return depth
