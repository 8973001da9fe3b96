"""Sources of touches that break one contract each: see broken_components."""

from __future__ import annotations

import numpy as np
from broken_components import drifting, made, then

from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.slots.benchmarking import RecordedSource, RecordedTouch, SimulatedSource, TouchSource
from tactile_loc.testing import touch_sources
from tactile_loc.testing.problems import make_block

IMAGE = np.zeros((48, 64, 3), np.uint8)


class Plain(SimulatedSource):
    """A source that keeps the contract: contact shapes in a rigid gel."""

    licence = "own"

    def prepare_sensor(self, folder):
        return {"name": "gelsight-mini", "image_size_px": [64, 48]}

    def press(self, scene, T_sensor_object, rng):
        press_m = scene.geometry.indentation_m
        depth_m = scene.render_contact_depths(T_sensor_object[None])[0]
        return ContactShape(np.minimum(depth_m, np.float32(press_m)), press_m)


class Kept(RecordedSource):
    """A recording with one touch, in which the sensor reads nothing."""

    licence = "own"

    def prepare_sensor(self, folder):
        return {"name": "gelsight-mini", "image_size_px": [64, 48]}

    def find_objects(self):
        return {"block": make_block()}

    def read_touches(self, name):
        return [RecordedTouch(IMAGE, np.eye(4))]


def shift(shape: ContactShape, number: int) -> ContactShape:
    return ContactShape(np.roll(shape.depth_m, number, axis=1), shape.press_depth_m)


def lift(shape, scene, *_):
    return ContactShape(np.full(scene.geometry.shape, 1e-3, np.float32), 1e-3)


def press_alike(self, scene, T, rng):
    return Plain().press(*touch_sources.make_press(Plain(), touch_sources.LIGHT), rng)


def grow(touches, name):
    return [RecordedTouch(touch.image, 2 * touch.T_sensor_object) for touch in touches]


def scribble(shape, scene, T, rng):
    T[0, 3] += 1e-3
    return shape


BROKEN_SOURCES = [
    (touch_sources.check_provenance, made(Plain, licence="")),
    (touch_sources.check_provenance, made(Plain, libraries="taxim")),
    (touch_sources.check_kind, made(TouchSource, prepare_sensor=Plain.prepare_sensor)),
    (touch_sources.check_sensor_table, then(Plain, "prepare_sensor", lambda *_: {})),
    (touch_sources.check_sensor_table, then(Plain, "prepare_sensor", lambda *_: {"name": "gelsight-maxi"})),
    (touch_sources.check_press, then(Plain, "press", lambda shape, *_: ContactShape(shape.depth_m[::2], 1e-3))),
    (touch_sources.check_press, then(Plain, "press", lambda *_: IMAGE[..., 0])),
    (touch_sources.check_press, then(Plain, "press", lift)),
    (touch_sources.check_press_is_repeatable, drifting(Plain, "press", shift)),
    (touch_sources.check_scene_untouched, then(Plain, "press", scribble)),
    (touch_sources.check_deeper_press_shows_more, made(Plain, press=press_alike)),
    (touch_sources.check_objects, then(Kept, "find_objects", lambda *_: {})),
    (touch_sources.check_recorded_touches, Kept()),
    (touch_sources.check_recorded_touches, then(Kept, "read_touches", lambda *_: [])),
    (touch_sources.check_recorded_touches, then(Kept, "read_touches", grow)),
]  # fmt: skip
