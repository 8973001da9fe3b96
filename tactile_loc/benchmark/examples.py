"""Examples of a suite: touches of one object at rest, drawn by a source and read by its sensor, with known poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.benchmark.suite import Entry, Suite, create
from tactile_loc.core.errors import TouchError
from tactile_loc.core.geometry.rigid import Poses, draw_rotations, invert, make_transform
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.core.slots.benchmarking import RecordedSource, SimulatedSource, TouchSource
from tactile_loc.core.slots.registry import registry
from tactile_loc.core.slots.scene import Scene
from tactile_loc.core.slots.sensor import SensorModel
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.config import SlotConfig
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

EXAMPLES_VERSION = 1  # increase it if the same source and seed give other touches
RENDERER = "raycast"
LEAST_PERCENT = 0.25  # of the observed pixels are in contact in a rigid gel
MOST_DRAWS = 60  # most presses for one touch
REACH_M = 0.3  # the object rests within this distance of the base frame's origin, along each axis
NUMBERS = ("press_depth_m", "indentation_m", "indentation_std_m")
Taken = tuple[list[tuple[ContactShape, Poses]], Poses, int]  # touches and poses, pose at rest, refused presses
ARRAYS = ("depth_m", "numbers", "T_sensor_object", "T_base_object", "count", "refused", "picture")


@dataclass(frozen=True, eq=False)
class Examples:
    """E examples with up to M touches each, in the base frame.

    `depth_m` (E, M, H, W), metres, are the contact shapes, and `numbers` (E, M, 3) their NUMBERS, metres; NaN stands
    for None. `T_sensor_object` (E, M, 4, 4) and `T_base_object` (E, 4, 4), metres, are the true poses. `count` (E,) is
    the number of touches of each example, and `refused` (E,) the number of presses whose observation the sensor
    refused. `picture` is the observation of the first touch, for people.
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
            press_m, indentation_m, std_m = self.numbers[number, k]
            shape = ContactShape(
                self.depth_m[number, k], float(press_m), None if np.isnan(indentation_m) else float(indentation_m),
                float(std_m),
            )  # fmt: skip
            T = self.T_sensor_object[number, k]
            T_base_sensor = self.T_base_object[number] @ invert(T)
            touches.append(Touch(shape, sensor.geometry, f"touch-{k + 1}", T_base_sensor, T))
        return touches


def make_sensor(table: Mapping[str, Any]) -> SensorModel:
    """Return the sensor of a table: its name and its options."""
    chosen = SlotConfig.model_validate(dict(table))
    sensor: SensorModel = registry().create("sensor", chosen.name, chosen.options)
    return sensor


def describe_libraries(source: TouchSource) -> dict[str, str]:
    """Return the versions of a source's libraries. A library that is not installed is left out."""
    found = {}
    for name in source.libraries:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@dataclass(frozen=True, eq=False)
class ExampleDrawer:
    """Draws the examples of one object with one source, and keeps them in a store."""

    suite: Suite
    entry: Entry
    table: Mapping[str, Any]
    object: ObjectModel

    def load(self, store: StageStore) -> Examples:
        """Return the examples, from the store or drawn now."""
        artifact: Artifact = store.build(self.key, self._draw)
        return Examples(*(artifact.load_array(name, mmap=False) for name in ARRAYS))

    @cached_property
    def key(self) -> StageKey:
        """The store key, made from everything that determines the touches."""
        geometry = self.sensor.geometry.describe()
        inputs: dict[str, Any] = {
            "source": self.source.describe(), "libraries": describe_libraries(self.source),
            "sensor": {**self.sensor.describe(), "geometry": geometry}, "object": self.object.describe(),
            "examples": self.suite.examples, "most": max(self.suite.touches), "seed": self.suite.seed,
            "press": list(self.suite.press),
        }  # fmt: skip
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

    def _draw(self, work: Workspace) -> None:
        drawn = self._read() if isinstance(self.source, RecordedSource) else self._press()
        for name in ARRAYS:
            work.save_array(name, getattr(drawn, name), packed=name == "depth_m")

    def _press(self) -> Examples:
        """Press the object from random directions."""
        rows: list[Taken] = []
        pictures: list[NDArray[Any]] = []
        for number in range(self.suite.examples):
            rng = np.random.default_rng([self.suite.seed, number])
            T_base_object = make_transform(draw_rotations(1, rng)[0], rng.uniform(-REACH_M, REACH_M, 3))
            taken, refused = [], 0
            for _ in range(max(self.suite.touches)):
                found, more = self._take(rng, pictures)
                refused += more
                if found is None:
                    break
                taken.append(found)
            rows.append((taken, T_base_object, refused))
        return self._pack(rows, max(self.suite.touches), pictures[0] if pictures else np.zeros((1, 1), np.uint8))

    def _take(
        self, rng: np.random.Generator, pictures: list[NDArray[Any]]
    ) -> tuple[tuple[ContactShape, Poses] | None, int]:
        """Return a touch that the sensor can read, or None, and the number of refused presses before it."""
        assert isinstance(self.source, SimulatedSource)
        refused, geometry = 0, self.sensor.geometry
        renderer = registry().create("renderer", RENDERER, {})
        aim = RobotTouches(self.object, geometry, renderer, self.suite.press)
        for _ in range(MOST_DRAWS):
            T = aim.draw_pose(rng)
            press_m = geometry.max_depth_m * rng.uniform(*self.suite.press)
            own = np.random.default_rng(rng.integers(2**63))  # so that all sources press the same poses
            if T is None:
                continue
            T[2, 3] -= press_m
            scene = Scene(self.object, geometry.press(press_m, geometry.max_depth_m), renderer)
            clean = scene.render_contact_depths(T[None])[0]
            contact = (clean < np.float32(press_m)) & geometry.observed_mask
            if contact.sum() < max(1.0, LEAST_PERCENT / 100 * geometry.observed_mask.sum()):
                continue
            try:
                seen = self.source.press(scene, T, own)
                shape = seen if isinstance(seen, ContactShape) else self.sensor.contact_shape(seen)
                Touch(shape, geometry)  # raises TouchError if a sensor cannot distinguish the press from no touch
            except TouchError:
                refused += 1
                continue
            pictures.append(seen.depth_m if isinstance(seen, ContactShape) else seen)
            return (shape, T), refused
        return None, refused

    def _read(self) -> Examples:
        """Read the recorded touches of the object. Each is an example of its own."""
        assert isinstance(self.source, RecordedSource)
        rows: list[Taken] = []
        pictures: list[NDArray[Any]] = []
        for number, touch in enumerate(self.source.read_touches(self.object.name)):
            rng = np.random.default_rng([self.suite.seed, number])
            T_base_object = make_transform(draw_rotations(1, rng)[0], rng.uniform(-REACH_M, REACH_M, 3))
            pictures.append(touch.image)
            try:
                shape = self.sensor.contact_shape(touch.image)
                Touch(shape, self.sensor.geometry)
                rows.append(([(shape, touch.T_sensor_object)], T_base_object, 0))
            except TouchError:
                rows.append(([], T_base_object, 1))
        return self._pack(rows, 1, pictures[0])

    def _pack(self, rows: list[Taken], most: int, picture: NDArray[Any]) -> Examples:
        count = len(rows)
        depth_m = np.zeros((count, most, *self.sensor.geometry.shape), np.float32)
        numbers, T_sensor_object = np.full((count, most, len(NUMBERS)), np.nan), np.full((count, most, 4, 4), np.nan)
        for e, (taken, _, _) in enumerate(rows):
            for k, (shape, T) in enumerate(taken):
                depth_m[e, k] = shape.depth_m
                indentation_m = np.nan if shape.indentation_m is None else shape.indentation_m
                numbers[e, k] = shape.press_depth_m, indentation_m, shape.indentation_std_m
                T_sensor_object[e, k] = T
        return Examples(
            depth_m, numbers, T_sensor_object, np.stack([T for _, T, _ in rows]),
            np.array([len(taken) for taken, _, _ in rows]), np.array([refused for _, _, refused in rows]), picture,
        )  # fmt: skip
