"""Every source and method keeps its contract, and each check notices a component that breaks it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from tactile_loc.plugin import ContactShape, registry
from tactile_loc.plugin.helpers import make_translation
from tactile_loc.testing import ContractError, list_checks, parametrize_with_checks
from tactile_loc.testing.contract import CHECKS
from tactile_loc.testing.problems import make_block

from tactile_loc_benchmark.checks import methods, touch_sources
from tactile_loc_benchmark.interfaces import (
    Method,
    RecordedSource,
    RecordedTouch,
    ScoredPoses,
    SimulatedSource,
    TouchSource,
)

SMALL = {"image_size_px": (64, 48)}
IMAGE = np.zeros((48, 64, 3), np.uint8)


def made(base: type, **members: Any) -> Any:
    """An instance of a subclass of `base` with other members."""
    return type(f"Broken{base.__name__}", (base,), members)()


def then(base: type, method: str, change: Any) -> Any:
    """A component whose `method` returns change(result, *arguments)."""
    original = getattr(base, method)
    return made(base, **{method: lambda self, *args: change(original(self, *args), *args)})


def drifting(base: type, method: str, change: Any) -> Any:
    """A component whose `method` returns change(result, number of the call)."""
    calls = iter(range(1000))
    return then(base, method, lambda result, *args: change(result, next(calls)))


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
    (touch_sources.check_provenance, made(TouchSource, prepare_sensor=Plain.prepare_sensor)),
    (touch_sources.check_sensor_table, then(Plain, "prepare_sensor", lambda *_: {})),
    (touch_sources.check_sensor_table, then(Plain, "prepare_sensor", lambda *_: {"name": "gelsight-maxi"})),
    (touch_sources.check_press, then(Plain, "press", lambda shape, *_: ContactShape(shape.depth_m[::2], 1e-3))),
    (touch_sources.check_press, then(Plain, "press", lambda *_: IMAGE[..., 0])),
    (touch_sources.check_press, then(Plain, "press", lift)),
    (touch_sources.check_press, drifting(Plain, "press", shift)),
    (touch_sources.check_scene_untouched, then(Plain, "press", scribble)),
    (touch_sources.check_deeper_press_shows_more, made(Plain, press=press_alike)),
    (touch_sources.check_recorded_touches, then(Kept, "find_objects", lambda *_: {})),
    (touch_sources.check_recorded_touches, Kept()),
    (touch_sources.check_recorded_touches, then(Kept, "read_touches", lambda *_: [])),
    (touch_sources.check_recorded_touches, then(Kept, "read_touches", grow)),
]


class AheadOfSensor(Method):
    """Puts the object in front of the first sensor, in two poses."""

    def locate(self, problem, touches):
        poses = np.asarray(touches[0].T_base_sensor) @ make_translation([[0, 0, 0.02], [0, 0, 0.03]])
        return ScoredPoses(poses, np.array([0.6, 0.3]), np.array([0.6, 0.3]))


def answering(change):
    return then(AheadOfSensor, "locate", lambda answer, problem, touches: change(answer, touches))


def scribble_touch(answer, touch):
    touch.contact_shape.depth_m.flat[0] = 0.123
    return answer


def in_sensor_frame(answer, touches):
    return replace(answer, T_base_object=np.linalg.inv(touches[0].T_base_sensor) @ answer.T_base_object)


def fails_on_few_pixels(answer, touches):
    return answer if touches[0].contact_shape.contact.sum() > 10 else 1 / 0


replace = dataclasses.replace
BROKEN_METHODS = [
    (methods.check_answers, answering(lambda a, t: replace(a, T_base_object=1.01 * a.T_base_object))),
    (methods.check_answers, answering(lambda a, t: a.T_base_object)),
    (methods.check_answers, answering(lambda a, t: replace(a, scores=-a.scores))),
    (methods.check_answers, answering(lambda a, t: replace(a, probabilities=2 * a.scores))),
    (methods.check_answers, answering(lambda a, t: replace(a, probabilities=a.scores - 0.5))),
    (methods.check_inputs_untouched, answering(lambda a, t: scribble_touch(a, t[1]))),
    (methods.check_base_frame, answering(in_sensor_frame)),
    (methods.check_nearly_empty_contact, answering(fails_on_few_pixels)),
    (methods.check_same_again, drifting(AheadOfSensor, "locate", lambda a, n: replace(a, scores=a.scores * (1 + n)))),
]


def create(slot: str, *names: str, **options: Any) -> list[Any]:
    return [registry().create(slot, name, options) for name in names]


QUICK = [
    *create("touch-source", "simulated"),
    *create("touch-source", "contact-mechanics-layer", "tamaas-half-space", **SMALL),
    *create("method", "fpfh-ransac", "fast-global-registration"),
]
SLOW = create("method", "tactile-loc", "icp-starts", "particle-filter", "pixel-matching", "transform-consensus")


@parametrize_with_checks(QUICK)
def test_contract(component, check):
    check(component)


@pytest.mark.slow
@parametrize_with_checks(SLOW)
def test_contract_of_a_slow_method(component, check):
    check(component)


@pytest.mark.parametrize(
    ("check", "component"), [*BROKEN_SOURCES, *BROKEN_METHODS], ids=lambda x: getattr(x, "name", type(x).__name__)
)
def test_a_broken_component_is_noticed(check, component):
    with pytest.raises(ContractError) as caught:
        check(component)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) > 30


@pytest.mark.parametrize(("slot", "broken"), [("touch-source", BROKEN_SOURCES), ("method", BROKEN_METHODS)])
def test_every_check_has_a_broken_component(slot, broken):
    assert {check for check, _ in broken} == {check for check in CHECKS if check.slot == slot}


def test_the_checks_of_a_kind_are_added_to_those_of_every_component():
    assert {check.slot for check in list_checks(AheadOfSensor())} == {"", "method"}
