from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry import make_transform, rotation_about, translation

RADIUS_M = 0.008


@pytest.fixture(scope="module")
def ball_scene(make_object, make_scene, flat_camera):
    return make_scene(make_object(trimesh.creation.icosphere(6, RADIUS_M), name="ball"), flat_camera)


def test_a_balls_contact_shape_is_its_cap(ball_scene):
    g = ball_scene.geometry
    centre = np.array([0.001, -0.0015])
    T, touching = ball_scene.in_contact(translation([[*centre, 0.0]]))
    assert touching.all()
    assert T[0, 2, 3] == pytest.approx(g.standoff_m + RADIUS_M, abs=1e-6)
    x, y = np.meshgrid((np.arange(60) + 0.5 - g.cx) / g.fx, (np.arange(44) + 0.5 - g.cy) / g.fy)
    rho = np.minimum(np.hypot(x - centre[0], y - centre[1]), RADIUS_M)
    cap = np.minimum(RADIUS_M - np.sqrt(RADIUS_M**2 - rho**2), g.max_depth_m)
    depths = ball_scene.contact_depths(T)
    assert (depths.shape, depths.dtype) == ((1, 44, 60), np.float32)
    # Height map cells are 0.1 mm wide: on the rim's slope of one half they may be off by some 0.05 mm.
    np.testing.assert_allclose(depths[0], cap, atol=8e-5)
    assert np.abs(depths[0] - cap).mean() < 5e-6


def test_a_lighter_press_shows_the_same_cut_off(ball_scene):
    T, _ = ball_scene.in_contact(translation([[0.0, 0.0, 0.0]]))
    full, light = ball_scene.contact_depths(T), ball_scene.contact_depths(T, 0.0005)
    np.testing.assert_array_equal(light, np.minimum(full, np.float32(0.0005)))
    assert 0 < (light < np.float32(0.0005)).sum() < (full < np.float32(0.002)).sum()


def test_contact_shape_brings_the_pose_to_contact_first(ball_scene):
    near, far = (ball_scene.contact_shape(translation([0.001, 0.002, z]), 0.001) for z in (0.0, 5.0))
    assert near.press_depth_m == 0.001
    assert near.contact.any()
    np.testing.assert_allclose(near.depth_m, far.depth_m, atol=1e-6)


def test_x_is_right_and_y_is_down(make_box, make_scene, flat_camera):
    """A box at +x and +y shows in the last columns and rows; turned by yaw, its long side follows."""
    scene = make_scene(make_box(0.008, 0.003, 0.004), flat_camera)
    contact = scene.contact_shape(translation([0.007, 0.005, 0.0]), 0.002).contact
    rows, columns = np.nonzero(contact)
    assert columns.mean() + 0.5 == pytest.approx(29.0 + 0.007 * 2500, abs=0.6)
    assert rows.mean() + 0.5 == pytest.approx(21.0 + 0.005 * 2500, abs=0.6)
    assert np.ptp(columns) > 2 * np.ptp(rows)
    # +30 degrees about +z turns +x (right) towards +y (down): columns and rows grow together.
    turned = make_transform(rotation_about([0, 0, 1], np.radians(30)), np.zeros(3))
    rows, columns = np.nonzero(scene.contact_shape(turned, 0.002).contact)
    assert np.corrcoef(rows, columns)[0, 1] > 0.5


def test_no_pose_is_no_work(ball_scene):
    assert ball_scene.contact_depths(np.zeros((0, 4, 4))).shape == (0, 44, 60)
