"""Examples to locate: simulated touches of one object at rest, from any direction, with known poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.evaluation.simulated_touches import SimulatedTouches, read_image
from tactile_loc.locate.localizer import Localizer, Observation
from tactile_loc.slots.registry import registry

MOST_DRAWS = 100  # most presses for one touch, in case their images show no contact
RENDERER = "raycast"


@dataclass(frozen=True, eq=False)
class TouchedExample:
    """Touches of one object at rest, each with its localizer and its true pose.

    `refused` is the number of presses that made no usable touch and do not count. If a touch cannot be read, `problem`
    states the reason, and the example has only the touches before it.
    """

    observations: tuple[Observation, ...]
    refused: int = 0
    problem: str = ""


class ExampleSource(Protocol):
    """A series of examples. Example number i is always the same."""

    @property
    def count(self) -> int:
        """The number of examples."""

    @property
    def labels(self) -> Mapping[str, Any]:
        """The `noise` or kind of the touches, and their `seed`, -1 without a seed."""

    def draw(self, number: int) -> TouchedExample:
        """Return an example by its number, from 0."""

    def describe(self) -> dict[str, Any]:
        """Return what determines the examples, as JSON values."""


@dataclass(frozen=True, eq=False)
class DrawnExamples:
    """Examples of `most` simulated touches, pressed from random directions and drawn by the ray caster.

    `source` states the noise, the seed, and whether the sensor reads the touches from simulated images. The noise's
    error of the sensor pose is added to `T_base_sensor` of each touch, and its standard deviation is stated. An example
    with more touches has the same touches and further ones.
    """

    localizer: Localizer
    source: SimulatedTouches
    count: int
    most: int

    @property
    def labels(self) -> Mapping[str, Any]:
        """The noise and the seed."""
        return {"noise": self.source.noise, "seed": self.source.seed}

    def draw(self, number: int) -> TouchedExample:
        """Return an example by its number. Raises TouchError if hardly any press makes a touch."""
        rng = np.random.default_rng([self.source.seed, number])
        touches, refused = [], 0
        for k in range(self.most):
            touch, more = self._draw_touch(f"example-{number:04d}-touch-{k + 1}", rng)
            touches.append((self.localizer, touch))
            refused += more
        return TouchedExample(tuple(touches), refused)

    def describe(self) -> dict[str, Any]:
        """Return what determines the examples, as JSON values."""
        described = {"most": self.most, "renderer": RENDERER, "press": list(self._touches.press)}
        return {**described, **self.source.describe(self.localizer)}

    def _draw_touch(self, name: str, rng: np.random.Generator) -> tuple[Touch, int]:
        """Return a touch, and the number of presses that were refused before it."""
        refused = 0
        for _ in range(MOST_DRAWS):
            (touch,), more = self._touches.draw_example(1, rng)
            refused += more
            try:
                seen = read_image(self.localizer, touch, rng) if self.source.images else touch
                return dataclasses.replace(seen, name=name), refused
            except TouchError:
                refused += 1
        raise TouchError(f"hardly any image of {self.localizer.object.name} shows contact; calibrate the sensor better")

    @cached_property
    def _touches(self) -> RobotTouches:
        noise = make_noise(self.source.noise)
        return RobotTouches(
            self.localizer.object,
            self.localizer.scene.geometry,
            registry().create("renderer", RENDERER, {}),
            noise=noise,
            sensor_std_m=noise.sensor_m,
            sensor_std_rad=noise.sensor_rad,
        )
