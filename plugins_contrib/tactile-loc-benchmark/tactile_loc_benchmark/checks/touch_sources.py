"""Checks for sources of touches: the sensor can be made, and reads every touch; a deeper press shows more.

A simulated source presses the stepped block of the checks at a known pose. The sensor of a recorded source reads the
recorded images. The sensor is prepared once for each component, in a temporary folder.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import (
    ContactShape,
    ObjectModel,
    Poses,
    Scene,
    SensorModel,
    TactileLocError,
    Touch,
    TouchError,
    registry,
)
from tactile_loc.testing.contract import ContractError, Untouched, check, require, require_equal
from tactile_loc.testing.problems import ReferenceRenderer, make_ball, make_plain_object, make_planar_pose

from tactile_loc_benchmark.interfaces import RecordedSource, RecordedTouch, SimulatedSource, TouchSource

BALL_M = 0.004
LIGHT, DEEP = 0.5, 0.9  # presses, shares of the deepest press
GROWS = 1.1  # least ratio of the contact's areas at the deep and at the light press
SEED = 7
RIGID = 1e-9  # allowed error of a rotation
RENDERER = ReferenceRenderer()

_prepared: weakref.WeakKeyDictionary[TouchSource, PreparedSensor] = weakref.WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class PreparedSensor:
    """A source's sensor, and the folder with its files."""

    sensor: SensorModel
    folder: TemporaryDirectory[str]


@check("touch-source")
def check_provenance(source: TouchSource) -> None:
    """A source is simulated or recorded. Its licence is stated, and `libraries` are the names of distributions."""
    known = isinstance(source, SimulatedSource | RecordedSource)
    require(known, "a touch source must derive from SimulatedSource or RecordedSource: a benchmark uses no others")
    require(isinstance(source.licence, str) and source.licence, "licence must be a text, such as 'MIT'")
    named = isinstance(source.libraries, tuple) and all(isinstance(name, str) and name for name in source.libraries)
    require(named, f"libraries must be a tuple of distributions' names, not {source.libraries!r}")


@check("touch-source")
def check_sensor_table(source: TouchSource) -> None:
    """`prepare_sensor` returns the `name` and the options of a sensor that can be made."""
    prepare(source)


@check("touch-source")
def check_press(source: TouchSource) -> None:
    """`press` returns an image that the sensor reads, or a contact shape of its image size, and the same again."""
    if not isinstance(source, SimulatedSource):
        return
    seen = press_ball(source, DEEP)
    if isinstance(seen, ContactShape):
        shape = prepare(source).sensor.geometry.shape
        require(seen.depth_m.shape == shape, f"contact depths must have the shape {shape}, not {seen.depth_m.shape}")
        require(seen.depth_m.dtype == np.float32, f"contact depths must be float32, not {seen.depth_m.dtype}")
    else:
        _require_image(seen, "press")
    read_press(source, seen)
    first, again = (one.depth_m if isinstance(one, ContactShape) else one for one in (seen, press_ball(source, DEEP)))
    require_equal(first, again, "the same scene, pose and generator must give the same touch")


@check("touch-source")
def check_scene_untouched(source: TouchSource) -> None:
    """The pose and the object are not written to."""
    if not isinstance(source, SimulatedSource):
        return
    scene, T = make_press(source, DEEP)
    mesh = scene.object.mesh
    before = Untouched(T_sensor_object=T, vertices_m=mesh.vertices_m, faces=mesh.faces)
    source.press(scene, T, np.random.default_rng(SEED))
    before.require()


@check("touch-source")
def check_deeper_press_shows_more(source: TouchSource) -> None:
    """A ball that is pressed more deeply has a greater press depth and a larger contact."""
    if not isinstance(source, SimulatedSource):
        return
    light, deep = (read_press(source, press_ball(source, share)) for share in (LIGHT, DEEP))
    deeper = f"{1e3 * light.deepest_m:.3g} and {1e3 * deep.deepest_m:.3g} mm"
    require(deep.deepest_m > light.deepest_m, f"a deeper press must have a greater press depth, not {deeper}")
    areas = [measure_area(shape) for shape in (light, deep)]
    grown = f"a deeper press of a ball must have a larger contact, not {areas[0]} and {areas[1]} pixels"
    require(areas[1] > GROWS * areas[0], grown)


@check("touch-source")
def check_recorded_touches(source: TouchSource) -> None:
    """Each recorded touch has an image and a rigid pose, and the sensor reads at least one touch of each object."""
    if not isinstance(source, RecordedSource):
        return
    objects = source.find_objects()
    fit = objects and all(isinstance(name, str) and isinstance(obj, ObjectModel) for name, obj in objects.items())
    require(fit, "find_objects must return at least one ObjectModel by its name")
    for name in objects:
        touches = list(source.read_touches(name))
        require(touches, f"read_touches must return touches of {name}")
        refused = []
        for touch in touches:
            require(isinstance(touch, RecordedTouch), f"read_touches must return RecordedTouch, not {touch!r}")
            _require_image(touch.image, "read_touches")
            _require_rigid(touch.T_sensor_object)
            try:
                read(source, touch.image)
            except TouchError as error:
                refused.append(str(error))
        require(len(refused) < len(touches), f"the sensor refuses all touches of {name}: {refused[:1]}")


def prepare(source: TouchSource) -> PreparedSensor:
    """Return the source's sensor, prepared now or for an earlier check."""
    if source not in _prepared:
        folder = TemporaryDirectory()
        table = source.prepare_sensor(Path(folder.name))
        _prepared[source] = PreparedSensor(_make_sensor(table), folder)
    return _prepared[source]


def _make_sensor(table: Any) -> SensorModel:
    named = isinstance(table, Mapping) and isinstance(table.get("name"), str)
    require(named, "prepare_sensor must return a table with the sensor's name and its options")
    options = {key: value for key, value in table.items() if key != "name"}
    try:
        sensor: SensorModel = registry().create("sensor", table["name"], options)
    except TactileLocError as error:
        raise ContractError(f"the table of prepare_sensor must describe a sensor that can be made: {error}") from error
    return sensor


def press_ball(source: SimulatedSource, share: float) -> Any:
    """Return what the source's sensor sees of a ball, pressed in its middle by a share of the deepest press."""
    return source.press(*make_press(source, share), np.random.default_rng(SEED))


def make_press(source: TouchSource, share: float) -> tuple[Scene, Poses]:
    """Return the scene and the pose (4, 4), metres, of a ball that is pressed by a share of the deepest press."""
    geometry = prepare(source).sensor.geometry
    press_m = share * geometry.max_depth_m
    x, y, z = geometry.gel_middle_m
    T = make_planar_pose(x, y, 0.0)
    T[2, 3] = z - press_m + BALL_M
    scene = Scene(make_plain_object("ball", make_ball(BALL_M)), geometry.press(press_m, geometry.max_depth_m), RENDERER)
    return scene, T


def read(source: TouchSource, seen: NDArray[np.uint8] | ContactShape) -> ContactShape:
    """Return the contact shape of an observation. Raises TouchError if the sensor reads none."""
    sensor = prepare(source).sensor
    shape = seen if isinstance(seen, ContactShape) else sensor.contact_shape(seen)
    Touch(shape, sensor.geometry)
    return shape


def read_press(source: TouchSource, seen: NDArray[np.uint8] | ContactShape) -> ContactShape:
    """Return the contact shape of a pressed ball. Raises ContractError if the sensor reads none."""
    try:
        return read(source, seen)
    except TouchError as error:
        raise ContractError(f"the sensor must read a pressed ball in what press returns: {error}") from error


def measure_area(shape: ContactShape) -> int:
    """Return the number of pixels that are displaced by more than half of the press."""
    return int((shape.depth_m < shape.press_depth_m - 0.5 * shape.deepest_m).sum())


def _require_image(image: Any, where: str) -> None:
    fit = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    require(fit, f"{where} must return images (H, W, 3) uint8, or contact shapes if the source is simulated")


def _require_rigid(T: Any) -> None:
    fit = np.shape(T) == (4, 4) and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=RIGID)
    require(fit and np.linalg.det(T[:3, :3]) > 0, "T_sensor_object must be a rigid transform (4, 4), lengths in metres")
