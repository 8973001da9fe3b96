"""examples/insertion: the engine's scene, grasps and insertions."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'tactile-loc[sim]'")

from experiment import HOME, Experiment, measure_errors
from insertion import STOP_N, choose_goal, insert, is_inserted, measure_depth_m
from meshes import build_surface
from methods import Started
from robot import Robot
from scene import OPEN_M, build_model
from shapes import PARTS, SEAT_Z_M
from touching import SIDES, find_gel
from trials import list_trials

from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about, rotation_angle

TRIALS = list_trials(3, first_seed=20_000)
BY_PART = {trial.part: trial for trial in TRIALS}


@pytest.fixture
def experiment(tmp_path, store):
    return Experiment(tmp_path / "parts", store)


@pytest.mark.parametrize("name", PARTS)
def test_the_engine_collides_the_surface_that_the_gels_feel(name):
    """The corners of the engine's pieces, in the part's frame, reach exactly as far as the surface along each axis."""
    model = build_model(PARTS[name](), 3e-4)
    robot = Robot(model)
    robot.place(HOME, np.eye(4))
    corners = []
    for geom in np.flatnonzero(model.geom_bodyid == model.body("part").id):
        mesh = model.geom_dataid[geom]
        start = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
        corners.append(vertices @ robot.data.geom_xmat[geom].reshape(3, 3).T + robot.data.geom_xpos[geom])
    corners = np.concatenate(corners)
    np.testing.assert_allclose(
        [corners.min(axis=0), corners.max(axis=0)], build_surface(PARTS[name]()).bounds, atol=1e-6
    )


@pytest.mark.parametrize("name", PARTS)
def test_an_exactly_known_part_is_inserted(name, experiment):
    trial = BY_PART[name]
    robot, start = experiment.start(trial)
    robot.restore(start)
    part = PARTS[name]()
    insert(robot, invert(robot.T_world_gripper) @ robot.T_world_part, part)
    assert is_inserted(robot, part)
    assert measure_depth_m(robot) > part.depth_m - 1e-3


def test_a_part_beside_the_hole_is_not_inserted_and_the_arm_stops(experiment):
    robot, start = experiment.start(BY_PART["peg"])
    robot.restore(start)
    believed = make_translation([0, 3e-3, 0]) @ invert(robot.T_world_gripper) @ robot.T_world_part
    insert(robot, believed, PARTS["peg"]())
    assert not is_inserted(robot, PARTS["peg"]())
    assert STOP_N <= robot.peak_force_n < 1.5 * STOP_N


def test_a_clamped_part_stays_where_it_is(experiment):
    robot, start = experiment.start(BY_PART["plug"])
    robot.restore(start)
    before = robot.T_world_part
    robot.clamp()
    robot.open()
    robot.move(make_translation([0, 0, 8e-3]) @ HOME)
    robot.grasp(soft_arm=True)
    moved = invert(before) @ robot.T_world_part
    assert np.linalg.norm(moved[:3, 3]) < 2e-4
    assert rotation_angle(moved[:3, :3]) < np.radians(0.5)


def test_the_gels_face_each_other_and_their_images_point_up():
    left, right = (find_gel(side, OPEN_M, 0.01) for side in SIDES)
    np.testing.assert_allclose(left[:3, 2], [0, 1, 0])
    np.testing.assert_allclose(right[:3, 2], [0, -1, 0])
    for gel, side in ((left, -1), (right, 1)):
        assert np.linalg.det(gel[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(gel[:3, 0], [0, 0, 1])
        np.testing.assert_allclose(gel @ [0, 0, 0.01, 1], [0, side * OPEN_M, 0, 1], atol=1e-12)


def test_the_goal_seats_the_part_with_the_smallest_turn():
    part = PARTS["peg"]()
    robot = Robot(build_model(part, 3e-4))
    robot.place(HOME, HOME)
    held = make_transform(rotation_about([0, 0, 1], np.radians(80)), [0, 0, 2e-3])
    seated = choose_goal(robot, held, part) @ held
    np.testing.assert_allclose(seated[:3, 3], [0, 0, -SEAT_Z_M], atol=1e-12)
    assert rotation_angle(choose_goal(robot, held, part)[:3, :3]) == pytest.approx(np.radians(10))


def test_errors_are_those_at_the_tip_up_to_the_shanks_symmetry():
    part = PARTS["peg"]()
    turned = make_transform(rotation_about([0, 0, 1], np.radians(92)), [1e-3, 0, -2e-3])
    errors = measure_errors(Started(np.eye(4), turned), part)
    assert errors == pytest.approx({"tip_mm": 1.0, "z_mm": -2.0, "tilt_deg": 0.0, "yaw_deg": 2.0}, abs=1e-3)
    assert measure_errors(None, part) == {}


@pytest.mark.slow
def test_a_trial_runs_all_methods_and_repeats_itself(experiment):
    trial = BY_PART["bolt"]
    records = experiment.run(trial)
    again = experiment.run(trial)
    assert records == again
    by_method = {record.method: record for record in records}
    assert by_method["known"].success
    assert by_method["first touch"].touches == 2
    assert by_method["known"].touches == by_method["spiral"].touches == by_method["nominal"].touches == 0
    assert by_method["verdict"].verdicts[-1] in ("certain", "ambiguous") or not by_method["verdict"].success
