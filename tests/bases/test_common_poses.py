"""The poses that touch all sensors, on a grid large enough that contacts are checked in another order."""

import numpy as np
import pytest
from message_helpers import missing

from tactile_loc.bases.common_poses import SAMPLE, find_common_poses
from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, make_translation
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import NoPoseLeft


@pytest.fixture(scope="module")
def grid(box) -> PoseGrid:
    x = np.stack(np.meshgrid(np.arange(12), np.arange(11), np.arange(5)), -1).reshape(-1, 3) * 0.002
    assert len(x) > 2 * SAMPLE
    return PoseGrid(make_translation(x), PoseMetric(box))


def sensors(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return list(make_transform(draw_rotations(count, rng), rng.normal(scale=0.1, size=(count, 3))))


def parts(grid: PoseGrid, T_base_sensor: list[np.ndarray], keeps: list[np.ndarray]) -> list[PoseGrid]:
    """Return one grid per sensor: the first grid, and shuffled copies of its poses that `keeps` marks."""
    made = [grid]
    for T, keep in zip(T_base_sensor[1:], keeps, strict=True):
        kept = np.random.default_rng(1).permutation(np.flatnonzero(keep))
        made.append(PoseGrid(invert(T) @ T_base_sensor[0] @ grid.T_sensor_object[kept], grid.metric))
    return made


def test_common_poses_are_the_intersection_of_all_grids(grid):
    x, y, z = (grid.T_sensor_object[:, k, 3] for k in range(3))
    keeps = [x > 0.003, y < 0.009, z + x < 0.02]
    T_base_sensor = sensors(4)
    grids = parts(grid, T_base_sensor, keeps)
    possible = x + y < 0.03
    found = find_common_poses(grids, T_base_sensor, 0.3, possible)
    assert np.array_equal(found[0], np.flatnonzero(np.all([possible, *keeps], axis=0)))
    for T, other, index in zip(T_base_sensor, grids, found, strict=True):
        seen = invert(T) @ T_base_sensor[0] @ grid.T_sensor_object[found[0]]
        np.testing.assert_allclose(other.T_sensor_object[index], seen, atol=1e-12)


def test_the_reason_names_the_contact_that_removes_the_last_pose(grid):
    x = grid.T_sensor_object[:, 0, 3]
    keeps = [x > 0.011, x > 0.003, x < 0.009]  # the second and fourth contact have no pose in common
    T_base_sensor = sensors(4)
    lefts = [int((x < 0.009).sum()), int((x > 0.011).sum())]  # the contact that keeps fewer poses is checked first
    contact, left = (2, lefts[0]) if lefts[0] < lefts[1] else (4, lefts[1])
    found = find_common_poses(parts(grid, T_base_sensor, keeps), T_base_sensor, 0.3, np.ones(len(grid), bool))
    assert isinstance(found, NoPoseLeft)
    assert not missing(found.reason, contact, left, 660)


def test_the_contact_that_removes_most_remaining_poses_is_checked_next(grid):
    """The fourth contact keeps more poses than the third, but none of the few that the second keeps."""
    x, y = (grid.T_sensor_object[:, k, 3] for k in range(2))
    keeps = [x > 0.017, y < 0.009, x < 0.017]
    assert keeps[0].sum() < keeps[1].sum() < keeps[2].sum()
    T_base_sensor = sensors(4)
    found = find_common_poses(parts(grid, T_base_sensor, keeps), T_base_sensor, 0.3, np.ones(len(grid), bool))
    assert isinstance(found, NoPoseLeft)
    assert not missing(found.reason, "touch 4", keeps[0].sum(), 660)
    assert not missing(found.name_touch(["a.npz", "b.npz", "c.npz", "d.npz"]).reason, "touch 4 (d.npz)", 660)


def test_no_possible_pose_gives_an_empty_result(grid):
    found = find_common_poses([grid, grid], sensors(2), 1.5, np.zeros(len(grid), bool))
    assert found.shape == (2, 0)
