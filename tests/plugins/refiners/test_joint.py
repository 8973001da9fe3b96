"""One pose against several pressed touches, with a truth known in closed form or by construction."""

import numpy as np
import pytest
import trimesh
from press_helpers import moved, pressed, towards, views_of

from tactile_loc import PoseMetric, SensorGeometry
from tactile_loc.plugin import Candidate, View
from tactile_loc.plugin.helpers import invert, make_translation, rotation_about
from tactile_loc.plugins.refiners.joint import JointRefiner
from tactile_loc.testing.problems import make_stepped_block

CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 96, 72, 5000.0, 5000.0, 48.0, 36.0, 0.010, 0.002),
    "pinhole": SensorGeometry("pinhole", 96, 96, 105.0, 105.0, 48.0, 48.0, 0.025, 0.002),
}
DIRECTIONS = ([0, 0, 1], [1, 0, 0], [0.3, 1, 0.2])  # of the object; each is pressed into a sensor


@pytest.fixture(scope="module")
def block(make_object):
    mesh = make_stepped_block()
    return make_object(trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False), name="block")


@pytest.mark.parametrize("camera", CAMERAS)
def test_three_touches_refine_a_candidate_to_the_true_pose(block, camera):
    touches = [pressed(block, CAMERAS[camera], towards(d), (0.0005, -0.0003), 0.001) for d in DIRECTIONS]
    truth = touches[0].T_sensor_object
    away = (
        ([0.001, -0.0005, 0.0008], 6, [1, 0, 0]),
        ([-0.0008, 0.001, -0.0005], 8, [0, 1, 1]),
        ([0, 0, 0], 0, [0, 0, 1]),
    )
    starts = [moved(truth, block, *by) for by in away]
    found = JointRefiner().refine_together(views_of(block, touches), [Candidate(T, 0, 0.0) for T in starts])
    errors = [float(PoseMetric(block).distance(pose.T_sensor_object, truth)) for pose in found]
    assert max(errors) < 1.5e-4
    assert all(pose.contact_iou > 0.9 for pose in found)


@pytest.mark.parametrize("press_m", [0.0005, 0.001, 0.002])
def test_a_block_between_two_fingers_has_its_true_thickness(make_box, press_m):
    """Both fingers press a block of 12 mm: their surfaces are 12 mm minus both presses apart, and z is right."""
    box = make_box(0.030, 0.020, 0.012)
    below, above = (towards([0, 0, side]) for side in (-1, 1))
    geometry = CAMERAS["orthographic"]
    touches = [pressed(box, geometry, R, (0.012, 0.007), press_m) for R in (below, above)]
    first, second = touches
    T_first_second = invert(first.T_base_sensor) @ second.T_base_sensor
    apart_m = T_first_second[2, 3] - 2 * geometry.standoff_m
    assert apart_m == pytest.approx(0.012 - 2 * press_m, abs=1e-9)
    start = moved(first.T_sensor_object, box, [0.0003, 0.0002, 0.001], 2, [1, 1, 0])
    (found,) = JointRefiner().refine_together(views_of(box, touches), [Candidate(start, 0, 0.0)])
    middle_m = (found.T_sensor_object @ [0, 0, 0, 1])[2]
    assert middle_m == pytest.approx(geometry.standoff_m - press_m + 0.006, abs=3e-5)


@pytest.mark.parametrize("corner", [False, True])
def test_a_ball_is_located_at_its_imprint(make_object, corner):
    """The ball is in the centre, or in a corner of the sensor, which cuts off three quarters of the imprint."""
    ball = make_object(trimesh.creation.icosphere(4, 0.006), "none", "ball")
    geometry = CAMERAS["orthographic"]
    _, x1, _, y1 = geometry.rectangle
    x, y = (x1 + 1e-4, y1 + 2e-4) if corner else (0.002, -0.001)
    touch = pressed(ball, geometry, np.eye(3), (x, y), 0.001)
    start = make_translation([0.0006, -0.0004, 0.0005]) @ touch.T_sensor_object
    (found,) = JointRefiner().refine_together(views_of(ball, [touch]), [Candidate(start, 0, 0.0)])
    np.testing.assert_allclose(found.T_sensor_object[:3, 3], touch.T_sensor_object[:3, 3], atol=5e-5)
    if not corner:
        np.testing.assert_allclose(found.T_sensor_object[:3, 3], [x, y, 0.010 - 0.001 + 0.006], atol=5e-5)


def test_undetermined_directions_have_a_large_covariance(make_box):
    """A flat face determines z and the tilts, but neither x, y nor yaw."""
    plate = make_box(0.080, 0.080, 0.005)
    geometry = CAMERAS["orthographic"]
    touch = pressed(plate, geometry, np.eye(3), (0.031, 0.0), 0.001)  # one edge in view, along y
    view = views_of(plate, [touch])
    (found,) = JointRefiner().refine_together(view, [Candidate(touch.T_sensor_object, 0, 0.0)])
    std = np.sqrt(np.diag(found.covariance))
    assert std[1] > 10 * std[0]  # the position along the edge is unknown
    assert std[2] < 1e-3


def test_the_covariance_refers_to_the_origin_of_the_frame(make_box, make_object):
    """The same solid in another frame has the same covariance of rotation, and the origin moves with the rotation."""
    geometry = CAMERAS["orthographic"]
    by_m = np.array([0.02, -0.01, 0.005])
    found = []
    for shift_m in (np.zeros(3), by_m):
        solid = trimesh.creation.box((0.014, 0.010, 0.006)).apply_translation(shift_m)
        obj = make_object(solid, name="box")
        touch = pressed(obj, geometry, rotation_about([1, 0.3, 0], 0.2), (0.001, 0.0), 0.001)
        found.append(JointRefiner().refine_together(views_of(obj, [touch]), [Candidate(touch.T_sensor_object, 0, 0.0)]))
    (here,), (there,) = found
    x, y, z = -here.T_sensor_object[:3, :3] @ by_m  # from the first origin to the second
    moves = np.eye(6)
    moves[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # the cross product with w
    np.testing.assert_allclose(there.covariance[3:, 3:], here.covariance[3:, 3:], rtol=0.05)
    np.testing.assert_allclose(there.covariance, moves @ here.covariance @ moves.T, rtol=0.1, atol=1e-9)


def test_a_wrong_sensor_pose_is_corrected(make_box):
    """The second of two fingers is reported a millimetre too far away; the refiner must correct its pose."""
    box = make_box(0.030, 0.020, 0.012)
    geometry = CAMERAS["orthographic"]
    touches = [pressed(box, geometry, towards([0, 0, side]), (0.012, 0.007), 0.001) for side in (-1, 1)]
    truth = touches[0].T_sensor_object
    believed, doubted = [], []
    for std_m, into in ((1e-6, believed), (1e-3, doubted)):
        views = views_of(box, touches, sensor_std_m=std_m)
        T = make_translation([0.0, 0.0, -0.001]) @ views[1].T_sensor_first
        views = [View(touches[0], views[0].scene), View(touches[1], views[1].scene, T, std_m)]
        (found,) = JointRefiner().refine_together(views, [Candidate(truth, 0, 0.0)])
        into.append(abs(found.T_sensor_object[2, 3] - truth[2, 3]))
    assert doubted[0] < 1e-4
    assert doubted[0] < 0.5 * believed[0]
    for touch, T in zip(touches, found.T_sensors_object, strict=True):
        np.testing.assert_allclose(T[2, 3], touch.T_sensor_object[2, 3], atol=1e-4)


def test_the_error_of_the_first_sensor_is_estimated(block):
    """All touches determine the object's pose in the first sensor, and its covariance."""
    touches = [pressed(block, CAMERAS["orthographic"], towards(d), (0.0, 0.0), 0.001) for d in DIRECTIONS]
    off = make_translation([0.0006, 0.0, 0.0])  # the poses of the other sensors are right
    nominal = views_of(block, touches, sensor_std_m=1e-6)
    moved_views = [View(v.touch, v.scene, v.T_sensor_first @ off, 1e-6) for v in nominal[1:]]
    truth = touches[0].T_sensor_object
    spread = {}
    for std_m in (1e-3, 1e-6):
        views = [View(touches[0], nominal[0].scene, np.eye(4), std_m), *moved_views]
        (found,) = JointRefiner().refine_together(views, [Candidate(truth, 0, 0.0)])
        spread[std_m] = np.sqrt(np.trace(found.covariance[:3, :3]))
        if std_m == 1e-3:
            for view, touch, T in zip(views, touches, found.T_sensors_object, strict=True):
                np.testing.assert_allclose(T[:3, 3], touch.T_sensor_object[:3, 3], atol=2e-4, err_msg=view.touch.name)
            np.testing.assert_allclose(found.T_sensor_object[:3, 3], truth[:3, 3], atol=2e-4)
    assert spread[1e-3] > spread[1e-6]
