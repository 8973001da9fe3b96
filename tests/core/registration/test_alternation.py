"""Refiners of single touches refine poses to several touches: a face, an edge, and three touches of a block."""

import numpy as np
import pytest
import trimesh
from press_helpers import moved, pressed, towards, views_of

from tactile_loc import PoseMetric, SensorGeometry
from tactile_loc.core.registration.alternation import ROUNDS, alternate
from tactile_loc.plugin import Candidate, RefinedPose, Refiner
from tactile_loc.plugins.refiners.icp import IcpRefiner
from tactile_loc.plugins.refiners.joint import JointRefiner
from tactile_loc.testing.problems import make_stepped_block

CAMERA = SensorGeometry("orthographic", 96, 72, 5000.0, 5000.0, 48.0, 36.0, 0.010, 0.002)
DIRECTIONS = ([0, 0, 1], [1, 0, 0], [0.3, 1, 0.2])


class Truth(Refiner):
    """Returns the true pose of a touch."""

    def refine(self, touch, candidate, scene) -> RefinedPose:
        return RefinedPose(touch.T_sensor_object.copy(), 1.0, True, 1)


class Still(Refiner):
    """Returns the candidate."""

    def refine(self, touch, candidate, scene) -> RefinedPose:
        return RefinedPose(candidate.T_sensor_object.copy(), 0.0, True, 1)


class Counting(IcpRefiner):
    """ICP that counts the refined candidates of each touch."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: dict[int, int] = {}

    def refine_many(self, touch, candidates, scene):
        self.counts[id(touch)] = self.counts.get(id(touch), 0) + len(candidates)
        return super().refine_many(touch, candidates, scene)


@pytest.fixture(scope="module")
def block(make_object):
    mesh = make_stepped_block()
    return make_object(trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False), name="block")


@pytest.fixture(scope="module")
def touches(block):
    return [pressed(block, CAMERA, towards(d), (0.0005, -0.0003), 0.001) for d in DIRECTIONS]


def start_near(block, touches) -> np.ndarray:
    return moved(touches[0].T_sensor_object, block, [0.001, -0.0005, 0.0008], 6, [1, 0, 0])


def refine(refiner, obj, touches, T) -> RefinedPose:
    (found,) = refiner.refine_together(views_of(obj, touches), [Candidate(T, 0, 0.0)])
    return found


def measure(obj, T, truth) -> float:
    return float(PoseMetric(obj).distance(T, truth))


def test_every_touch_is_refined_by_the_refiner_itself(block, touches):
    refiner = Counting()
    found = refine(refiner, block, touches, start_near(block, touches))
    assert set(refiner.counts) == {id(touch) for touch in touches}
    assert all(1 <= count <= ROUNDS for count in refiner.counts.values())
    assert found.converged
    assert measure(block, found.T_sensor_object, touches[0].T_sensor_object) < 1.5e-4


def test_a_refiner_that_does_nothing_leaves_the_pose(block, touches):
    T = start_near(block, touches)
    found = refine(Still(), block, touches, T)
    np.testing.assert_array_equal(found.T_sensor_object, T)


def test_true_poses_of_each_touch_give_the_true_pose(block, touches):
    found = refine(Truth(), block, touches, start_near(block, touches))
    np.testing.assert_allclose(found.T_sensor_object, touches[0].T_sensor_object, atol=1e-9)
    assert found.imprint_iou > 0.99


def test_the_covariance_is_that_of_the_joint_registration(block, touches):
    """At the same pose, both have the same information of each touch, except for the robust weights."""
    ours, joint = (refine(r, block, touches, touches[0].T_sensor_object) for r in (Truth(), JointRefiner()))
    for name in ("covariance", "reported_covariance"):
        mine, other = (np.sqrt(np.diag(getattr(one, name))) for one in (ours, joint))
        np.testing.assert_allclose(mine, other, rtol=0.2)


def test_an_edge_fills_in_what_a_face_leaves_open(make_box):
    """The first touch shows a face with one border, and leaves the slide along it open. An edge determines this."""
    plate = make_box(0.060, 0.050, 0.020)
    face = pressed(plate, CAMERA, np.eye(3), (0.0245, 0.0), 0.001)
    edge = pressed(plate, CAMERA, towards([0, 5, 2]), (0.001, 0.0), 0.001)
    truth = face.T_sensor_object
    start = moved(truth, plate, [0.0004, 0.0008, 0.0002], 1, [0.2, 0.1, 1])
    alone, found = (refine(IcpRefiner(), plate, some, start) for some in ([face], [face, edge]))
    assert abs(alone.T_sensor_object - truth)[1, 3] > 3e-4
    assert measure(plate, found.T_sensor_object, truth) < 1.5e-4  # ICP finds a border to half a pixel


def test_a_pose_that_explains_the_touches_worse_is_not_taken(block, touches):
    def go_away(touch, candidates, scene):
        away = [moved(c.T_sensor_object, block, [0.004, 0, 0], 20, [1, 0, 0]) for c in candidates]
        return [RefinedPose(T, 0.0, True, 3) for T in away]

    T = start_near(block, touches)
    (found,) = alternate(views_of(block, touches), [Candidate(T, 0, 0.0)], go_away)
    np.testing.assert_array_equal(found.T_sensor_object, T)
    assert not found.converged
    assert found.iterations == 3 * len(touches)


def test_no_candidates_give_no_poses(block, touches):
    assert IcpRefiner().refine_together(views_of(block, touches), []) == []
