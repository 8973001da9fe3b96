"""Modes of a track: predicted with the sensor, registered to a touch, and slipped to poses nearby."""

from dataclasses import replace

import numpy as np
import pytest
from track_settings import SETTINGS

from tactile_loc import Localizer, PoseMetric, RobotTouches
from tactile_loc.plugin.helpers import invert, make_translation
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.simulate.touch_simulation import lower
from tactile_loc.tracking.track_modes import ModeFilter, SlipPrior

STD = np.array([2e-4] * 3 + [5e-3] * 3)


@pytest.fixture(scope="module")
def head(store) -> Localizer:
    return Localizer.create("head", store=store, **SETTINGS)


@pytest.fixture(scope="module")
def source(head) -> RobotTouches:
    return RobotTouches(head.object, head.sensor.geometry, ZBufferRenderer())


@pytest.fixture(scope="module")
def touch(source):
    return source.draw_example(1, np.random.default_rng(4))[0][0]


@pytest.fixture
def modes(head) -> ModeFilter:
    return ModeFilter(head, np.zeros((6, 6)))


def test_a_mode_at_rest_moves_against_the_sensor(modes, touch):
    T_base_object = touch.T_base_sensor @ touch.T_sensor_object
    mode = modes.start(T_base_object, np.diag(STD**2))
    moved = np.asarray(touch.T_base_sensor) @ make_translation([1e-3, 0.0, 0.0])
    (seen,) = modes.predict([mode], moved, 0.1)
    assert np.allclose(seen.known.T_base_object, T_base_object)
    assert np.allclose(seen.T_sensor_object, invert(moved) @ T_base_object)


def test_a_followed_mode_explains_its_touch_better_and_knows_the_pose_better(modes, touch, head):
    off = make_translation([3e-4, -2e-4, 1e-4])
    start = modes.start(touch.T_base_sensor @ off @ touch.T_sensor_object, np.diag(STD**2))
    (mode,) = modes.predict([start], np.asarray(touch.T_base_sensor), 0.0)
    (found,) = modes.follow([mode], [touch], 0.0)
    assert found.imprint_iou >= found.predicted_iou
    assert np.linalg.det(found.covariance) < np.linalg.det(mode.covariance)
    assert found.known.surprise > 0


def test_a_slip_is_found_among_the_poses_nearby(modes, source, touch, head):
    start = modes.start(touch.T_base_sensor @ touch.T_sensor_object, np.diag((0.1 * STD) ** 2))
    before = modes.predict([start], np.asarray(touch.T_base_sensor), 0.0)
    slipped = make_translation([2e-3, 1e-3, 0.0]) @ touch.T_sensor_object
    poses, _ = head.scene.bring_to_contact(slipped[None])
    press_m = touch.indentation_m
    seen = source.draw_touch(lower(poses, np.array([press_m]))[0], press_m, "slipped", np.random.default_rng(0))
    seen = replace(seen, T_base_sensor=touch.T_base_sensor)
    found = modes.find_slipped(before, [seen], 1.0)
    truth = np.stack([seen.T_sensor_object] * len(found))
    far_m = PoseMetric(head.object).symmetric_distance(np.stack([one.T_sensor_object for one in found]), truth)
    assert far_m.min() < 1e-3
    assert found[0].imprint_iou > modes.explain(before, [seen])[0] + 0.05


def test_a_slip_prior_falls_with_the_distance_down_to_a_floor(head):
    T = make_translation([0.0, 0.0, 0.02])
    prior = SlipPrior(T, 2e-3, 8.0, PoseMetric(head.object))
    poses = np.stack([make_translation([x, 0.0, 0.0]) @ T for x in (0.0, 2e-3, 4e-3, 0.1)])
    assert prior(poses) == pytest.approx([0.0, -0.5, -2.0, -8.0], abs=1e-9)
