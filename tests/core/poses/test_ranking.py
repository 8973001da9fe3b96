"""Orders of values and poses do not depend on rounding."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.ranking import TIE_NATS, group_ties, rank_poses
from tactile_loc.testing.problems import make_block

METRIC = PoseMetric(make_block())


def draw_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    R = np.stack([rotation_about(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(count)])
    return make_transform(R, rng.normal(scale=0.01, size=(count, 3)))


def test_a_group_has_the_values_within_the_tie_of_its_greatest():
    worth = np.array([0.5, 1.0, 0.95, 0.87, -np.inf, 0.79, -np.inf])
    assert group_ties(worth, 0.1).tolist() == [2, 0, 0, 1, 3, 1, 3]
    assert group_ties(np.full(3, -np.inf), 0.1).tolist() == [0, 0, 0]
    assert group_ties(np.zeros(0), 0.1).tolist() == []


def test_equal_poses_have_one_order_however_they_are_given():
    rng = np.random.default_rng(4)
    poses, worth = draw_poses(8, rng), np.repeat([0.0, 1.0], 4)
    expected = poses[rank_poses(group_ties(worth, TIE_NATS), poses, METRIC)]
    assert sorted(rank_poses(group_ties(worth, TIE_NATS), poses, METRIC)[:4]) == [4, 5, 6, 7]
    for _ in range(5):
        order = rng.permutation(8)
        noisy = worth[order] + rng.uniform(-1, 1, 8) * TIE_NATS / 3
        assert np.array_equal(poses[order][rank_poses(group_ties(noisy, TIE_NATS), poses[order], METRIC)], expected)


def test_the_likeliest_pose_is_one_of_the_greatest_probability():
    rng = np.random.default_rng(5)
    poses = draw_poses(5, rng)
    log_p = np.array([-3.0, -1.0, -1.0, -2.0, -1.0])
    found = []
    for _ in range(5):
        order = rng.permutation(5)
        noisy = log_p[order] + rng.uniform(-1, 1, 5) * 1e-6
        found.append(order[PosePosterior(PoseGrid(poses[order], METRIC), noisy).find_likeliest()])
    assert set(found) < {1, 2, 4}
    assert len(set(found)) == 1
