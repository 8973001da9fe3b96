import numpy as np
import pytest
import trimesh

from tactile_loc import PoseMetric, SensorGeometry, Touch
from tactile_loc.plugin import Candidate, Scene
from tactile_loc.plugin.helpers import Cloud, make_transform, make_translation, rotation_about
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

pytest.importorskip("open3d")

import open3d

from tactile_loc.plugins.refiners import icp
from tactile_loc.plugins.refiners.icp import IcpRefiner


@pytest.mark.parametrize("camera", ["pinhole", "orthographic"])
def test_tilt_and_height_are_refined(camera, make_object):
    """A wavy block is rotated about x and y and lifted; the refiner must undo this in all six directions."""
    scale = (300.0, 290.0) if camera == "pinhole" else (300.0 / 0.025, 290.0 / 0.025)
    g = SensorGeometry(camera, 200, 180, *scale, 98.0, 92.0, 0.025, 0.002)
    ball = trimesh.creation.icosphere(4, 0.006)
    centres_m = ((0, 0, 0), (0.004, 0.003, 0.0003), (-0.004, 0.003, 0.0006), (0, -0.005, 0.0004))
    bumps = make_object(trimesh.util.concatenate([ball.copy().apply_translation(at) for at in centres_m]))
    scene = Scene(bumps, g, ZBufferRenderer()).press(0.002)
    true = scene.bring_to_contact(make_translation([0.0005, 0.0002, 0.0])[None])[0][0]
    touch = Touch(scene.contact_shape(true, 0.002), g, T_sensor_object=true)
    tilt = make_transform(rotation_about([1, 0.5, 0.3], np.radians(2.5)), [0.0004, -0.0003, 0.0])
    tilted = make_translation(true[:3, 3]) @ tilt @ make_translation(-true[:3, 3]) @ true
    candidate = Candidate(scene.bring_to_contact(tilted[None])[0][0], 0, 0.0)
    refined = IcpRefiner().refine(touch, candidate, scene)
    before, after = (PoseMetric(bumps).distance(T, true) for T in (candidate.T_sensor_object, refined.T_sensor_object))
    assert before > 2e-4
    assert after < 0.2 * before


def make_wave(rng: np.random.Generator, count: int) -> Cloud:
    """Points (count, 3), mm, of a wavy surface."""
    x, y = rng.uniform(-8, 8, (2, count))
    normals = np.column_stack([0.5 * np.cos(x), -0.4 * np.sin(1.3 * y), -np.ones(count)])
    points_mm = np.column_stack([x, y, 25 + 0.5 * np.sin(x) + 0.3 * np.cos(1.3 * y)])
    return Cloud(points_mm, normals / np.linalg.norm(normals, axis=1, keepdims=True), 0.3)


def test_the_same_clouds_give_the_same_bits(monkeypatch):
    """The threads of open3d add up in any order; without rounding, this shows."""
    monkeypatch.setattr(icp, "DECIMALS", 17)
    rng, threads = np.random.default_rng(0), open3d.utility.get_max_threads()
    for _ in range(8):
        moving, fixed = make_wave(rng, 800), make_wave(rng, 3000)
        moved = Cloud(moving.points_mm + np.array([0.5, 0.3, 0.1]), moving.normals, 0.3)
        found = {IcpRefiner().register(moved, fixed).T_mm.tobytes() for _ in range(25)}
        assert len(found) == 1
    assert open3d.utility.get_max_threads() == threads
