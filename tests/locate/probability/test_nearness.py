"""The probability that the first pose is within a tolerance, from the hypotheses and their covariances."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.stats import norm

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about, rotation_angle
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.io.options import CERTAIN
from tactile_loc.locate.probability.nearness import Nearness, calibrate, compute_share_within, draw_poses

EXACT = np.zeros((6, 6))


def share(box, poses, p, covariances, text="1mm"):
    return compute_share_within(np.stack(poses), np.array(p), covariances, box, Tolerance.parse(text))


def test_exact_poses_count_with_their_probability_if_they_are_near_the_first(make_box):
    box = make_box(0.04, 0.03, 0.02)
    near, far = make_translation([[2e-4, 0, 0], [0, 0, 0.02]])
    assert share(box, [np.eye(4), near, far], [0.5, 0.2, 0.2], [EXACT] * 3) == pytest.approx(0.7)


def test_poses_equal_by_symmetry_add_up(make_box):
    box = make_box(0.04, 0.03, 0.02, symmetry="z2")
    half_turn = make_transform(rotation_about([0, 0, 1], math.pi), np.zeros(3))
    assert share(box, [np.eye(4), half_turn], [0.5, 0.4], [EXACT] * 2, "0.1mm,0.1deg") == pytest.approx(0.9)


@pytest.mark.parametrize("std_deg", [1.0, 3.0])
def test_a_rotation_is_within_the_tolerance_as_often_as_its_covariance_says(make_box, std_deg):
    turned = np.diag([0, 0, 0, 0, 0, math.radians(std_deg) ** 2])
    expected = 2 * norm.cdf(2 / std_deg) - 1
    assert share(make_box(0.04, 0.03, 0.02), [np.eye(4)], [1.0], [turned], "2deg") == pytest.approx(expected, abs=0.03)


def test_a_wider_tolerance_is_never_less_probable(make_box):
    box, spread = make_box(0.04, 0.03, 0.02), np.diag([1e-3**2] * 3 + [0.05**2] * 3)
    shares = [share(box, [np.eye(4)], [0.9], [spread], f"{mm}mm") for mm in (0.2, 0.5, 1, 2, 5)]
    assert shares == sorted(shares)
    assert shares[0] < 0.3 < shares[-1]


def test_drawn_poses_have_the_covariance_and_are_the_same_each_time():
    T = make_transform(rotation_about([1, 2, 3], 0.7), np.array([0.1, 0.2, 0.3]))
    std = np.array([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03])
    drawn = draw_poses(T, np.diag(std**2))
    assert np.array_equal(drawn, draw_poses(T, np.diag(std**2)))
    assert drawn[:, :3, 3].mean(axis=0) == pytest.approx(T[:3, 3])
    assert drawn[:, :3, 3].std(axis=0) == pytest.approx(std[:3], rel=0.05)
    turns = rotation_angle(drawn[:, :3, :3] @ T[:3, :3].T)
    assert np.sqrt((turns**2).mean()) == pytest.approx(np.linalg.norm(std[3:]), rel=0.05)


def test_the_fitted_probability_increases_with_the_share_and_the_gap_and_decreases_with_elsewhere():
    fitted = [calibrate(Nearness(share, 0.5, 0.1)) for share in np.linspace(0, 0.5, 11)]
    assert all(0 < low < high < 1 for low, high in itertools.pairwise(fitted))
    assert fitted[0] < 0.3 < 0.7 < fitted[-1]
    missed = [calibrate(Nearness(0.5 * (1 - elsewhere), elsewhere, 0.1)) for elsewhere in (0.0, 0.5, 0.9, 0.99)]
    assert missed == sorted(missed, reverse=True)
    apart = [calibrate(Nearness(0.2, 0.2, gap)) for gap in (0.0, 0.01, 0.1, 0.5)]
    assert apart == sorted(apart)
    assert apart[0] < 0.4 < 0.6 < apart[-1]
    assert calibrate(Nearness(1.0, 0.0, 0.5)) > 0.99


def test_a_pose_that_the_touches_do_not_determine_is_never_certain():
    assert calibrate(Nearness(0.999, 0.01, 0.9, True)) < CERTAIN < calibrate(Nearness(0.999, 0.01, 0.9))
    shares = np.linspace(0, 1, 21)
    undetermined = [calibrate(Nearness(share, 0.1, 0.01, True)) for share in shares]
    assert (np.diff(undetermined) >= 0).all()
    determined = [calibrate(Nearness(share, 0.1, 0.01)) for share in shares]
    assert all(p <= other for p, other in zip(undetermined, determined, strict=True))
