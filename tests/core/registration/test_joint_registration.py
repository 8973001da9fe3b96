"""The joint registration of an object to several touches."""

import numpy as np
import pytest

from tactile_loc import Touch
from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.plugin import View
from tactile_loc.plugin.helpers import JointRegistration, invert, make_transform, make_translation, rotation_about

PRESS_M = 1e-3
TURNS = [rotation_about([1, 0, 0], 0.4) @ rotation_about([0, 0, 1], 0.3), rotation_about([0, 1, 0], np.pi / 2 + 0.3)]


def test_poses_may_be_in_the_frame_of_a_sensor_whose_touch_is_left_out(make_box, make_scene, flat_camera):
    scene = make_scene(make_box(0.012, 0.008, 0.006), flat_camera).press(PRESS_M)
    true = scene.bring_to_contact(np.stack([make_transform(R, np.array([1e-3, 2e-3, 0.0])) for R in TURNS]))[0]
    touches = [Touch(scene.contact_shape(T, PRESS_M), scene.geometry) for T in true]
    T_second_first = true[1] @ invert(true[0])
    starts = make_translation([4e-4, -3e-4, 2e-4])[None] @ true[:1]
    T_first_other = make_transform(rotation_about([1, 2, 3], 1.1), np.array([0.02, -0.03, 0.04]))
    found = []
    for T_here in (np.eye(4), T_first_other):  # from the frame of the poses to that of the first touch
        views = [
            View(touch, scene.match_touch(touch), T @ T_here, 3e-4, 5e-3)
            for touch, T in zip(touches, (np.eye(4), T_second_first), strict=True)
        ]
        (pose,) = JointRegistration().refine(views, invert(T_here) @ starts)
        R = T_here[:3, :3]
        found.append(
            [
                T_here @ pose.T_sensor_object,
                T_here @ pose.T_reported_object,
                pose.T_sensors_object,
                rotate_covariance(pose.covariance, R),
                rotate_covariance(pose.reported_covariance, R),
            ]
        )
        assert pose.imprint_iou > 0.95
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-3, abs=1e-6 * np.abs(one).max())
    assert found[0][0][:3, 3] == pytest.approx(true[0][:3, 3], abs=3e-4)


def test_rounding_moves_no_pose(make_box, make_scene, flat_camera):
    """Many points of a box are nearest to an edge, so both of its faces are equally near."""
    scene = make_scene(make_box(0.012, 0.008, 0.006), flat_camera).press(PRESS_M)
    true = scene.bring_to_contact(make_transform(TURNS[0], np.array([1e-3, 2e-3, 0.0]))[None])[0]
    view = View(touch := Touch(scene.contact_shape(true[0], PRESS_M), scene.geometry), scene.match_touch(touch))
    rng = np.random.default_rng(0)
    turns = np.stack([rotation_about(rng.normal(size=3), rng.uniform(0, 0.8)) for _ in range(60)])
    starts = make_transform(turns, rng.normal(0, 1e-3, (60, 3))) @ true
    found = JointRegistration().register_coarsely([view], starts)
    for _ in range(3):
        rounded = starts.copy()
        rounded[:, :3, 3] += rng.normal(0, 1e-16, (60, 3))
        np.testing.assert_allclose(JointRegistration().register_coarsely([view], rounded), found, atol=1e-8)


def test_a_pose_may_need_the_errors_of_the_sensor_poses(make_box, make_scene, flat_camera):
    """With the reported sensor poses, registered poses explain the touches worse than before registration."""
    scene = make_scene(make_box(0.012, 0.008, 0.006), flat_camera).press(PRESS_M)
    rng, std_m, std_rad = np.random.default_rng(6), 3e-4, 5e-3
    turns = [TURNS[0] @ rotation_about([0, 0, 1], angle) for angle in (0.0, 1.6, 3.1, 4.7)]
    true = scene.bring_to_contact(np.stack([make_transform(R, np.array([1e-3, 2e-3, 0.0])) for R in turns]))[0]
    touches = [Touch(scene.contact_shape(T, PRESS_M), scene.geometry) for T in true]
    errors = make_translation(rng.normal(0, std_m, (4, 3)))
    views = [
        View(touch, scene.match_touch(touch), error @ T @ invert(true[0]), std_m, std_rad)
        for touch, T, error in zip(touches, true, errors, strict=True)
    ]
    starts = make_translation(rng.normal(0, 2e-4, (40, 3))) @ true[:1]
    found = JointRegistration().refine(views, starts)
    after = np.mean([view.imprint_ious(np.stack([p.T_sensor_object for p in found])) for view in views], axis=0)
    before = np.mean([view.imprint_ious(starts) for view in views], axis=0)
    assert (after < before - 0.05).sum() >= 10
    assert all(pose.T_sensors_object is not None for pose in found)
