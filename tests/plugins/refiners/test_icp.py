from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.plugins.refiners.icp import IcpRefiner
from tactile_loc.plugins.renderers.raycast import RaycastRenderer


@pytest.mark.parametrize("camera", ["pinhole", "orthographic"])
def test_tilt_and_height_are_refined(camera, make_object):
    """A wavy block is rotated about x and y and lifted; the refiner must undo this in all six directions."""
    scale = (300.0, 290.0) if camera == "pinhole" else (300.0 / 0.025, 290.0 / 0.025)
    g = SensorGeometry(camera, 200, 180, *scale, 98.0, 92.0, 0.025, 0.002)
    ball = trimesh.creation.icosphere(4, 0.006)
    centres_m = ((0, 0, 0), (0.004, 0.003, 0.0003), (-0.004, 0.003, 0.0006), (0, -0.005, 0.0004))
    bumps = make_object(trimesh.util.concatenate([ball.copy().apply_translation(at) for at in centres_m]))
    scene = Scene(bumps, g, RaycastRenderer()).press(0.002)
    true = scene.bring_to_contact(make_translation([0.0005, 0.0002, 0.0])[None])[0][0]
    touch = Touch(scene.contact_shape(true, 0.002), g, T_sensor_object=true)
    tilt = make_transform(rotation_about([1, 0.5, 0.3], np.radians(2.5)), [0.0004, -0.0003, 0.0])
    tilted = make_translation(true[:3, 3]) @ tilt @ make_translation(-true[:3, 3]) @ true
    candidate = Candidate(scene.bring_to_contact(tilted[None])[0][0], 0, 0.0)
    refined = IcpRefiner().refine(touch, candidate, scene)
    before, after = (PoseMetric(bumps).distance(T, true) for T in (candidate.T_sensor_object, refined.T_sensor_object))
    assert before > 2e-4
    assert after < 0.2 * before
