"""Examples: simulated ones are reproducible, and those of touch files keep their poses and problems."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import Localizer, write_touch
from tactile_loc.core.geometry.rigid import (
    axis_angle,
    invert,
    make_transform,
    quaternion_to_rotation,
    rotation_angle,
    rotation_to_quaternion,
)
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.recall.examples import DrawnExamples, LabelledExamples
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.plugin import ConfigError, TouchError


@pytest.fixture(scope="module")
def hook(store) -> Localizer:
    return Localizer.create("hook", store=store)


@pytest.fixture(scope="module")
def examples(hook) -> DrawnExamples:
    return DrawnExamples(hook, SimulatedTouches("none", 1), 4, 3)


def test_an_example_is_at_rest_and_its_touches_show_contact(examples):
    touches = [touch for _, touch in examples.draw(2).observations]
    assert [touch.name for touch in touches] == [f"example-0002-touch-{k}" for k in (1, 2, 3)]
    for touch in touches:
        assert np.allclose(touch.T_base_sensor @ touch.T_sensor_object, np.eye(4), atol=1e-12)
        assert touch.contact_shape.contact.any()


def test_an_example_with_more_touches_has_the_same_first_touches(examples):
    few = dataclasses.replace(examples, most=1).draw(1)
    more = examples.draw(1)
    assert np.array_equal(few.observations[0][1].contact_shape.depth_m, more.observations[0][1].contact_shape.depth_m)


def test_noise_moves_the_reported_sensor_poses_by_the_stated_standard_deviation(examples):
    noisy = dataclasses.replace(examples, source=SimulatedTouches("strong", 1), most=2)
    touches = [touch for n in range(12) for _, touch in noisy.draw(n).observations]
    turns = np.array([rotation_angle((t.T_base_sensor @ t.T_sensor_object)[:3, :3]) for t in touches])
    assert touches[0].T_base_sensor_std_rad == NOISE["strong"].sensor_rad
    assert np.sqrt((turns**2).mean() / 3) == pytest.approx(NOISE["strong"].sensor_rad, rel=0.35)


@pytest.fixture
def touches(hook):
    return hook.simulate(3, seed=4)


@pytest.fixture
def folder(tmp_path, touches) -> Path:
    for touch in touches:
        write_touch(tmp_path / f"{touch.name}.npz", touch)
    return tmp_path


def write_table(folder: Path, touches, example: str = "x") -> Path:
    rows = []
    for touch in touches:
        angle_deg, axis = axis_angle(touch.T_sensor_object[:3, :3])
        numbers = [*(1e3 * touch.T_sensor_object[:3, 3]), angle_deg, *axis]
        rows.append(f"{touch.name}.npz,{','.join(f'{v:.12g}' for v in numbers)},{example}")
    path = folder / "poses.csv"
    path.write_text("touch,x_mm,y_mm,z_mm,turn_deg,axis_x,axis_y,axis_z,example\n" + "\n".join(rows) + "\n")
    return path


def turn(T):
    """Return a pose with its quaternion's scalar moved from the first to the last place."""
    return make_transform(quaternion_to_rotation(np.roll(rotation_to_quaternion(T[:3, :3]), -1)), T[:3, 3])


def test_true_poses_in_another_unit_or_frame_are_doubted(hook, folder, touches):
    assert LabelledExamples.read(hook, [write_table(folder, touches)]).find_doubt() == ""
    for spoil in (lambda T: make_transform(T[:3, :3], 1e-3 * T[:3, 3]), invert, turn):
        wrong = [dataclasses.replace(touch, T_sensor_object=spoil(touch.T_sensor_object)) for touch in touches]
        doubt = LabelledExamples.read(hook, [write_table(folder, wrong)]).find_doubt()
        assert re.search(naming("3 of 3", touches[0].name, "unit", "inverted"), doubt)


def test_one_wrong_true_pose_of_three_may_be_noise(hook, folder, touches):
    spoiled = dataclasses.replace(touches[0], T_sensor_object=invert(touches[0].T_sensor_object))
    assert LabelledExamples.read(hook, [write_table(folder, [spoiled, *touches[1:]])]).find_doubt() == ""


def test_the_known_poses_give_the_sensors_poses(hook, folder, touches):
    examples = LabelledExamples.read(hook, [write_table(folder, touches)])
    assert (examples.count, examples.most) == (1, 3)
    for touch, (localizer, read) in zip(touches, examples.draw(0).observations, strict=True):
        assert localizer is hook
        assert np.allclose(read.T_sensor_object, touch.T_sensor_object, atol=1e-9)
        assert np.allclose(read.T_base_sensor @ read.T_sensor_object, np.eye(4), atol=1e-9)
        assert np.array_equal(read.contact_shape.depth_m, touch.contact_shape.depth_m)


def test_several_tables_are_several_examples(hook, folder, touches):
    single = write_table(folder, touches[:1]).rename(folder / "one.csv")
    examples = LabelledExamples.read(hook, [single, write_table(folder, touches)])
    assert [len(examples.draw(n).observations) for n in range(examples.count)] == [1, 3]


def test_an_example_ends_before_a_touch_that_cannot_be_read(hook, folder, touches):
    path = write_table(folder, touches)
    (folder / f"{touches[1].name}.npz").write_bytes(b"damaged")
    example = LabelledExamples.read(hook, [path]).draw(0)
    assert [touch.name for _, touch in example.observations] == [f"{touches[0].name}.npz"]
    assert touches[1].name in example.problem


def test_more_touches_than_an_example_has_are_refused(hook, folder, touches):
    examples = LabelledExamples.read(hook, [write_table(folder, touches)])
    examples.require_touches((1, 3))
    with pytest.raises(ConfigError):
        examples.require_touches((1, 4))


def test_other_poses_or_touches_have_another_description(hook, folder, touches):
    path = write_table(folder, touches)
    first = LabelledExamples.read(hook, [path]).describe()
    assert LabelledExamples.read(hook, [path]).describe() == first
    assert LabelledExamples.read(hook, [write_table(folder, touches[:2])]).describe() != first
    write_touch(folder / f"{touches[0].name}.npz", touches[1])
    assert LabelledExamples.read(hook, [write_table(folder, touches)]).describe() != first


def test_sensor_poses_of_some_touches_only_are_refused(hook, folder, touches):
    write_touch(folder / f"{touches[0].name}.npz", dataclasses.replace(touches[0], T_base_sensor=np.eye(4)))
    with pytest.raises(TouchError, match=naming(touches[1].name, "T_base_sensor")):
        LabelledExamples.read(hook, [write_table(folder, touches)]).draw(0)
