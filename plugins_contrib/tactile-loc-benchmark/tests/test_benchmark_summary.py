"""Summaries: shares and intervals agree with what is known analytically."""

import numpy as np
import pytest

from tactile_loc_benchmark.job import METRICS
from tactile_loc_benchmark.summary import bootstrap, summarise


def make_row(example=0, error_mm=0.1, **changes):
    errors = {f"{prefix}{name}_mm": error_mm for prefix in ("", "listed_") for name in METRICS}
    names = {"source": "s", "object": "o", "method": "m", "problem": "", "verdict": ""}
    numbers = {"example": example, "touches": 1, "refused": 0, "seconds": 0.5, "diameter_m": 0.04}
    return {**names, **numbers, "determined": True, **errors, **changes}


def shift_mean(values):
    return values.mean(axis=0)


def test_the_interval_of_a_share_is_that_of_the_binomial_distribution():
    share, count = 0.3, 400
    values = (np.arange(count) < share * count).astype(float)[:, None]
    ((low, high),) = bootstrap(values, np.full(count, "a"), shift_mean)
    half = 1.96 * np.sqrt(share * (1 - share) / count)
    assert low == pytest.approx(share - half, abs=0.006)
    assert high == pytest.approx(share + half, abs=0.006)


def test_examples_are_drawn_again_within_each_object_in_the_same_order():
    objects = np.repeat(["easy", "hard"], 50)
    values = (objects == "easy").astype(float)[:, None]
    assert bootstrap(values, objects, shift_mean) == ((0.5, 0.5),)
    values = np.random.default_rng(0).random((30, 2))
    assert bootstrap(values, np.full(30, "a"), shift_mean) == bootstrap(values, np.full(30, "a"), shift_mean)


def test_shares_count_examples_without_a_pose_as_missed():
    bare = {key: value for key, value in make_row(3, problem="no pose").items() if not key.endswith("_mm")}
    (group,) = summarise([make_row(0, 0.1), make_row(1, 0.7), make_row(2, 3.0), bare])
    assert group["within"] == (0.25, 0.5, 0.5, 0.75)
    assert (group["examples"], group["unlocated"]) == (4, 1)
    assert group["median_m"] == pytest.approx((0.7e-3 + 3.0e-3) / 2)
    assert (group["determined"], group["determined_within_1_mm"]) == (4, 0.5)
    assert (group["calibration_error"], group["covered"], group["certain"]) == (None, None, 0)


def test_a_small_shape_distance_makes_no_pose_right():
    (group,) = summarise([make_row(mssd_mm=2.0, verdict="certain"), make_row(1, verdict="certain")])
    assert (group["within"][1], group["certain_right"], group["shape_within_1_mm"]) == (0.5, 1, 1.0)


def test_an_example_is_determined_unless_a_method_finds_another_explanation():
    rows = [make_row(), make_row(method="other", determined=False), make_row(1)]
    first, _ = summarise(rows)
    assert (first["examples"], first["determined"]) == (2, 1)


def test_refused_presses_are_counted_once_for_each_example():
    rows = [make_row(0, refused=2), make_row(0, touches=3, refused=2), make_row(1, refused=1)]
    assert [group["refused"] for group in summarise(rows)] == [3, 2]


def test_probabilities_and_certain_poses_are_compared_with_the_share_of_right_poses():
    rows = [make_row(k, 0.1 if k < 6 else 9.0, probability=0.9, covered=k < 8) for k in range(10)]
    (group,) = summarise(rows)
    assert group["calibration_error"] == pytest.approx(0.3)
    assert group["covered"] == pytest.approx(0.8)
    (group,) = summarise([make_row(0, verdict="certain"), make_row(1, 9.0, verdict="certain"), make_row(2)])
    assert (group["certain"], group["certain_right"]) == (2, 1)
