"""Recall, averages, verdicts and reliability, against values counted by hand."""

import numpy as np
import pytest

from tactile_loc.evaluation.metrics import METRICS, PoseJudge
from tactile_loc.evaluation.summary import ExampleSummary, compute_wilson_range
from tactile_loc.evaluation.table import ExampleTable

DIAMETER_M = 0.1


def make_table(first_mm, listed_mm=None, probability=0.5, verdict="ambiguous", shape_mm=None) -> ExampleTable:
    listed_mm = first_mm if listed_mm is None else listed_mm
    errors = {
        f"{line} {metric}_m": 1e-3 * np.array(shape_mm if shape_mm and metric == "shape" else errors_mm, float)
        for line, errors_mm in (("first", first_mm), ("listed", listed_mm))
        for metric in METRICS
    }
    others = {"problem": "", "determined": True, "seconds": 1.0, "diameter_m": DIAMETER_M}
    return ExampleTable.make(errors, probability=probability, verdict=verdict, **others)


def test_recall_counts_examples_without_a_pose_as_missed():
    s = ExampleSummary.of(make_table([0.1, 0.7, 3.0, np.inf], [0.1, 0.2, 0.3, np.inf]))
    assert s.within == (0.25, 0.5, 0.75)
    assert s.listed_within == (0.75, 0.75, 0.75)


def test_the_area_under_the_curve_is_the_mean_recall_from_a_tenth_to_five_millimetres():
    assert ExampleSummary.of(make_table([0.0])).auc == 1
    assert ExampleSummary.of(make_table([2.45])).auc == pytest.approx(26 / 50)  # 2.5, 2.6, ... 5.0 mm
    assert ExampleSummary.of(make_table([6.0, np.inf])).auc == 0


def test_the_average_recall_of_mssd_has_ten_thresholds_of_the_diameter():
    s = ExampleSummary.of(make_table([4.9, 12, 60]))
    assert s.average_recall_mssd == pytest.approx((10 + 8 + 0) / 30)


def test_verdicts_are_counted_and_certain_ones_are_judged_within_a_millimetre():
    s = ExampleSummary.of(make_table([0.1, 0.9, 1.1, 0.2], verdict=["certain", "certain", "certain", "poor fit"]))
    assert {verdict: n for verdict, n in s.verdicts.items() if n} == {"certain": 3, "poor fit": 1}
    assert s.certain_right == pytest.approx(2 / 3)
    assert s.determined_certain == pytest.approx(3 / 4)


def test_a_small_shape_distance_makes_no_pose_right():
    s = ExampleSummary.of(make_table([2.0, 0.5], shape_mm=[0.1, 0.1], verdict="certain"))
    assert (s.within[1], s.certain_right, s.shape_within_1_mm) == (0.5, 0.5, 1.0)


def test_a_pose_at_the_threshold_is_within_it():
    s = ExampleSummary.of(make_table([1.0], verdict="certain"))
    assert (s.within[1], s.certain_right) == (1.0, 1.0)


def test_without_certain_examples_there_is_no_reliability():
    s = ExampleSummary.of(make_table([np.inf]))
    assert (s.certain_right, s.certain_right_range, s.median_m) == (None, None, None)


def test_probabilities_are_binned_with_their_share_of_right_poses():
    s = ExampleSummary.of(make_table([0.1, 5, 0.1, 5, 5], probability=[0.85, 0.95, 1.0, 0.1, np.nan]))
    last = s.bins[-1]
    assert (last.examples, last.right) == (3, pytest.approx(2 / 3))
    assert last.stated == pytest.approx((0.85 + 0.95 + 1.0) / 3)
    assert (s.bins[0].examples, s.bins[0].right, s.bins[1].stated) == (1, 0, None)
    assert sum(b.examples for b in s.bins) == 4


def test_the_confidence_interval_holds_the_share_and_narrows_with_more_trials():
    low, high = compute_wilson_range(9, 10)
    assert (low, high) == (
        pytest.approx(0.5958, abs=1e-3),
        pytest.approx(0.9821, abs=1e-3),
    )  # Wilson's published values
    assert compute_wilson_range(90, 100)[0] > low
    assert compute_wilson_range(10, 10)[1] == 1


def test_the_diameter_of_a_box_is_its_diagonal(box):
    assert PoseJudge(box).diameter_m == pytest.approx(float(np.linalg.norm(box.mesh.extents_m)))
