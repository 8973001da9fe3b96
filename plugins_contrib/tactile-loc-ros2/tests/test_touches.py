"""The touches that the services collect: what each service answers in each state."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tactile_loc import Approach, Localizer, NoContactError

from tactile_loc_ros2.touches import TouchSet, view_in_base

NS = 1_000_000_000


@pytest.fixture(scope="module")
def two(localizer) -> list:
    """Two touches of one object at rest, with sensor poses."""
    return localizer.simulate_together(2, seed=3)


@pytest.fixture
def touches(localizer) -> TouchSet:
    return TouchSet(localizer, approach_count=20)


def add(touches: TouchSet, touch, stamp_s: int) -> dict:
    reply = touches.add(lambda: touch, stamp_s * NS, "base")
    return json.loads(reply.message) | {"success": reply.success}


def error_of(reply) -> str:
    assert not reply.success
    assert reply.found is None
    return json.loads(reply.message)["error"]


def test_without_a_touch_nothing_is_located(touches):
    for service in (touches.locate, touches.suggest):
        assert "no touch" in error_of(service())
    assert "option library" in error_of(touches.identify())
    assert json.loads(touches.clear().message) == {"touches": 0, "cleared": 0}


def test_an_image_is_added_once(touches, two):
    assert add(touches, two[0], 1)["touches"] == 1
    again = add(touches, two[0], 1)
    assert (again["success"], len(touches)) == (False, 1)
    assert "already been added" in again["error"]
    assert add(touches, two[1], 2)["name"] == "touch 2"
    assert touches.stamp_ns == 2 * NS


def test_an_image_without_contact_is_not_added(touches):
    def refuse():
        raise NoContactError("nothing touches the gel")

    assert error_of(touches.add(refuse, NS)) == "nothing touches the gel"
    assert len(touches) == 0


def test_several_touches_need_sensor_poses(touches, two):
    assert add(touches, replace(two[0], T_base_sensor=None), 1)["success"]
    assert "base_frame" in add(touches, replace(two[1], T_base_sensor=None), 2)["error"]


def test_the_number_of_touches_is_limited(localizer, two):
    touches = TouchSet(localizer, most=1)
    assert add(touches, two[0], 1)["success"]
    assert "most_touches" in add(touches, two[1], 2)["error"]
    touches.clear()
    assert add(touches, two[1], 2)["success"]


def test_touches_are_located_together_in_the_base_frame(touches, two):
    for k, touch in enumerate(two):
        add(touches, touch, k)
    reply = touches.locate()
    answer = json.loads(reply.message)
    assert reply.success
    assert (answer["touches"], answer["frame"]) == (2, "base")
    assert answer["verdict"] == reply.found.verdict.value
    located = view_in_base(reply.found)
    np.testing.assert_allclose(answer["T_frame_object"], reply.found.best.T_base_object)
    np.testing.assert_allclose(located.T_sensor_object, reply.found.best.T_base_object)
    np.testing.assert_allclose(answer["covariance"], reply.found.best.base_covariance)
    assert touches.locate().found is reply.found  # located once
    add(touches, replace(two[0], name="again"), 9)
    assert touches.locate().found is not reply.found


def test_the_answer_states_what_the_touches_leave_open_in_the_objects_frame(touches, two):
    add(touches, two[0], 1)
    reply = touches.locate()
    said, freedom = json.loads(reply.message)["freedom"], reply.found.freedom
    assert said["says"] == str(freedom)
    assert said["others"] == freedom.others
    np.testing.assert_array_equal(said["slide_m"], freedom.slide_m)
    np.testing.assert_array_equal(said["turn_rad"], freedom.turn_rad)
    assert said["contact_std_m"] == freedom.contact_std_m


def test_one_touch_without_a_sensor_pose_is_located_in_the_sensor_frame(touches, two):
    add(touches, replace(two[0], T_base_sensor=None), 1)
    reply = touches.locate()
    np.testing.assert_allclose(json.loads(reply.message)["T_frame_object"], reply.found.best.T_sensor_object)


def test_the_next_touch_has_its_expected_information(touches, two):
    add(touches, two[0], 1)
    reply = touches.suggest()
    answer = json.loads(reply.message)
    assert reply.success
    np.testing.assert_allclose(answer["T_frame_sensor"], reply.suggested.approach.T_base_sensor)
    assert answer["information_nats"] == pytest.approx(reply.suggested.information, abs=1e-4)
    assert answer["compared"] + answer["out_of_reach"] == 20


def test_approaches_come_from_a_file(localizer, two, tmp_path):
    file = tmp_path / "approaches.toml"
    T = two[0].T_base_sensor @ np.array(Approach(np.eye(4)).T_base_sensor)
    T[:3, 3] -= 0.05 * T[:3, 2]
    file.write_text(f'[[approach]]\nname = "from behind"\nT_base_sensor = {T.tolist()}\n')
    touches = TouchSet(localizer, approaches=str(file))
    add(touches, two[0], 1)
    answer = json.loads(touches.suggest().message)
    assert (answer["name"], answer["compared"]) == ("from behind", 1)
    missing = TouchSet(localizer, approaches=str(tmp_path / "missing.toml"))
    add(missing, two[0], 1)
    assert "missing.toml" in error_of(missing.suggest())


@pytest.mark.slow
def test_the_touched_object_is_identified():
    models = [Localizer.create(name, sensor="gelslim") for name in ("pin", "head")]
    touches = TouchSet(models[0], models)
    assert "no touch" in error_of(touches.identify())
    for k, touch in enumerate(models[1].simulate_together(2, seed=1)):
        add(touches, touch, k)
    answer = json.loads(touches.identify().message)
    assert answer["object"] == "head"
    assert {one["name"] for one in answer["objects"]} == {"pin", "head"}
    assert sum(one["probability"] for one in answer["objects"]) + answer["none"] == pytest.approx(1, abs=1e-3)
