"""Photos of the test object: each is located at its place, and the gel's surface is compared with the shape.

A photo shows neither its press depth nor its tilt exactly. So a plane is subtracted from both surfaces before they are
compared. They are compared where the object touches the gel, away from the border of the contact. There the gel follows
the object, whatever it is made of.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from tactile_loc import IMAGE_SUFFIXES, GaussianPrior, Localizer, Tolerance, Verdict
from tactile_loc.plugin import Scene, SensorGeometry, TactileLocError, Touch
from tactile_loc.plugin.helpers import invert, make_transform, rotation_about

from tactile_loc_test_object.shape import PLACES, NumberedPlace

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

PRIOR_M, PRIOR_DEG = 2e-3, 5.0  # standard deviations about the nominal pose
RIGHT_M = 1e-3  # a pose whose place is farther than this from where it should be is wrong
STARTS_M = 1e-3  # the search starts at the nominal pose, and this much beside it
PITCH_M = 2e-4  # surfaces are compared on pixels of about this size
DEEPER = 1.3  # the object may reach this much deeper than was read
TOUCHING_M = 2e-5
FEWEST_PX = 12  # a smaller contact is not compared, and one with a smaller inside is compared up to its border
FLAT_M = 2e-5  # a relief below this counts as this much, so that the errors of flat faces are not divided by zero
UNFIT = (Verdict.POOR_FIT, Verdict.NOT_FOUND)
NAMES = re.compile(r"0*(\d+)([a-z]*)", re.IGNORECASE)
SUFFIXES = (*IMAGE_SUFFIXES, ".npz", ".npy")


class TestObjectError(TactileLocError):
    """A folder of photos of the test object cannot be scored."""

    __test__ = False  # no test, in spite of its name


@dataclass(frozen=True)
class Photo:
    """A photo of a numbered place. `repetition` is the letter after the number, such as b."""

    path: Path
    place: NumberedPlace
    repetition: str = ""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The gel's surface at a place: `seen` and `expected` (H, W), metres, positive where the gel is pressed in.

    They are compared at the pixels `inside`. `error_m` is the RMS difference there, without its plane. `relief_m` is
    the RMS of the expected surface without its plane, and `scale` the factor from the expected to the seen surface.
    """

    seen: Floats
    expected: Floats
    inside: Bools
    error_m: float
    relief_m: float
    scale: float

    @classmethod
    def compare(cls, seen: Floats, expected: Floats, inside: Bools) -> Surfaces:
        """Return the comparison of two surfaces (H, W), metres."""
        ours, known = (subtract_plane(one, inside)[inside] for one in (seen, expected))
        power = float(known @ known)
        scale = float(known @ ours) / power if power > 0 else 0.0
        error_m, relief_m = (float(np.sqrt(np.mean(one**2))) for one in (ours - known, known))
        return cls(seen, expected, inside, error_m, relief_m, scale)

    def find_difference(self) -> Floats:
        """Return the seen minus the expected surface (H, W), metres, without its plane."""
        return subtract_plane(self.seen - self.expected, self.inside)

    @property
    def deepest_m(self) -> float:
        """How deep the gel is pressed in, metres, as it was read."""
        return float(self.seen.max())

    @property
    def share(self) -> float:
        """The share of the shape that the reading shows, 0 to 1: 1 minus the error as a share of the relief."""
        return max(0.0, 1 - self.error_m / max(self.relief_m, FLAT_M))


def subtract_plane(surface: Floats, inside: Bools) -> Floats:
    """Return a surface (H, W), metres, minus the plane that fits it best at the pixels `inside`."""
    y, x = np.indices(surface.shape, float)
    basis = np.stack([np.ones_like(x), x, y], -1)
    plane, *_ = np.linalg.lstsq(basis[inside], surface[inside], rcond=None)
    return surface - basis @ plane


@dataclass(frozen=True, eq=False)
class ScoredPress:
    """What became of a photo. `refused` is the reason if it could not be located, or "".

    `shift_m` (2,) and `turn_rad` are the located minus the nominal pose of the place's centre, in the photo: x to the
    right, y down.
    """

    photo: Photo
    refused: str = ""
    shift_m: Floats | None = None
    turn_rad: float = 0.0
    verdict: str = ""
    surfaces: Surfaces | None = None

    @property
    def fits(self) -> bool:
        """Whether a pose near the place explains the photo."""
        return self.shift_m is not None and self.verdict not in UNFIT


def list_photos(folder: Path) -> list[Photo]:
    """Return the photos of a folder, such as 1.png, 1b.png and 10.png, in the order of places.

    Raises TestObjectError if there is none, or if a number is not that of a place.
    """
    if not folder.is_dir():
        raise TestObjectError(f"{folder} is not a folder; give the folder of the photos 1.png to {len(PLACES)}.png")
    found = []
    for path in sorted(folder.iterdir()):
        named = NAMES.fullmatch(path.stem)
        if named is None or path.suffix.lower() not in SUFFIXES:
            continue
        if not 1 <= (number := int(named[1])) <= len(PLACES):
            raise TestObjectError(f"{path} has the number {number}, but places have 1 to {len(PLACES)}; rename it")
        found.append(Photo(path, PLACES[number - 1], named[2].lower()))
    if not found:
        raise TestObjectError(f"{folder} has no photo of a place; name the photos 1.png to {len(PLACES)}.png")
    return sorted(found, key=lambda one: (one.place.number, one.repetition))


def find_nominal_pose(place: NumberedPlace, geometry: SensorGeometry, turn_rad: float = 0.0) -> Floats:
    """Return the pose (4, 4), metres, of the plate whose place just touches the middle of the sensor's gel.

    The photo's x axis is the plate's, if `turn_rad` is 0. Otherwise the plate appears turned by this angle, from the
    photo's x to its y axis.
    """
    x0, x1, y0, y1 = geometry.rectangle
    R = rotation_about([0, 0, 1], turn_rad) @ np.diag([1.0, -1, -1])
    return make_transform(R, np.array([(x0 + x1) / 2, (y0 + y1) / 2, geometry.surface_m]) - R @ place.centre_m)


def read_press(localizer: Localizer, photo: Photo, turn_rad: float = 0.0) -> ScoredPress:
    """Read and locate a photo of a localizer's sensor. A photo that cannot be used is a refused press."""
    given = localizer.config.touch
    try:
        touch = localizer.read_touch(photo.path, given.unit, given.press_depth_m, given.kind)
        return locate_press(localizer, touch, photo, turn_rad)
    except TactileLocError as error:
        return ScoredPress(photo, str(error))


def locate_press(localizer: Localizer, touch: Touch, photo: Photo, turn_rad: float = 0.0) -> ScoredPress:
    """Locate a touch with the prior of its photo's place, and compare the surfaces. Raises TactileLocError.

    The localizer's object is the test object.
    """
    centre_m = photo.place.centre_m
    nominal = find_nominal_pose(photo.place, touch.geometry, turn_rad)
    starts = np.repeat(nominal[None], 5, axis=0)
    starts[1:, :2, 3] += STARTS_M * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
    prior = GaussianPrior(nominal, PRIOR_M, np.radians(PRIOR_DEG))
    tip = Tolerance(RIGHT_M, tip_m=(float(centre_m[0]), float(centre_m[1]), float(centre_m[2])))
    config = localizer.config.model_copy(update={"tolerance": tip})
    own = Localizer(config, localizer.object, localizer.store)
    found = own.localize(touch, prior, top=len(starts), starts=starts, searches=False)
    for hypothesis in found.hypotheses:  # one that was not refined is the start, which only just touches the gel
        T = hypothesis.T_sensor_object
        if (surfaces := compare_surfaces(own.scene.match_touch(touch), touch, T)) is not None:
            break
    else:
        raise TestObjectError(
            f"{photo.path}: the object hardly touches the gel at the poses that were found; press deeper, or check the "
            "number of the photo"
        )
    moved = T @ invert(nominal)
    at = nominal[:3, :3] @ centre_m + nominal[:3, 3]
    shift_m = (moved[:3, :3] @ at + moved[:3, 3] - at)[:2]
    turned = float(np.arctan2(moved[1, 0] - moved[0, 1], moved[0, 0] + moved[1, 1]))
    return ScoredPress(photo, "", shift_m, turned, str(found.verdict), surfaces)


def compare_surfaces(scene: Scene, touch: Touch, T: Floats) -> Surfaces | None:
    """Return the surfaces of a touch, and of the scene at a pose (4, 4), metres.

    They are None if the object touches fewer than FEWEST_PX pixels: a plane fits any surface there.
    """
    step = max(1, round(PITCH_M / touch.geometry.pixel_pitch_m))
    geometry, deep_m = touch.geometry.subsample(step), DEEPER * touch.indentation_m
    pressed = replace(scene, geometry=geometry).press(deep_m)
    expected, rigid = (
        deep_m - one[0].astype(float)
        for one in (pressed.render_gel_depths(T[None]), pressed.render_contact_depths(T[None]))
    )
    seen = np.maximum(touch.indentation_m - touch.contact_shape.depth_m[::step, ::step].astype(float), 0)
    touching = (rigid > TOUCHING_M) & geometry.observed_mask
    if touching.sum() < FEWEST_PX:
        return None
    inner = binary_erosion(touching)
    return Surfaces.compare(seen, expected, inner if inner.sum() >= FEWEST_PX else touching)
