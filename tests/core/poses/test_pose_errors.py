"""Pose errors, ADD and ADD-S, against values known by hand, and against all sampled symmetries."""

import numpy as np
import pytest
import trimesh
from pose_helpers import random_poses

from tactile_loc import ObjectModel
from tactile_loc.core.poses.pose_errors import PRECISION_M, compute_adds, measure_pose_errors
from tactile_loc.plugin.helpers import SymmetryGroup, make_transform, make_translation, rotation_about, transform_points

SYMMETRIES = ["none", "z4", "x2*y2", "zinf", "zinf*x2", "axis(1,2,3)inf"]
STEP_RAD = 2 * np.pi / 2000


def turn(axis, angle_rad):
    return make_transform(rotation_about(axis, angle_rad), np.zeros(3))


def declare(obj, symmetry, z_m=0.002):
    """The same surface with another symmetry, whose centre is not that of the surface."""
    return ObjectModel(obj.name, obj.mesh, SymmetryGroup.parse(symmetry, [0, 0, z_m]))


def draw_near(T, spread, count=4):
    """Return poses (K, 4, 4) away from a pose and its rolls: far away with a spread of 1."""
    rng = np.random.default_rng(2)
    angles_rad, shifts_m = spread * rng.uniform(0, 3, count), spread * rng.normal(0, 0.01, (count, 3))
    return T @ make_transform(rotation_about([1, 5, 2], angles_rad), shifts_m) @ turn([0, 0, 1], 2.0)


@pytest.fixture(scope="module")
def true_pose():
    return make_transform(rotation_about([1, 2, 3], 0.7), [0.01, 0.02, 0.03])


@pytest.fixture(scope="module")
def points_m(box):
    return box.mesh.sample(10_000, np.random.default_rng(0))


def test_the_pose_error_of_a_turned_box_is_the_chord_of_its_corners(box, true_pose, make_object):
    turned = true_pose @ turn([0, 0, 1], np.pi / 2)  # 30 x 20 mm across: the chord of a right angle
    assert measure_pose_errors(box, turned[None], true_pose) == pytest.approx(np.sqrt(2) * np.hypot(0.015, 0.010))
    tip_m = np.array([[0.1, 0.0, 0.0]])
    assert measure_pose_errors(box, turned[None], true_pose, tip_m) == pytest.approx(0.1 * np.sqrt(2))
    assert len(box.mesh.hull_corners_m) == 8
    square = trimesh.Trimesh([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0]], [[0, 1, 2], [0, 2, 3]])
    assert len(make_object(square).mesh.hull_corners_m) == 4, "a flat surface keeps its vertices"


def test_no_surface_point_moves_farther_than_the_corners_of_the_hull(cylinder, true_pose):
    plain, poses = declare(cylinder, "none"), draw_near(true_pose, 1.0, 6)
    samples_m = cylinder.mesh.sample(20_000, np.random.default_rng(1))
    everywhere, largest = (measure_pose_errors(plain, poses, true_pose, some) for some in (samples_m, None))
    assert (largest >= everywhere - 1e-12).all()
    assert largest == pytest.approx(everywhere, rel=0.02)


@pytest.mark.parametrize("spread", [1.0, 0.05])
@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_errors_are_the_least_over_all_symmetric_poses(cylinder, true_pose, symmetry, spread):
    """Poses far from and near to the truth. The object need not look symmetric."""
    obj, poses = declare(cylinder, symmetry), draw_near(true_pose, spread)
    points_m, corners_m = cylinder.mesh.sample(200, np.random.default_rng(2)), cylinder.mesh.hull_corners_m
    same, slack = true_pose @ obj.symmetry.list_elements(STEP_RAD), 0.0
    if obj.symmetry.continuous_axis is not None:
        slack = 0.04 * STEP_RAD  # the outermost corner moves by less in half a step

    def displace(some_m):
        return np.linalg.norm(transform_points(poses, some_m)[:, None] - transform_points(same, some_m), axis=-1)

    expected_m = displace(corners_m).max(axis=-1).min(axis=1)
    found_m = measure_pose_errors(obj, poses, true_pose)
    assert (found_m <= expected_m + 1.1 * PRECISION_M).all()
    assert (found_m >= expected_m - slack - 1e-12).all()
    means_m = displace(points_m).mean(axis=-1).min(axis=1)
    assert compute_adds(obj, points_m, poses, true_pose) == pytest.approx(means_m, abs=3e-7)


@pytest.mark.parametrize("symmetry", ["none", "z4", "x2*y2", "zinf", "zinf*x2", "sphere"])
def test_pose_errors_ignore_symmetric_turns_common_motions_and_the_order(cylinder, symmetry):
    obj, T, others, motion = declare(cylinder, symmetry, 0), random_poses(5, 1), random_poses(5, 2), random_poses(1, 3)
    expected_m = measure_pose_errors(obj, T, others)
    assert measure_pose_errors(obj, motion @ T, motion @ others) == pytest.approx(expected_m, abs=2e-7)
    assert measure_pose_errors(obj, others, T) == pytest.approx(expected_m, abs=2e-5), "64 sides are almost round"
    for S in obj.symmetry.list_elements(np.pi / 4)[:4]:  # the cylinder has 64 sides
        assert measure_pose_errors(obj, T @ S, others) == pytest.approx(expected_m, abs=2e-7)
        assert measure_pose_errors(obj, T, T @ S) == pytest.approx(0, abs=2e-7)


@pytest.mark.parametrize("symmetry", [*SYMMETRIES, "sphere"])
@pytest.mark.parametrize("limit_m", [2e-4, 1e-3])
def test_with_a_limit_errors_are_on_the_same_side_of_it(cylinder, true_pose, symmetry, limit_m):
    obj = declare(cylinder, symmetry)
    near = [draw_near(true_pose @ S, 0.3 ** (2 + k)) for k in range(4) for S in obj.symmetry.list_elements(0.3)[:12]]
    poses = np.concatenate(near) @ turn([0, 0, 1], -2.0)
    exact_m, quick_m = (measure_pose_errors(obj, poses, true_pose, limit_m=most_m) for most_m in (0.0, limit_m))
    clear = np.abs(exact_m - limit_m) > 2 * PRECISION_M
    assert np.array_equal((quick_m <= limit_m)[clear], (exact_m <= limit_m)[clear])
    assert 0 < (exact_m <= limit_m).sum() < len(poses)


def test_only_the_centre_of_a_sphere_counts(make_object, true_pose):
    ball = make_object(trimesh.creation.icosphere(3, 0.01).apply_translation([0.03, 0, 0]), "sphere")
    about_centre = make_translation([0.03, 0, 0]) @ turn([1, 2, 3], 2.0) @ make_translation([-0.03, 0, 0])
    poses = np.stack([true_pose @ about_centre, make_translation([0, 0.003, 0.004]) @ true_pose @ about_centre])
    points_m = ball.mesh.sample(200, np.random.default_rng(0))
    assert compute_adds(ball, points_m, poses, true_pose) == pytest.approx([0, 0.005], abs=1e-8)
    assert measure_pose_errors(ball, poses, true_pose) == pytest.approx([0, 0.005], abs=1e-8)


def test_add_is_at_most_the_pose_error(box, points_m, true_pose):
    poses = draw_near(true_pose, 1.0, 20)
    mean = compute_adds(box, points_m, poses, true_pose)
    assert (mean <= measure_pose_errors(box, poses, true_pose) + 1e-12).all()
