"""Distances of surfaces between poses, against values known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.evaluation.metrics import compute_surface_distances


@pytest.fixture(scope="module")
def true_pose():
    return make_transform(rotation_about([1, 2, 3], 0.7), [0.01, 0.02, 0.03])


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
