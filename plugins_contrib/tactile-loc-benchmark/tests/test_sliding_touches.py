"""A sensor slides and rotates over an object: in contact, smoothly, and with the stated pose error."""

import numpy as np
import pytest
from tactile_loc import RobotTouches, SensorGeometry
from tactile_loc.core.sensing.contact import find_lowest_points
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.plugin.helpers import invert, rotation_angle
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

from tactile_loc_benchmark.sliding_touches import MOST_RISE_M, SlidingTouches, Slip

GEOMETRY = SensorGeometry("orthographic", 80, 60, 4000.0, 4000.0, 40.0, 30.0, 0.01, 1e-3)
COUNT, JUMP = 60, 40


def source(obj, **changed) -> RobotTouches:
    return RobotTouches(obj, GEOMETRY, ZBufferRenderer(), **changed)


@pytest.fixture(scope="module")
def box(make_box):
    return make_box(0.03, 0.02, 0.012)


@pytest.fixture(scope="module")
def frames(box):
    return SlidingTouches(source(box)).draw_example(COUNT, np.random.default_rng(2), jump_at=JUMP)


def test_the_sensor_stays_in_contact_at_the_stated_depth(frames, box):
    T = np.array([frame.T_sensor_object for frame in frames])
    pressed_m = GEOMETRY.surface_m - find_lowest_points(box.mesh, T, GEOMETRY.rectangle)
    for frame, m in zip(frames, pressed_m, strict=True):
        assert frame.touch is None or frame.touch.indentation_m == pytest.approx(m, abs=1e-6)
    assert np.ptp(pressed_m) > 1e-5
    assert sum(frame.touch is not None for frame in frames) > 0.9 * COUNT


def test_the_sensor_moves_smoothly_and_reports_its_poses(frames):
    T_base_object = np.array([frame.T_base_sensor @ frame.T_sensor_object for frame in frames])
    assert np.allclose(T_base_object[:JUMP], np.eye(4), atol=1e-9)
    assert np.allclose(T_base_object[JUMP:], T_base_object[JUMP], atol=1e-9)
    assert np.linalg.norm(T_base_object[JUMP, :3] - np.eye(4)[:3]) > 0.1
    T_base_sensor = np.array([frame.T_base_sensor for frame in frames])
    step = invert(T_base_sensor[:-1]) @ T_base_sensor[1:]
    turned = rotation_angle(step[:, :3, :3])
    assert 0 < np.degrees(turned[: JUMP - 1].max()) < 1.0
    gel = np.array([0, 0, GEOMETRY.standoff_m])
    shift_m = np.linalg.norm(step[:, :3, :3] @ gel + step[:, :3, 3] - gel, axis=1)
    assert 0 < shift_m[: JUMP - 1].max() < MOST_RISE_M + 5e-4
    assert shift_m[JUMP - 1] < 1e-12  # the object jumps, not the sensor


def test_a_slip_has_the_requested_length(box):
    slip = Slip(2e-3, 0.1)
    frames = SlidingTouches(source(box)).draw_example(3, np.random.default_rng(4), jump_at=1, slip=slip)
    before, after = (frames[k].T_sensor_object for k in (0, 1))
    T = after @ invert(before)
    gel = np.array([0.0, 0.0, GEOMETRY.standoff_m])
    shift_m = T[:3, :3] @ gel + T[:3, 3] - gel
    assert np.linalg.norm(shift_m[:2]) == pytest.approx(slip.shift_m, rel=0.1), (
        "the shift also contains a small change of the press"
    )
    assert rotation_angle(T[:3, :3]) == pytest.approx(slip.turn_rad, rel=1e-6)
    assert np.allclose(frames[0].T_base_sensor, frames[1].T_base_sensor), "the sensor does not move"


def test_equal_seeds_give_equal_sequences_and_noise_stays_on_the_gel(box):
    sliding = SlidingTouches(source(box, noise=NOISE["mild"]))
    first, again = (sliding.draw_example(3, np.random.default_rng(3)) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.touch.contact_shape.depth_m, b.touch.contact_shape.depth_m)
    np.testing.assert_array_equal(first[0].touch.T_base_sensor, first[0].T_base_sensor)


def test_sensor_poses_have_errors_of_the_stated_size(box):
    std_m, std_rad = 3e-4, 5e-3
    sliding = SlidingTouches(source(box, sensor_std_m=std_m, sensor_std_rad=std_rad), noise_s=0.01)
    frames = sliding.draw_example(150, np.random.default_rng(4))
    off = np.array([frame.T_base_sensor @ frame.T_sensor_object for frame in frames])
    turned = rotation_angle(off[:, :3, :3])
    assert np.sqrt((turned**2).mean() / 3) == pytest.approx(std_rad, rel=0.15)
    assert frames[0].touch.T_base_sensor_std_m == std_m
