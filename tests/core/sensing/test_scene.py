import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.testing.problems import CAMERAS, ReferenceRenderer, press_block

RADIUS_M = 0.008


@pytest.fixture(scope="module")
def ball_scene(make_object, make_scene, flat_camera):
    return make_scene(make_object(trimesh.creation.icosphere(6, RADIUS_M), name="ball"), flat_camera)


def test_the_contact_shape_of_a_ball_is_its_cap(ball_scene):
    g = ball_scene.geometry
    centre = np.array([0.001, -0.0015])
    T, touching = ball_scene.bring_to_contact(make_translation([[*centre, 0.0]]))
    assert touching.all()
    assert T[0, 2, 3] == pytest.approx(g.standoff_m + RADIUS_M, abs=1e-6)
    x, y = np.meshgrid((np.arange(60) + 0.5 - g.cx) / g.fx, (np.arange(44) + 0.5 - g.cy) / g.fy)
    rho = np.minimum(np.hypot(x - centre[0], y - centre[1]), RADIUS_M)
    cap = np.minimum(RADIUS_M - np.sqrt(RADIUS_M**2 - rho**2), g.max_depth_m)
    depths = ball_scene.render_contact_depths(T)
    assert (depths.shape, depths.dtype) == ((1, 44, 60), np.float32)
    # Height map cells are 0.1 mm wide. The slope at the rim is one half, so the error may be about 0.05 mm.
    np.testing.assert_allclose(depths[0], cap, atol=8e-5)
    assert np.abs(depths[0] - cap).mean() < 5e-6


def test_contact_shape_first_brings_the_pose_to_contact(ball_scene):
    near, far = (ball_scene.contact_shape(make_translation([0.001, 0.002, z]), 0.001) for z in (0.0, 5.0))
    assert near.press_depth_m == 0.001
    assert near.contact.any()
    np.testing.assert_allclose(near.depth_m, far.depth_m, atol=1e-6)


def test_x_points_right_and_y_points_down(make_box, make_scene, flat_camera):
    """A box at +x and +y appears in the last columns and rows; its long side follows a yaw."""
    scene = make_scene(make_box(0.008, 0.003, 0.004), flat_camera)
    contact = scene.contact_shape(make_translation([0.007, 0.005, 0.0]), 0.002).contact
    rows, columns = np.nonzero(contact)
    assert columns.mean() + 0.5 == pytest.approx(29.0 + 0.007 * 2500, abs=0.6)
    assert rows.mean() + 0.5 == pytest.approx(21.0 + 0.005 * 2500, abs=0.6)
    assert np.ptp(columns) > 2 * np.ptp(rows)
    # +30 degrees about +z rotate +x (right) towards +y (down): columns and rows grow together.
    turned = make_transform(rotation_about([0, 0, 1], np.radians(30)), np.zeros(3))
    rows, columns = np.nonzero(scene.contact_shape(turned, 0.002).contact)
    assert np.corrcoef(rows, columns)[0, 1] > 0.5


@pytest.fixture(params=list(CAMERAS))
def problem(request):
    return press_block(request.param)


def test_the_imprint_iou_is_one_at_the_truth_and_falls_with_the_offset(problem):
    offsets = np.array([0.0, 0.3, 0.6, 1.2, 2.4, 4.8]) * 1e-3
    poses = np.stack([problem.make_candidate((x, 0.0, 0.0)).T_sensor_object for x in offsets])
    explained = problem.scene.imprint_ious(poses, problem.touch)
    assert explained[0] == pytest.approx(1.0, abs=1e-6)
    assert (np.diff(explained) < -0.01).all()
    assert explained[-1] > 0


def test_the_imprint_iou_ignores_small_heights_and_other_poses(problem):
    poses = np.stack([problem.make_candidate((x, 0.0, 0.02)).T_sensor_object for x in (0.0, 0.001, 0.002)])
    together = problem.scene.imprint_ious(poses, problem.touch)
    for off_m in (2e-4, -2e-4):
        lifted = make_translation([0.0, 0.0, off_m]) @ poses
        np.testing.assert_allclose(problem.scene.imprint_ious(lifted, problem.touch), together, atol=1e-6)
    hovering = make_translation([0.0, 0.0, 0.004]) @ poses
    np.testing.assert_array_equal(problem.scene.imprint_ious(hovering, problem.touch), 0.0)
    half_pressed = make_translation([0.0, 0.0, 0.0012]) @ poses
    assert problem.scene.imprint_ious(half_pressed, problem.touch)[0] < 0.8 * together[0]
    alone = [problem.scene.imprint_ious(T[None], problem.touch)[0] for T in poses]
    np.testing.assert_allclose(alone, together, atol=1e-6)


def test_a_pose_beside_the_sensor_has_no_imprint_iou(problem):
    away = make_translation([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]) @ problem.truth
    np.testing.assert_allclose(problem.scene.imprint_ious(away, problem.touch), [1.0, 0.0], atol=1e-6)
    assert problem.scene.imprint_ious(away[:0], problem.touch).shape == (0,)


def test_a_tiny_contact_has_a_high_iou_at_its_true_pose(make_object):
    """A ball's tip covers 0.25 % of the sensor, about thirty pixels, drawn by another renderer."""
    camera = CAMERAS["orthographic"].resize(240, 180)
    ball = make_object(trimesh.creation.icosphere(5, RADIUS_M), name="ball")
    scene, other = (Scene(ball, camera, renderer) for renderer in (HeightmapRenderer(), ReferenceRenderer()))
    share, press_m = 1.0, 8e-4
    while share > 0.0035:
        press_m *= 0.8
        pressed = other.press(press_m)
        T, _ = pressed.bring_to_contact(make_translation([[0.001, 0.0005, 0.0]]))
        shape = ContactShape(pressed.render_contact_depths(T)[0], press_m)
        share = float(shape.contact[camera.observed_mask].mean())
    assert share > 0.0015
    contact, imprint, _ = scene.match_touch(touch := Touch(shape, camera)).compare_imprints(T, touch)
    assert contact[0] > 0.9
    assert imprint[0] > 0.9
