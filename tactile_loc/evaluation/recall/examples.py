"""Examples to locate, touches of one object at rest with known poses: simulated from any direction, or a user's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, invert
from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.evaluation.simulated_touches import SimulatedTouches, require_true_pose
from tactile_loc.io.touch_lists import Example, read_labelled_touches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.several_touches import Observation
from tactile_loc.locate.touch_files import match_localizers, read_listed_touch
from tactile_loc.slots.registry import registry
from tactile_loc.store.keys import hash_arrays

RENDERER = "zbuffer"
OWN = "own touches"  # the noise or kind of labelled touches
LEAST_TRUE = 0.1  # a smaller imprint IoU at the true pose is unusual; strong noise causes it in a fifth of the touches


@dataclass(frozen=True, eq=False)
class TouchedExample:
    """Touches of one object at rest, each with its localizer and its true pose.

    `refused` is the number of presses that made no usable touch and do not count. If a touch cannot be read, `problem`
    states the reason, and the example has only the touches before it.
    """

    observations: tuple[Observation, ...]
    refused: int = 0
    problem: str = ""


@dataclass(frozen=True, eq=False)
class DrawnExamples:
    """Examples of `most` simulated touches, pressed from random directions and drawn exactly.

    `source` states the noise and the seed. The noise's error of the sensor pose is added to `T_base_sensor` of each
    touch, and its standard deviation is stated. An example with more touches has the same touches and further ones.
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
        """Return an example by its number, from 0. Raises TouchError if hardly any press makes a touch."""
        rng = np.random.default_rng([self.source.seed, number])
        touches, refused = [], 0
        for k in range(self.most):
            (touch,), more = self._touches.draw_example(1, rng)
            touches.append((self.localizer, dataclasses.replace(touch, name=f"example-{number:04d}-touch-{k + 1}")))
            refused += more
        return TouchedExample(tuple(touches), refused)

    def describe(self) -> dict[str, Any]:
        """Return what determines the examples, as JSON values."""
        described = {"most": self.most, "renderer": RENDERER, "press": list(self._touches.press)}
        return {**described, **self.source.describe(self.localizer)}

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


@dataclass(frozen=True, eq=False)
class LabelledExamples:
    """Examples of a user's own touches with known poses, each of one object at rest.

    If no touch of an example has a sensor pose, the known poses give the sensors' poses relative to the object.
    """

    localizer: Localizer
    examples: tuple[Example, ...]

    @classmethod
    def read(cls, localizer: Localizer, paths: Iterable[Path]) -> LabelledExamples:
        """Read the examples of all paths, as `read_labelled_touches` does. Raises TouchError for bad input."""
        return cls(localizer, tuple(example for path in paths for example in read_labelled_touches(path)))

    @property
    def count(self) -> int:
        """The number of examples."""
        return len(self.examples)

    @property
    def most(self) -> int:
        """The largest number of touches of an example."""
        return max(map(len, self.examples))

    @property
    def labels(self) -> Mapping[str, Any]:
        """The kind of the touches, and -1 for the seed."""
        return {"noise": OWN, "seed": -1}

    def require_touches(self, together: Iterable[int]) -> None:
        """Raise ConfigError if no example has as many touches as the largest of the numbers `together`."""
        if max(together) > self.most:
            raise ConfigError(
                f"there are no {max(together)} touches to locate together: an example has at most {self.most}; name "
                "the touches of one object at rest alike in the column 'example', or give a list of touches (.toml)"
            )

    def find_doubt(self) -> str:
        """Return a sentence if the true poses of most touches put the object where it does not touch, otherwise ""."""
        observations = [one for number in range(self.count) for one in self.draw(number).observations]
        ious = measure_true_ious(observations)
        wrong = [touch.name for (_, touch), iou in zip(observations, ious, strict=True) if iou < LEAST_TRUE]
        if 2 * len(wrong) <= len(observations):
            return ""
        return (
            f"the true poses of {len(wrong)} of {len(observations)} touches hardly put the object where it touches "
            f"(imprint IoU below {format_percent(LEAST_TRUE)}), such as that of {wrong[0]}; check the frames "
            "(T_sensor_object, not inverted), the unit (mm in tables, metres in poses.json and lists), the order of "
            "the quaternion, and which file each pose belongs to"
        )

    def draw(self, number: int) -> TouchedExample:
        """Return an example by its number. It ends before the first touch that cannot be read.

        Raises TouchError if only some of several touches have a sensor pose.
        """
        localizers, touches, problem = self._localizers[number], [], ""
        for localizer, listed in zip(localizers, self.examples[number], strict=True):
            try:
                touches.append(read_listed_touch(localizer, listed))
            except TouchError as error:
                problem = str(error)
                break
        return TouchedExample(tuple(zip(localizers, _place_sensors(touches), strict=False)), problem=problem)

    def describe(self) -> dict[str, Any]:
        """Return what determines the examples, as JSON values."""
        drawn = (self.draw(number) for number in range(self.count))
        return {
            "examples": [[*(_describe_touch(touch) for _, touch in one.observations), one.problem] for one in drawn]
        }

    @cached_property
    def _localizers(self) -> list[list[Localizer]]:
        """The localizer of each touch of each example."""
        found = iter(match_localizers(self.localizer, chain.from_iterable(self.examples)))
        return [[next(found) for _ in example] for example in self.examples]


ExampleSource = DrawnExamples | LabelledExamples
"""A series of examples. Example number i is always the same."""


def measure_true_ious(observations: Iterable[Observation]) -> Floats:
    """Return the imprint IoUs (N,) of touches with their true poses. Raises TouchError if a touch has no true pose."""
    return np.array(
        [
            localizer.scene.match_touch(touch).imprint_ious(require_true_pose(touch)[None], touch)[0]
            for localizer, touch in observations
        ]
    )


def _place_sensors(touches: list[Touch]) -> list[Touch]:
    """Return touches with sensor poses in the object's frame, from their known poses, unless they have sensor poses.

    Raises TouchError if only some of several touches have a sensor pose.
    """
    known = [touch.T_base_sensor is not None for touch in touches]
    if len(touches) == 1 or all(known):
        return touches
    if any(known):
        missing = touches[known.index(False)].name
        raise TouchError(
            f"{missing} has no T_base_sensor, but other touches of its example do; give it, or leave all out"
        )
    return [dataclasses.replace(touch, T_base_sensor=invert(np.asarray(touch.T_sensor_object))) for touch in touches]


def _describe_touch(touch: Touch) -> dict[str, Any]:
    poses = {"true": touch.T_sensor_object, "sensor": touch.T_base_sensor}
    arrays = {name: np.asarray(T) for name, T in poses.items() if T is not None}
    return {
        "touch": hash_arrays(depth=touch.contact_shape.depth_m, **arrays),
        "sensor": touch.geometry.describe(),
        "depths_m": [touch.press_depth_m, touch.indentation_m],
        "std": [touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad],
    }
