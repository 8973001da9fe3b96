"""Distances between poses, against values known by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.pose_errors import compute_add_s, compute_adds, compute_mssd
from tactile_loc.evaluation.metrics import compute_surface_distances

SHIFT_M = np.array([0.003, -0.004, 0.012])
LENGTH_M = 0.013


def turn(axis, angle_rad):
    return make_transform(rotation_about(axis, angle_rad), np.zeros(3))


@pytest.fixture(scope="module")
def true_pose():
    return make_transform(rotation_about([1, 2, 3], 0.7), [0.01, 0.02, 0.03])


@pytest.fixture(scope="module")
def points_m(box):
    return box.mesh.sample(10_000, np.random.default_rng(0))


def test_a_shift_moves_every_point_by_its_length(box, points_m, true_pose):
    shifted = make_translation(SHIFT_M) @ true_pose
    moved_m = np.linalg.norm(transform_points(shifted, points_m) - transform_points(true_pose, points_m), axis=-1)
    assert moved_m.mean() == pytest.approx(LENGTH_M)
    assert compute_adds(box, points_m, shifted[None], true_pose) == pytest.approx(LENGTH_M)
    assert compute_mssd(box, box.mesh.hull_corners_m, shifted[None], true_pose) == pytest.approx(LENGTH_M)
    assert compute_add_s(points_m, shifted[None], true_pose)[0] < LENGTH_M


def test_the_largest_distance_of_a_rotated_box_is_at_its_eight_corners(box, true_pose, make_object):
    turned = true_pose @ turn([0, 0, 1], np.pi / 2)  # 30 x 20 mm across: the chord of a right angle
    expected_m = np.sqrt(2) * np.hypot(0.015, 0.010)
    assert compute_mssd(box, box.mesh.hull_corners_m, turned[None], true_pose) == pytest.approx(expected_m)
    assert len(box.mesh.hull_corners_m) == 8
    square = trimesh.Trimesh([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0]], [[0, 1, 2], [0, 2, 3]])
    assert len(make_object(square).mesh.hull_corners_m) == 4, "a flat surface keeps its vertices"


def test_the_largest_distance_is_at_the_hull(cylinder, true_pose):
    rng = np.random.default_rng(1)
    poses = make_transform(rotation_about([3, 1, 2], rng.uniform(0, 3, 6)), rng.normal(0, 0.01, (6, 3)))
    plain = make_plain(cylinder)
    everywhere = compute_mssd(plain, cylinder.mesh.sample(20_000, rng), poses, true_pose)
    largest = compute_mssd(plain, cylinder.mesh.hull_corners_m, poses, true_pose)
    assert (largest >= everywhere - 1e-12).all()
    assert largest == pytest.approx(everywhere, rel=0.02)


def make_plain(obj):
    """The same object without its symmetry."""
    return ObjectModel(obj.name, obj.mesh, SymmetryGroup.parse("none", np.zeros(3)))


@pytest.mark.parametrize("symmetry", ["none", "x2*y2"])
def test_a_declared_symmetry_removes_the_error_of_an_equivalent_pose(make_box, true_pose, symmetry):
    obj = make_box(0.030, 0.020, 0.012, symmetry=symmetry)
    points_m = obj.mesh.sample(2000, np.random.default_rng(0))
    turned = (true_pose @ turn([1, 0, 0], np.pi))[None]
    errors = (
        compute_adds(obj, points_m, turned, true_pose)[0],
        compute_mssd(obj, obj.mesh.hull_corners_m, turned, true_pose)[0],
    )
    same = symmetry != "none"
    assert all((error < 1e-9) == same for error in errors)
    assert compute_add_s(points_m, turned, true_pose)[0] < 0.001  # ADD-S ignores it in either case


def test_only_the_centre_of_a_sphere_counts(make_object, true_pose):
    ball = make_object(trimesh.creation.icosphere(3, 0.01).apply_translation([0.03, 0, 0]), "sphere")
    about_centre = make_translation([0.03, 0, 0]) @ turn([1, 2, 3], 2.0) @ make_translation([-0.03, 0, 0])
    poses = np.stack([true_pose @ about_centre, make_translation([0, 0.003, 0.004]) @ true_pose @ about_centre])
    points_m = ball.mesh.sample(200, np.random.default_rng(0))
    assert compute_adds(ball, points_m, poses, true_pose) == pytest.approx([0, 0.005], abs=1e-8)
    assert compute_mssd(ball, ball.mesh.hull_corners_m, poses, true_pose) == pytest.approx([0, 0.005], abs=1e-8)


@pytest.mark.parametrize("spread", [1.0, 0.05])
@pytest.mark.parametrize("symmetry", ["zinf", "zinf*x2", "axis(1,2,3)inf"])
def test_the_best_roll_equals_the_best_of_two_thousand_sampled_rolls(cylinder, true_pose, symmetry, spread):
    """Poses far from and near to the truth, also of an object that is not round."""
    obj = ObjectModel("rolled", cylinder.mesh, SymmetryGroup.parse(symmetry, [0, 0, 0.002]))
    rng = np.random.default_rng(2)
    points_m, corners_m = cylinder.mesh.sample(200, rng), cylinder.mesh.hull_corners_m
    off = make_transform(rotation_about([1, 5, 2], spread * rng.uniform(0, 3, 4)), spread * rng.normal(0, 0.01, (4, 3)))
    poses, step_rad = true_pose @ off @ turn([0, 0, 1], 2.0), 2 * np.pi / 2000
    same = true_pose @ obj.symmetry.list_elements(step_rad)
    distances_m = [np.linalg.norm(corners_of(T, points_m) - corners_of(same, points_m), axis=-1) for T in poses]
    adds_m = compute_adds(obj, points_m, poses, true_pose)
    assert adds_m == pytest.approx([d.mean(axis=-1).min() for d in distances_m], abs=3e-7)
    largest_m = [np.linalg.norm(corners_of(T, corners_m) - corners_of(same, corners_m), axis=-1) for T in poses]
    sampled_m = np.array([d.max(axis=-1).min() for d in largest_m])
    found_m = compute_mssd(obj, corners_m, poses, true_pose)
    assert (found_m <= sampled_m + 1.1e-7).all()
    assert (found_m >= sampled_m - 0.04 * step_rad).all(), "the outermost corner moved more than half a step"


def corners_of(T, corners_m):
    return corners_m @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def test_add_s_is_the_mean_distance_to_the_nearest_point():
    points_m = np.array([[0.0, 0, 0], [0.010, 0, 0], [0.020, 0, 0]])
    slid = make_translation([0.010, 0, 0])[None]  # two points land on others; the first is 10 mm from the nearest
    assert compute_add_s(points_m, slid, np.eye(4)) == pytest.approx(0.010 / 3)
    assert compute_add_s(points_m, slid, np.eye(4), every=3) == pytest.approx(0.010)


def test_add_s_is_at_most_adds_and_adds_at_most_mssd(box, points_m, true_pose):
    rng = np.random.default_rng(3)
    poses = make_transform(rotation_about([1, 1, 0], rng.uniform(0, 3, 20)), rng.normal(0, 0.01, (20, 3))) @ true_pose
    mean = compute_adds(box, points_m, poses, true_pose)
    assert (compute_add_s(points_m, poses, true_pose) <= mean + 1e-12).all()
    assert (mean <= compute_mssd(box, box.mesh.hull_corners_m, poses, true_pose) + 1e-12).all()


def test_the_surface_distance_is_zero_for_the_true_pose_and_its_equivalents(cylinder, true_pose):
    rolled = true_pose @ cylinder.symmetry.list_elements(0.1)[7]
    assert compute_surface_distances(cylinder, np.stack([true_pose, rolled]), true_pose) == pytest.approx(0, abs=1e-7)


def test_the_surface_distance_of_a_small_shift_is_that_along_the_normals(box, true_pose):
    shifted = true_pose @ make_translation([1e-4, 0, 0])  # the faces across x move by 0.1 mm, the others slide
    areas = box.mesh.extents_m.prod() / box.mesh.extents_m
    expected_m = 1e-4 * areas[0] / areas.sum()
    assert compute_surface_distances(box, shifted[None], true_pose) == pytest.approx(expected_m, rel=0.1)


def test_the_surface_distance_of_a_far_pose_is_that_to_the_nearest_points(box, true_pose):
    far = make_translation([0, 0, 0.1]) @ true_pose
    few = box.mesh.sample(500, np.random.default_rng(1))
    moved = few + true_pose[:3, :3].T @ [0, 0, 0.1]
    dense = box.mesh.sample(40_000, np.random.default_rng(2))
    expected_m = np.mean([np.linalg.norm(dense - point, axis=1).min() for point in moved])
    assert compute_surface_distances(box, far[None], true_pose) == pytest.approx(expected_m, rel=0.01)
