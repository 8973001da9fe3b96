"""The joint registration of an object to several touches."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotate_covariance, rotation_about
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.scene import View

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
        found.append([
            T_here @ pose.T_sensor_object, T_here @ pose.T_reported_object, pose.T_sensors_object,
            rotate_covariance(pose.covariance, R), rotate_covariance(pose.reported_covariance, R),
        ])  # fmt: skip
        assert pose.imprint_iou > 0.95
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-3, abs=1e-6 * np.abs(one).max())
    assert found[0][0][:3, 3] == pytest.approx(true[0][:3, 3], abs=3e-4)
