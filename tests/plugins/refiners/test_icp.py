from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import is_rigid, make_transform, make_translation, rotation_about, transform_points
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.refiners.icp import IcpRefiner
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.plugins.renderers.raycast import RaycastRenderer
from tactile_loc.plugins.sensors.presets import GelSlim
from tactile_loc.simulate.touch_simulation import simulate_touches


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(load_object("pin", symmetry="none"), GelSlim().geometry, HeightmapRenderer())


@pytest.fixture(scope="module")
def touches(scene) -> list[Touch]:
    """Touches of the pin that show both its steps and its ends, so that nothing can slide."""
    drawn = simulate_touches(FaceGrid(), scene, 40, np.random.default_rng(3), 0.001)
    most = sorted(drawn, key=lambda t: -t.contact_shape.contact.sum())
    return most[:6]


def off_by(touch: Touch, scene: Scene, mm: float, degrees: float, direction: float) -> Candidate:
    """A candidate that lies `mm` and `degrees` about z beside the true pose, brought to contact."""
    centre = transform_points(touch.T_sensor_object, scene.object.mesh.centroid_m[None])[0]
    turn = make_transform(rotation_about([0, 0, 1], np.radians(degrees)), np.zeros(3))
    step = make_translation([mm * 1e-3 * np.cos(direction), mm * 1e-3 * np.sin(direction), 0])
    T = step @ make_translation(centre) @ turn @ make_translation(-centre) @ touch.T_sensor_object
    return Candidate(scene.bring_to_contact(T[None])[0][0], 0, 0.0)


def error_mm(touch: Touch, T: np.ndarray, scene: Scene) -> float:
    return 1e3 * float(PoseMetric(scene.object).distance(T, touch.T_sensor_object))


def test_a_candidate_above_the_sensor_is_brought_to_contact(scene, touches):
    """The contact is registered, so the candidate's z must not matter."""
    touch = touches[0]
    candidate = off_by(touch, scene, 0.5, 2.0, 1.0)
    lifted = Candidate(make_translation([0.0, 0.0, 0.002]) @ candidate.T_sensor_object, 0, 0.0)
    a, b = (IcpRefiner().refine(touch, c, scene).T_sensor_object for c in (candidate, lifted))
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_a_known_offset_is_undone(scene, touches):
    errors, before = [], []
    for i, touch in enumerate(touches):
        candidate = off_by(touch, scene, 1.0, 3.0, direction=float(i))
        refined = IcpRefiner().refine(touch, candidate, scene)
        assert is_rigid(refined.T_sensor_object)
        errors.append(error_mm(touch, refined.T_sensor_object, scene))
        before.append(error_mm(touch, candidate.T_sensor_object, scene))
    assert min(before) > 0.9
    assert np.median(errors) < 0.15
    assert max(errors) < 0.5 * min(before)


def test_the_pose_moves_towards_the_touch(scene, touches):
    """An inverted transform would double the offset."""
    touch = touches[0]
    for mm, degrees in ((1.0, 0.0), (0.0, 3.0)):
        candidate = off_by(touch, scene, mm, degrees, direction=0.7)
        refined = IcpRefiner().refine(touch, candidate, scene)
        assert error_mm(touch, refined.T_sensor_object, scene) < 0.3 * error_mm(touch, candidate.T_sensor_object, scene)


def test_a_contact_of_one_pixel_does_not_converge(scene):
    g = scene.geometry
    depth = np.full(g.shape, 0.001, np.float32)
    depth[100, 100] = 0.0
    speck = Touch(ContactShape(depth, 0.001), g)
    candidate = Candidate(scene.bring_to_contact(np.eye(4)[None])[0][0], 0, 0.0)
    refined = IcpRefiner(IcpRefiner.Options(walls=False)).refine(speck, candidate, scene)
    assert not refined.converged
    assert np.array_equal(refined.T_sensor_object, candidate.T_sensor_object)


@pytest.mark.parametrize("camera", ["pinhole", "orthographic"])
def test_tilt_and_height_are_refined(camera):
    """A wavy block is rotated about x and y and lifted; the refiner must undo this in all six directions."""
    scale = (300.0, 290.0) if camera == "pinhole" else (300.0 / 0.025, 290.0 / 0.025)
    g = SensorGeometry(camera, 200, 180, *scale, 98.0, 92.0, 0.025, 0.002)
    ball = trimesh.creation.icosphere(4, 0.006)
    parts = [
        ball.copy().apply_translation([x, y, z])
        for x, y, z in ((0, 0, 0), (0.004, 0.003, 0.0003), (-0.004, 0.003, 0.0006), (0, -0.005, 0.0004))
    ]
    solid = trimesh.util.concatenate(parts)
    mesh = TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))
    scene = Scene(ObjectModel("bumps", mesh, SymmetryGroup.parse("none", np.zeros(3))), g, RaycastRenderer())
    scene = scene.press(0.002)
    true = scene.bring_to_contact(make_translation([0.0005, 0.0002, 0.0])[None])[0][0]
    touch = Touch(scene.contact_shape(true, 0.002), g, T_sensor_object=true)
    tilt = make_transform(rotation_about([1, 0.5, 0.3], np.radians(2.5)), [0.0004, -0.0003, 0.0])
    candidate = Candidate(
        scene.bring_to_contact((make_translation(true[:3, 3]) @ tilt @ make_translation(-true[:3, 3]) @ true)[None])[0][
            0
        ],
        0,
        0.0,
    )
    refined = IcpRefiner().refine(touch, candidate, scene)
    before = PoseMetric(scene.object).distance(candidate.T_sensor_object, true)
    after = PoseMetric(scene.object).distance(refined.T_sensor_object, true)
    assert before > 2e-4
    assert after < 0.2 * before


def test_the_none_refiner_returns_the_candidate(scene, touches):
    candidate = off_by(touches[5], scene, 1.0, 3.0, 0.0)
    refined = NoRefiner().refine(touches[5], candidate, scene)
    assert np.array_equal(refined.T_sensor_object, candidate.T_sensor_object)
    assert refined.iterations == 0
