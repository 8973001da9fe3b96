"""Touches of a robot: the object's pose, refused presses, and errors of sensor poses."""

import numpy as np
import pytest
import trimesh

from tactile_loc import RobotTouches, SensorGeometry, Touch
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.plugin import TouchError
from tactile_loc.plugin.helpers import invert, rotation_angle
from tactile_loc.testing.problems import ReferenceRenderer

GEOMETRY = SensorGeometry("orthographic", 64, 48, 3200.0, 3200.0, 32.0, 24.0, 0.010, 0.002)


@pytest.fixture
def ball(make_object):
    return make_object(trimesh.creation.icosphere(3, 0.006), name="ball")


def touches_of(obj, **more) -> RobotTouches:
    return RobotTouches(obj, GEOMETRY, ReferenceRenderer(), **more)


def test_a_ball_is_pressed_in_by_the_indentation_of_the_touch(ball):
    touches, refused = touches_of(ball).draw_example(5, np.random.default_rng(0))
    assert (len(touches), refused) == (5, 0)
    for touch in touches:
        assert 0.3 * 0.002 <= touch.press_depth_m <= 0.9 * 0.002
        centre_m = touch.T_sensor_object[2, 3]
        assert centre_m == pytest.approx(0.010 - touch.indentation_m + 0.006, abs=5e-5)  # of the polyhedron in the ball
        np.testing.assert_allclose(touch.T_base_sensor @ touch.T_sensor_object, np.eye(4), atol=1e-12)


def test_equal_seeds_make_equal_examples(make_box):
    box = make_box(0.020, 0.012, 0.008)
    a, b, c = (touches_of(box).draw_example(2, np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    for x, y, z in zip(a, b, c, strict=True):
        assert x.contact_shape.depth_m.tobytes() == y.contact_shape.depth_m.tobytes()
        assert not np.allclose(x.T_sensor_object, z.T_sensor_object)


def test_unusable_presses_are_counted(make_box):
    """A random press never meets a plate larger than the sensor flat; here the noise hides whole contacts."""
    box = make_box(0.020, 0.012, 0.008)
    example = touches_of(box, noise=NOISE["strong"], press=(0.05, 0.1)).draw_example(20, np.random.default_rng(3))
    assert len(example[0]) == 20
    assert example[1] > 0


@pytest.mark.slow
def test_an_object_with_too_few_usable_touches_is_refused(ball):
    with pytest.raises(TouchError, match="ball"):
        touches_of(ball, least_percent=99.0).draw_example(1, np.random.default_rng(0))


@pytest.mark.parametrize("press_m", [0.0005, 0.002])
def test_opposed_fingers_are_apart_by_the_thickness_of_the_object(ball, press_m):
    first, second = touches_of(ball).draw_grip(np.random.default_rng(4), press_m)
    T = invert(first.T_base_sensor) @ second.T_base_sensor
    np.testing.assert_allclose(T[:3, :3], np.diag([1, -1, -1]), atol=1e-12)  # face to face
    apart_m = T[2, 3] - 2 * GEOMETRY.standoff_m
    assert apart_m == pytest.approx(0.012 - 2 * press_m, abs=1e-4)


def test_sensor_poses_have_errors_of_the_stated_size(ball):
    std_m, std_rad = 5e-4, np.radians(0.5)
    touches, _ = touches_of(ball, sensor_std_m=std_m, sensor_std_rad=std_rad).draw_example(60, np.random.default_rng(5))
    off = [touch.T_base_sensor @ touch.T_sensor_object for touch in touches]  # the identity for exact sensor poses
    turned = np.array([rotation_angle(T[:3, :3]) for T in off])
    assert np.sqrt((turned**2).mean() / 3) == pytest.approx(std_rad, rel=0.2)
    gels = [
        touch.T_sensor_object @ invert(T) @ np.linalg.inv(touch.T_sensor_object)
        for touch, T in zip(touches, off, strict=True)
    ]
    shifts = np.array([(T @ [0, 0, GEOMETRY.standoff_m, 1] - [0, 0, GEOMETRY.standoff_m, 1])[:3] for T in gels])
    assert shifts.std() == pytest.approx(std_m, rel=0.2)
    assert {(t.T_base_sensor_std_m, t.T_base_sensor_std_rad) for t in touches} == {(std_m, std_rad)}
    (touch,), _ = touches_of(ball).draw_example(1, np.random.default_rng(6))
    assert touch.T_base_sensor_std_m == Touch.T_base_sensor_std_m
