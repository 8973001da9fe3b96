"""Random cases for testing properties: motions, places, orders and whole numbers.

The cases are few and always the same, so a property never fails by chance. A ContractError names the case.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, make_transform, rotation_about
from tactile_loc.testing.contract import ContractError

EXAMPLES = 5  # number of cases for each property
AXES = tuple(axis for axis in product((0, 1, -2), repeat=3) if any(axis))

Draw = Callable[[np.random.Generator], Any]


@dataclass(frozen=True)
class RigidMotion:
    """A motion: a rotation by `turn_deg` about an axis (3,), then a shift (3,), mm."""

    axis: tuple[int, int, int]
    turn_deg: int
    shift_mm: tuple[int, int, int]

    @property
    def T(self) -> Floats:  # noqa: N802 - a transform's name
        """The motion (4, 4), metres."""
        return make_transform(rotation_about(self.axis, np.radians(self.turn_deg)), 1e-3 * np.array(self.shift_mm))


@dataclass(frozen=True)
class Place:
    """A pose of the block, or the offset of a candidate: x and y in tenths of a mm, yaw and tilt in degrees."""

    x_tenths_mm: int
    y_tenths_mm: int
    yaw_deg: int
    tilt_deg: int = 0

    @property
    def slide(self) -> tuple[float, float, float]:
        """The place without tilt: x, y in metres and yaw in radians."""
        return 1e-4 * self.x_tenths_mm, 1e-4 * self.y_tenths_mm, math.radians(self.yaw_deg)

    @property
    def pose(self) -> Floats:
        """The pose (4, 4), metres: the yaw, then the tilt about a horizontal axis, at z = 0."""
        x, y, yaw = self.slide
        tilt = rotation_about([1.0, 0.5, 0.0], math.radians(self.tilt_deg))
        return make_transform(tilt @ rotation_about([0, 0, 1], yaw), [x, y, 0.0])


def hold(claim: Callable[..., None], examples: int = EXAMPLES, **drawn: Draw) -> None:
    """Try a claim, a function that raises ContractError if it does not hold, on drawn values of its arguments.

    Raises ContractError if values break the claim; its message names these values.
    """
    rng = np.random.default_rng(0)
    for _ in range(examples):
        values = {name: draw(rng) for name, draw in drawn.items()}
        try:
            claim(**values)
        except ContractError as error:
            named = ", ".join(f"{name}={value!r}" for name, value in values.items())
            raise ContractError(f"{error} (with {named})") from None


def whole(least: int, most: int) -> Draw:
    """Draw a whole number from `least` to `most`."""
    return lambda rng: int(rng.integers(least, most + 1))


def one_of(values: Sequence[Any]) -> Draw:
    """Draw one of the values."""
    return lambda rng: values[int(rng.integers(len(values)))]


def orders(count: int) -> Draw:
    """Draw an order of the numbers 0 to count - 1."""
    return lambda rng: rng.permutation(count).tolist()


def shifts(least_mm: int = 20, most_mm: int = 150) -> Draw:
    """Draw a shift: three whole numbers of mm of either sign, whose sizes are between the limits."""
    return lambda rng: tuple((rng.integers(least_mm, most_mm + 1, 3) * rng.choice([-1, 1], 3)).tolist())


def motions(least_deg: int = 15, most_mm: int = 150) -> Draw:
    """Draw a RigidMotion with a rotation of at least `least_deg` and a shift of at most `most_mm` along each axis."""
    parts = one_of(AXES), whole(least_deg, 180), shifts(0, most_mm)
    return lambda rng: RigidMotion(*(draw(rng) for draw in parts))


def places(most_tenths_mm: int = 30, most_tilt_deg: int = 0) -> Draw:
    """Draw a Place with any yaw, and with at most these offsets along each axis and this tilt."""
    along = whole(-most_tenths_mm, most_tenths_mm)
    return lambda rng: Place(along(rng), along(rng), whole(0, 359)(rng), whole(0, most_tilt_deg)(rng))


def slides() -> Draw:
    """Draw a Place as the offset of a candidate: at most 0.8 mm along each axis, and a yaw of at most 5 degrees."""
    return lambda rng: Place(*rng.integers([-8, -8, -5], [9, 9, 6]).tolist())
