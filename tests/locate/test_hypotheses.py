"""Hypotheses that refinement brings together are merged."""

import numpy as np
import pytest

from tactile_loc import ContactShape, ObjectModel, PoseGrid, PoseMetric, Touch
from tactile_loc.core.poses.posterior import TIE_NATS, Mode, PosePosterior
from tactile_loc.core.sensing.scene import NATS_PER_IOU, compare_where_seen
from tactile_loc.locate.hypotheses import (
    assign_probabilities,
    choose_best_apart,
    compare,
    compute_nats,
    merge_hypotheses,
    split_modes,
    weigh,
)
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.plugin import RefinedPose, View
from tactile_loc.plugin.helpers import SymmetryGroup, make_translation, rotation_about
from tactile_loc.testing.problems import make_box


def hypothesis(probability: float, T: np.ndarray, converged: bool = True, imprint_iou: float = 1.0) -> Hypothesis:
    return Hypothesis(
        probability, T, RefinedPose(T, 1.0, converged, 3), grid_index=0, grid_poses=5, imprint_iou=imprint_iou
    )


@pytest.fixture
def metric() -> PoseMetric:
    mesh = make_box((-0.01, -0.005, -0.002), (0.01, 0.005, 0.002))
    return PoseMetric(ObjectModel("box", mesh, SymmetryGroup.parse("z2", np.zeros(3))))


def test_candidates_that_end_at_the_same_pose_or_at_an_equal_one_by_symmetry_are_merged(metric):
    near, far = make_translation([2e-4, 0, 0]), make_translation([2e-3, 0, 0])
    found = merge_hypotheses([hypothesis(p, T) for p, T in ((0.5, np.eye(4)), (0.3, far), (0.2, near))], metric, 5e-4)
    merged = [h.probability for h in found]
    assert merged == pytest.approx([0.625, 0.375])  # the ratio is 5 to 3, and the sum is unchanged
    assert [h.grid_poses for h in found] == [10, 5]
    np.testing.assert_array_equal(found[0].refined.T_sensor_object, np.eye(4))
    turned = np.eye(4)
    turned[:3, :3] = rotation_about([0, 0, 1], np.pi)
    assert len(merge_hypotheses([hypothesis(0.6, np.eye(4)), hypothesis(0.4, turned)], metric, 5e-4)) == 1


def test_an_unconverged_pose_is_merged_only_with_an_almost_equal_pose(metric):
    for off_m, left in ((0.0, 1), (2e-5, 1), (1e-4, 2)):
        stuck = hypothesis(0.4, make_translation([off_m, 0, 0]), converged=False)
        assert len(merge_hypotheses([hypothesis(0.6, np.eye(4)), stuck], metric, 5e-4)) == left


def test_split_modes_keep_the_peaks_and_share_all_members(metric):
    grid = PoseGrid(make_translation(np.column_stack([np.arange(12) * 1e-3, *np.zeros((2, 12))])), metric)
    posterior = PosePosterior(grid, np.log([0.3, 0.1, 0.05, 0.05, 0.02, 0.01, 0.2, 0.1, 0.05, 0.05, 0.04, 0.03]))
    modes = posterior.modes(1.5e-3, 2, mass=1.0)
    assert [mode.index for mode in modes] == [0, 6]
    split = split_modes(posterior, modes, 1.5e-3, 4)
    assert [mode.index for mode in split[:2]] == [0, 6]
    assert len(split) == 4
    assert np.sort(np.concatenate([mode.members for mode in split])).tolist() == list(range(12))
    assert sum(mode.probability for mode in split) == pytest.approx(1)
    assert [mode.index for mode in split_modes(posterior, modes, 1.5e-3, 2)] == [0, 6]


def test_the_pose_that_explains_the_touch_best_comes_first(metric):
    three = [hypothesis(p, np.eye(4), imprint_iou=e) for p, e in ((0.6, 0.7), (0.3, 0.9), (0.1, 0.8))]
    found = assign_probabilities(three, np.array([-2.0, 1.0, 0.5]), metric)
    assert [h.imprint_iou for h in found] == [0.9, 0.8, 0.7]
    p = np.array([h.probability for h in found])
    assert p.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.log(p[:-1] / p[1:]), [0.5, 2.5])
    alike = assign_probabilities([hypothesis(p, np.eye(4)) for p in (0.6, 0.3)], np.zeros(2), metric)
    assert [h.probability for h in alike] == pytest.approx([0.45, 0.45])


def test_rounding_changes_neither_the_order_nor_the_probabilities_of_equal_poses(metric):
    rng = np.random.default_rng(0)
    poses = make_translation(rng.normal(scale=0.01, size=(6, 3)))
    nats = np.array([0.0, 0.0, 0.0, -1.0, -1.0, -3.0])
    listed = []
    for order in (np.arange(6), rng.permutation(6)):
        some = [hypothesis(1 / 6, poses[k]) for k in order]
        listed.append(assign_probabilities(some, nats[order] + rng.uniform(-1, 1, 6) * TIE_NATS / 3, metric))
    first, second = (np.stack([h.T_sensor_object for h in found]) for found in listed)
    assert np.array_equal(first, second)
    for found in listed:
        p = [h.probability for h in found]
        assert p == sorted(p, reverse=True)
        assert p[0] == p[1] == p[2] > p[3] == p[4] > p[5]


def test_no_pose_comes_before_a_pose_that_explains_the_touches_better(make_box, make_scene, flat_camera, metric):
    """The wide pose has more contact in common with the touch, but most of its imprint is elsewhere."""
    scene = make_scene(make_box(0.012, 0.008, 0.006), flat_camera)
    left = scene.press(1e-3).bring_to_contact(make_translation([-0.008, 0, 0])[None])[0][0]
    depth_m = scene.contact_shape(left, 1e-3).depth_m.copy()
    depth_m[:, flat_camera.width_px // 6 :] = 1e-3
    touch = Touch(ContactShape(depth_m, 1e-3), flat_camera)
    views = [View(touch, scene.match_touch(touch)) for _ in range(5)]
    poses = np.stack([left, make_translation([-0.0078, 0, 0]) @ left])
    refined = [(Mode(k, 0.5, T, np.array([k])), RefinedPose(T, 1.0, True, 0)) for k, T in enumerate(poses)]
    found = weigh(compare(views, refined), len(views), metric)
    assert found[0].imprint_iou > found[1].imprint_iou + 0.05
    assert found[0].probability > found[1].probability
    evidence = views[0].compare_imprints(poses).evidence
    assert evidence[0] > evidence[1]


def test_small_differences_count_more_if_little_is_unexplained():
    for touches in (1, 3):
        clean, noisy = (compute_nats(np.array([iou, iou - 0.02]), touches) for iou in (0.99, 0.4))
        assert clean[0] - clean[1] > 5 * (noisy[0] - noisy[1]) > 0


def test_a_strong_prior_outweighs_a_better_explanation(metric):
    two, evidence = [hypothesis(0.5, np.eye(4), imprint_iou=e) for e in (0.8, 0.9)], np.array([0.0, 3.0])
    assert assign_probabilities(two, evidence, metric, np.array([0.0, -2.7]))[0].imprint_iou == 0.9
    assert assign_probabilities(two, evidence, metric, np.array([0.0, -3.3]))[0].imprint_iou == 0.8
    assert assign_probabilities(two, evidence, metric, np.array([0.0, -np.inf]))[0].imprint_iou == 0.8


def test_a_touch_is_compared_at_other_sensor_poses_at_a_cost(make_box, make_scene, flat_camera):
    scene = make_scene(make_box(0.012, 0.008, 0.006), flat_camera)
    true = scene.press(1e-3).bring_to_contact(np.eye(4)[None])[0]
    touch = Touch(scene.contact_shape(true[0], 1e-3), flat_camera)
    beside = make_translation([1e-3, 0, 0]) @ true  # the object's pose for the reported sensor pose
    nominal, exact = (scene.match_touch(touch).compare_imprints(T, touch) for T in (beside, true))
    for std_m, first_m in ((1e-3, 0.0), (0.5e-3, 0.0), (0.1e-3, 0.0), (0.6e-3, 0.8e-3)):
        first, view = (View(touch, scene.match_touch(touch), np.eye(4), m, 0.01) for m in (first_m, std_m))
        seen = np.stack([beside, true], axis=1)
        ious, evidence = (found[:, 1] for found in compare_where_seen([first, view], beside, seen))
        costs = 1e-6 / (std_m**2 + first_m**2) / 2
        there = exact.imprint_ious[0] - costs / NATS_PER_IOU
        assert ious == pytest.approx(max(nominal.imprint_ious[0], there), abs=1e-9)
        assert evidence == pytest.approx(max(nominal.evidence[0], exact.evidence[0] - costs), abs=1e-6)
        for same in (compare_where_seen([view], beside, beside[:, None]), compare_where_seen([view], beside)):
            np.testing.assert_allclose(same, [[nominal.imprint_ious], [nominal.evidence]])
    assert nominal.imprint_ious < exact.imprint_ious
    assert nominal.evidence < exact.evidence


def test_distant_modes_contain_the_poses_beside_them(metric):
    """Five poses along a line give two modes; poses between the more probable mode and the limit are its members."""
    poses = np.concatenate([make_translation([x, 0, 0])[None] for x in (0.0, 0.4e-3, 0.9e-3, 3e-3, 3.2e-3)])
    p = np.array([0.4, 0.2, 0.1, 0.25, 0.05])
    first, second = choose_best_apart(PosePosterior(PoseGrid(poses, metric), np.log(p)), 0.5e-3, 2)
    assert (first.index, second.index) == (0, 3)
    assert (first.members.tolist(), second.members.tolist()) == ([0, 1], [3, 4])
    assert (first.probability, second.probability) == pytest.approx((0.6, 0.3))
