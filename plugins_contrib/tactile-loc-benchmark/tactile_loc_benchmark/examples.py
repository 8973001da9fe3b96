"""Examples of a suite: touches of one object at rest, drawn by a source and read by its sensor, with known poses."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc import RobotTouches, StageKey, StageStore
from tactile_loc.plugin import ContactShape, ObjectModel, Poses, Scene, SensorModel, Touch, TouchError, registry
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform

from tactile_loc_benchmark.interfaces import Image, RecordedSource, SimulatedSource, TouchSource
from tactile_loc_benchmark.suite import Suite, SuiteEntry, create

EXAMPLES_VERSION = 2  # increase it if the same source and seed give other touches
RENDERER = "zbuffer"
MOST_DRAWS = 60  # most presses for one touch
REACH_M = 0.3  # the object rests within this distance of the base frame's origin, along each axis
NUMBERS = ("press_depth_m", "indentation_m", "indentation_std_m")
ARRAYS = ("depth_m", "numbers", "T_sensor_object", "T_base_object", "count", "refused", "picture")


@dataclass(frozen=True, eq=False)
class DrawnTouches:
    """E examples with up to M touches each, in the base frame.

    `depth_m` (E, M, H, W), metres, are the contact shapes, and `numbers` (E, M, 3) their NUMBERS, metres; NaN stands
    for None. `T_sensor_object` (E, M, 4, 4) and `T_base_object` (E, 4, 4), metres, are the true poses. `count` (E,) is
    the number of touches of each example, and `refused` (E,) the number of presses whose observation the sensor
    refused. `picture` is the observation of the first touch, for people: an image or depths; (0, 0) without a touch.
    """

    depth_m: NDArray[np.float32]
    numbers: NDArray[np.float64]
    T_sensor_object: Poses
    T_base_object: Poses
    count: NDArray[np.int64]
    refused: NDArray[np.int64]
    picture: NDArray[Any]

    def __len__(self) -> int:
        return len(self.count)

    def make_touches(self, number: int, sensor: SensorModel) -> list[Touch]:
        """Return the touches of an example, as a sensor with a known pose gives them."""
        touches = []
        for k in range(self.count[number]):
            T = self.T_sensor_object[number, k]
            T_base_sensor = self.T_base_object[number] @ invert(T)
            touches.append(Touch(self.get_shape(number, k), sensor.geometry, f"touch-{k + 1}", T_base_sensor, T))
        return touches

    def get_shape(self, number: int, k: int) -> ContactShape:
        """Return the contact shape of touch `k` of an example."""
        press_m, indentation_m, std_m = (float(value) for value in self.numbers[number, k])
        return ContactShape(self.depth_m[number, k], press_m, None if np.isnan(indentation_m) else indentation_m, std_m)


def make_sensor(table: Mapping[str, Any]) -> SensorModel:
    """Return the sensor of a table: its name and its options."""
    options = {name: value for name, value in table.items() if name != "name"}
    sensor: SensorModel = registry().create("sensor", table["name"], options)
    return sensor


def describe_libraries(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of distributions. A distribution that is not installed is left out."""
    found = {}
    for name in names:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


class SourcePress(NamedTuple):
    """A press that the sensor could read: its contact shape, its true pose, and its observation."""

    shape: ContactShape
    T_sensor_object: Poses
    seen: Image | NDArray[np.float32]


class PressedExample(NamedTuple):
    """Presses on an object at rest, the object's pose, and the number of presses that the sensor refused."""

    presses: list[SourcePress]
    T_base_object: Poses
    refused: int


@dataclass(frozen=True, eq=False)
class ExampleDrawer:
    """Draws the examples of one object with one source, and keeps them in a store."""

    suite: Suite
    entry: SuiteEntry
    table: Mapping[str, Any]
    object: ObjectModel

    def load(self, store: StageStore) -> DrawnTouches:
        """Return the examples, from the store or drawn now."""
        return _read_examples(store.build(self.key, self._draw))

    def find(self, store: StageStore) -> DrawnTouches | None:
        """Return the examples if the store has them."""
        artifact = store.get(self.key)
        return None if artifact is None else _read_examples(artifact)

    @cached_property
    def key(self) -> StageKey:
        """The store key, made from everything that determines the touches."""
        geometry = self.sensor.geometry.describe()
        inputs: dict[str, Any] = {
            "source": self.source.describe(),
            "libraries": describe_libraries(self.source.libraries),
            "sensor": {**self.sensor.describe(), "geometry": geometry},
            "object": self.object.describe(),
            "examples": self.suite.examples,
            "most": max(self.suite.touches),
            "seed": self.suite.seed,
            "press": list(self.suite.press),
        }
        return StageKey("benchmark-touches", EXAMPLES_VERSION, inputs, f"{self.entry.label}, {self.object.name}")

    @cached_property
    def sensor(self) -> SensorModel:
        """The sensor that reads the observations."""
        return make_sensor(self.table)

    @cached_property
    def source(self) -> TouchSource:
        """The source."""
        source: TouchSource = create("touch-source", self.entry)
        return source

    def _draw(self, work: Any) -> None:
        recorded = isinstance(self.source, RecordedSource)
        drawn = self._pack(list(self._read_recorded() if recorded else self._press()))
        for name in ARRAYS:
            work.save_array(name, getattr(drawn, name), packed=name == "depth_m")

    def _press(self) -> Iterator[PressedExample]:
        """Yield examples that are pressed from random directions.

        Each touch has random numbers of its own. So all sources whose sensors have the same geometry get the same
        presses, except the presses that replace refused ones.
        """
        for number in range(self.suite.examples):
            presses, refused = [], 0
            for k in range(max(self.suite.touches)):
                press, more = self._take(np.random.default_rng([self.suite.seed, number, k]))
                refused += more
                if press is None:
                    break
                presses.append(press)
            yield PressedExample(presses, self._lay_down(number), refused)

    def _lay_down(self, number: int) -> Poses:
        """Return the pose (4, 4), metres, of the object at rest in an example; all sources have the same poses."""
        rng = np.random.default_rng([self.suite.seed, number])
        return make_transform(draw_rotations(1, rng)[0], rng.uniform(-REACH_M, REACH_M, 3))

    def _take(self, rng: np.random.Generator) -> tuple[SourcePress | None, int]:
        """Return a press that the sensor can read, or None, and the number of refused presses before it."""
        assert isinstance(self.source, SimulatedSource)
        refused = 0
        for scene, T, own in self._aim(rng):
            try:
                seen = self.source.press(scene, T, own)
                shape = self._read(seen)
            except TouchError:
                refused += 1
                continue
            return SourcePress(shape, T, seen.depth_m if isinstance(seen, ContactShape) else seen), refused
        return None, refused

    def _aim(self, rng: np.random.Generator) -> Iterator[tuple[Scene, Poses, np.random.Generator]]:
        """Yield scenes with the indentation of a press, its pose, and a generator for the source.

        A press that would touch too few pixels of a rigid gel is left out. `rng` is used in the same way whatever the
        source does.
        """
        geometry, renderer = self.sensor.geometry, registry().create("renderer", RENDERER, {})
        robot = RobotTouches(self.object, geometry, renderer, self.suite.press)
        for _ in range(MOST_DRAWS):
            T = robot.draw_pose(rng)
            press_m = geometry.max_depth_m * rng.uniform(*self.suite.press)
            own = np.random.default_rng(rng.integers(2**63))
            if T is None:
                continue
            T[2, 3] -= press_m
            scene = Scene(self.object, geometry.press(press_m, geometry.max_depth_m), renderer)
            if robot.touches_enough(scene.render_contact_depths(T[None])[0], press_m):
                yield scene, T, own

    def _read(self, seen: Image | ContactShape) -> ContactShape:
        """Return the contact shape that the sensor reads. Raises TouchError if it cannot tell it from no touch."""
        shape = seen if isinstance(seen, ContactShape) else self.sensor.contact_shape(seen)
        Touch(shape, self.sensor.geometry)
        return shape

    def _read_recorded(self) -> Iterator[PressedExample]:
        """Yield the recorded touches of the object. Each is an example of its own."""
        assert isinstance(self.source, RecordedSource)
        for number, touch in enumerate(self.source.read_touches(self.object.name)):
            T_base_object = self._lay_down(number)
            try:
                press = SourcePress(self._read(touch.image), touch.T_sensor_object, touch.image)
                yield PressedExample([press], T_base_object, 0)
            except TouchError:
                yield PressedExample([], T_base_object, 1)

    def _pack(self, examples: Sequence[PressedExample]) -> DrawnTouches:
        """Return the examples as arrays. Raises TouchError if there is none."""
        if not examples:
            raise TouchError(f"the source {self.entry.label!r} has no touches of {self.object.name}; leave it out")
        most = max([1, *(len(example.presses) for example in examples)])
        depth_m = np.zeros((len(examples), most, *self.sensor.geometry.shape), np.float32)
        numbers, T_sensor_object = (np.full((*depth_m.shape[:2], *rest), np.nan) for rest in ((len(NUMBERS),), (4, 4)))
        for e, example in enumerate(examples):
            for k, (shape, T, _) in enumerate(example.presses):
                depth_m[e, k], T_sensor_object[e, k] = shape.depth_m, T
                numbers[e, k] = [np.nan if (value := getattr(shape, name)) is None else value for name in NUMBERS]
        pictures = (example.presses[0].seen for example in examples if example.presses)
        return DrawnTouches(
            depth_m,
            numbers,
            T_sensor_object,
            T_base_object=np.stack([example.T_base_object for example in examples]),
            count=np.array([len(example.presses) for example in examples]),
            refused=np.array([example.refused for example in examples]),
            picture=next(pictures, np.zeros((0, 0), np.uint8)),
        )


def _read_examples(artifact: Any) -> DrawnTouches:
    return DrawnTouches(*(artifact.load_array(name, mmap=False) for name in ARRAYS))
