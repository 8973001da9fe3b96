"""Random cases for testing properties, drawn by hypothesis: motions, places, orders and whole numbers.

The cases are few and always the same, so a property never fails by chance. A case that breaks a property is simplified,
and the ContractError names it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.runtime.errors import MissingLibraryError
from tactile_loc.testing.contract import ContractError

EXAMPLES = 5  # number of cases for each property; the first case is the simplest
SPARE_BITS = 3  # additional bits of a number, so that all of its values are about equally likely
AXES = tuple(axis for axis in product((0, 1, -2), repeat=3) if any(axis))

Strategy = Any  # hypothesis's SearchStrategy; hypothesis is imported only when a property is tried


@dataclass(frozen=True)
class RigidMotion:
    """A motion: a rotation by `turn_deg` about an axis (3,), then a shift (3,), mm."""

    axis: tuple[int, int, int]
    turn_deg: int
    shift_mm: tuple[int, int, int]

    @property
    def T(self) -> NDArray[np.float64]:  # noqa: N802 - a transform's name
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
    def pose(self) -> NDArray[np.float64]:
        """The pose (4, 4), metres: the yaw, then the tilt about a horizontal axis, at z = 0."""
        x, y, yaw = self.slide
        tilt = rotation_about([1.0, 0.5, 0.0], math.radians(self.tilt_deg))
        return make_transform(tilt @ rotation_about([0, 0, 1], yaw), [x, y, 0.0])


def hold(claim: Callable[..., None], examples: int = EXAMPLES, **drawn: Strategy) -> None:
    """Try a claim, a function that raises ContractError if it does not hold, on drawn values of its arguments.

    Raises ContractError if values break the claim; its message names simplified values. Raises MissingLibraryError if
    hypothesis is not installed. Only hypothesis's phases `generate` and `shrink` are used, if its profile has them.
    """
    hypothesis = require_hypothesis()

    def try_values(**values: Any) -> None:
        try:
            claim(**values)
        except ContractError as error:
            named = ", ".join(f"{name}={value!r}" for name, value in values.items())
            raise ContractError(f"{error} (with {named})") from None

    phases = {hypothesis.Phase.generate, hypothesis.Phase.shrink} & set(hypothesis.settings.default.phases)
    settings = hypothesis.settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        phases=phases,
        print_blob=False,
        report_multiple_bugs=False,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    try:
        settings(hypothesis.given(**drawn)(try_values))()
    except hypothesis.errors.Flaky as error:
        raise ContractError("the same case broke a property only once; keep no state between calls") from error


def whole(least: int, most: int) -> Strategy:
    """Draw a whole number from `least` to `most`. The least number is the simplest.

    The number is made of bits, because hypothesis mixes constants of imported code into its own whole numbers. These
    constants would differ between runs, and hypothesis would create a folder for them.
    """
    span = most - least + 1
    bits = span.bit_length() + SPARE_BITS

    def number(drawn: Sequence[bool]) -> int:
        value = sum(bit << place for place, bit in enumerate(reversed(drawn)))
        return least + (value * span >> bits)

    strategies = require_hypothesis().strategies
    return strategies.tuples(*[strategies.booleans()] * bits).map(number)


def signed(most: int) -> Strategy:
    """Draw a whole number from -most to most. 0 is the simplest."""
    return whole(0, 2 * most).map(lambda number: (number + 1) // 2 * (-1) ** number)


def one_of(values: Sequence[Any]) -> Strategy:
    """Draw one of the values. The first value is the simplest."""
    return whole(0, len(values) - 1).map(values.__getitem__)


def orders(count: int) -> Strategy:
    """Draw an order of the numbers 0 to count - 1. The reverse order is the simplest."""

    def order(number: int) -> list[int]:
        left, drawn = list(range(count))[::-1], []
        for size in range(count, 0, -1):
            number, place = divmod(number, size)
            drawn.append(left.pop(place))
        return drawn

    return whole(0, math.factorial(count) - 1).map(order)


def shifts(least_mm: int = 20, most_mm: int = 150) -> Strategy:
    """Draw a shift: three whole numbers of mm of either sign, whose sizes are between the limits."""
    sizes = range(least_mm, most_mm + 1)
    return require_hypothesis().strategies.tuples(*[one_of([*sizes, *(-size for size in sizes)])] * 3)


def motions(least_deg: int = 15, most_mm: int = 150) -> Strategy:
    """Draw a RigidMotion with a rotation of at least `least_deg` and a shift of at most `most_mm` along each axis."""
    builds = require_hypothesis().strategies.builds
    return builds(RigidMotion, axis=one_of(AXES), turn_deg=whole(least_deg, 180), shift_mm=shifts(0, most_mm))


def places(most_tenths_mm: int = 30, most_tilt_deg: int = 0) -> Strategy:
    """Draw a Place with any yaw, and with at most these offsets along each axis and this tilt."""
    x, y = (signed(most_tenths_mm) for _ in range(2))
    yaw, tilt = whole(0, 359), whole(0, most_tilt_deg)
    return require_hypothesis().strategies.builds(Place, x_tenths_mm=x, y_tenths_mm=y, yaw_deg=yaw, tilt_deg=tilt)


def slides() -> Strategy:
    """Draw a Place as the offset of a candidate: at most 0.8 mm along each axis, and a yaw of at most 5 degrees."""
    x, y = (signed(8) for _ in range(2))
    return require_hypothesis().strategies.builds(Place, x_tenths_mm=x, y_tenths_mm=y, yaw_deg=signed(5))


def require_hypothesis() -> Any:
    """Return the library hypothesis. Raises MissingLibraryError if it is not installed."""
    try:
        return import_module("hypothesis")
    except ImportError as error:
        raise MissingLibraryError(
            "properties need hypothesis, which is not installed: pip install 'tactile-loc[testing]'"
        ) from error
