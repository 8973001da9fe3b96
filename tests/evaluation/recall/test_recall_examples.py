"""Simulated examples: reproducible, from known poses, with the noise's error of the sensor pose."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import rotation_angle
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.recall.examples import DrawnExamples
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.locate.localizer import Localizer


@pytest.fixture(scope="module")
def examples(store) -> DrawnExamples:
    return DrawnExamples(Localizer.create("hook", store=store), SimulatedTouches("none", 1), 4, 3)


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


def test_examples_and_seeds_differ(examples):
    other = dataclasses.replace(examples, source=SimulatedTouches("none", 2))
    poses = [e.draw(n).observations[0][1].T_sensor_object for e, n in ((examples, 0), (examples, 1), (other, 0))]
    assert len({pose.tobytes() for pose in poses}) == 3


def test_noise_moves_the_reported_sensor_poses_by_the_stated_standard_deviation(examples):
    noisy = dataclasses.replace(examples, source=SimulatedTouches("strong", 1), most=2)
    touches = [touch for n in range(12) for _, touch in noisy.draw(n).observations]
    turns = np.array([rotation_angle((t.T_base_sensor @ t.T_sensor_object)[:3, :3]) for t in touches])
    assert touches[0].T_base_sensor_std_rad == NOISE["strong"].sensor_rad
    assert np.sqrt((turns**2).mean() / 3) == pytest.approx(NOISE["strong"].sensor_rad, rel=0.35)


def test_the_description_states_the_noise_and_the_seed(examples):
    other = dataclasses.replace(examples, source=SimulatedTouches("mild", 1))
    assert examples.describe() != other.describe()
    assert examples.describe()["seed"] == 1
