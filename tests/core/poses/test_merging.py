"""Modes merge with the most probable mode nearby, symmetric poses included."""

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_translation, rotation_about
from tactile_loc.core.poses.merging import choose_apart, merge_modes
from tactile_loc.core.poses.metric import PoseMetric

ALONG_MM = np.array([0.0, 0.4, 5.0, 5.3, 0.2])


@pytest.fixture
def poses() -> np.ndarray:
    """Return poses along x, at ALONG_MM."""
    return make_translation(np.outer(1e-3 * ALONG_MM, [1.0, 0.0, 0.0]))


def test_poses_merge_with_the_most_probable_pose_within_their_radius(make_box, poses):
    metric = PoseMetric(make_box(0.02, 0.01, 0.005))
    np.testing.assert_array_equal(merge_modes(poses, metric, 0.5e-3), [0, 0, 2, 2, 0])
    np.testing.assert_array_equal(merge_modes(poses, metric, [1e-3, 1e-4, 1e-4, 1e-4, 1e-4]), [0, 1, 2, 3, 4])


def test_poses_beyond_the_maximum_count_merge_or_are_dropped(make_box, poses):
    metric = PoseMetric(make_box(0.02, 0.01, 0.005))
    np.testing.assert_array_equal(merge_modes(poses, metric, 0.5e-3, most=1), [0, 0, -1, -1, 0])
    assert merge_modes(poses[:0], metric, 1e-3).shape == (0,)


def test_symmetric_poses_merge(make_box):
    half_turn = np.eye(4)
    half_turn[:3, :3] = rotation_about([0.0, 0.0, 1.0], np.pi)
    both = np.stack([np.eye(4), half_turn])
    assert merge_modes(both, PoseMetric(make_box(0.02, 0.01, 0.005, symmetry="z2")), 1e-4).tolist() == [0, 0]
    assert merge_modes(both, PoseMetric(make_box(0.02, 0.01, 0.005, symmetry="none")), 1e-4).tolist() == [0, 1]


@pytest.mark.parametrize(("radius", "count"), [(0.2, 1000), (0.2, 5), (0.0, 1000), (9.0, 1000)])
def test_the_choice_equals_a_plain_search(radius, count):
    points = np.random.default_rng(3).uniform(size=(300, 3))
    expected: list[int] = []
    for k, point in enumerate(points):
        if len(expected) < count and all(np.linalg.norm(point - points[n]) > radius for n in expected):
            expected.append(k)
    assert choose_apart(points, radius, count).tolist() == expected


def test_equal_points_are_chosen_once_and_no_points_give_no_choice():
    assert choose_apart(np.zeros((4, 2)), 0.0, 9).tolist() == [0]
    assert choose_apart(np.zeros((0, 12)), 1.0, 5).tolist() == []
