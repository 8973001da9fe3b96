"""Modes merge with the most probable mode nearby, symmetric poses included."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_translation, rotation_about
from tactile_loc.core.poses.merging import merge_modes
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
