"""The verdict: the order of its rules, its thresholds, and its value in a result and its file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.io.options import CERTAIN
from tactile_loc.locate.probability.nearness import MOST_UNDETERMINED
from tactile_loc.locate.probability.probabilities import MOST_ELSEWHERE
from tactile_loc.locate.result.localization import Agreement
from tactile_loc.locate.result.verdict import (
    CHECK_SENSOR_POSES,
    LEAST_IOU,
    MEANINGS,
    MOSTLY_ELSEWHERE,
    NEXT_STEPS,
    Verdict,
    judge,
    name_next_step,
)
from tactile_loc.planning.next_step import suggest_next_step


@pytest.mark.parametrize(
    ("probability", "imprint_iou", "elsewhere", "expected"),
    [
        (CERTAIN, 0.8, 0.1, Verdict.CERTAIN),
        (CERTAIN - 0.01, 0.8, 0.1, Verdict.AMBIGUOUS),
        (1.0, LEAST_IOU, 0.0, Verdict.CERTAIN),
        (1.0, LEAST_IOU - 0.01, 0.0, Verdict.POOR_FIT),
        (0.1, LEAST_IOU - 0.01, 0.8, Verdict.POOR_FIT),
        (0.4, 0.8, MOSTLY_ELSEWHERE, Verdict.AMBIGUOUS),
        (0.4, 0.8, MOSTLY_ELSEWHERE + 0.01, Verdict.NOT_FOUND),
        (None, np.nan, 0.0, Verdict.NOT_FOUND),
        (CERTAIN, np.nan, 0.0, Verdict.CERTAIN),
    ],
)
def test_the_first_matching_rule_gives_the_verdict(probability, imprint_iou, elsewhere, expected):
    assert judge(probability, imprint_iou, elsewhere) is expected
    assert judge(probability, imprint_iou, elsewhere, touched=False) is Verdict.NO_CONTACT
    assert judge(0.6, 0.3, certain=0.5, least_iou=0.25) is Verdict.CERTAIN, "the caller sets the thresholds"


def test_every_verdict_has_a_meaning():
    assert set(MEANINGS) == set(Verdict)
    assert {str(one) for one in Verdict} == {"certain", "ambiguous", "poor fit", "not found", "no contact"}


def changed(localization, **changes):
    """A localisation with another first hypothesis, and with no other hypothesis that explains the touch."""
    best = replace(localization.best, **changes)
    others = tuple(replace(h, imprint_iou=0.1) for h in localization.hypotheses[1:])
    return replace(localization, hypotheses=(best, *others), unlisted=())


def tolerate(localization, tolerance):
    return replace(localization, config=localization.config.model_copy(update={"tolerance": tolerance}))


def moved(localization):
    """The pose that a refiner found, slightly away from the grid pose."""
    T = localization.best.T_sensor_object_grid.copy()
    T[0, 3] += 1e-5
    return RefinedPose(T, 1.0, True, 1, covariance=1e-10 * np.eye(6))


def test_a_result_is_judged_by_its_first_hypothesis(localization):
    refined = moved(localization)
    one = changed(localization, probability=0.95, imprint_iou=0.8, refined=refined)
    assert one.verdict is Verdict.CERTAIN
    assert changed(one, probability=0.5).verdict is Verdict.AMBIGUOUS
    assert changed(one, imprint_iou=0.3).verdict is Verdict.POOR_FIT
    assert tolerate(one, Tolerance(1e-6)).verdict is Verdict.AMBIGUOUS
    elsewhere = changed(one, probability=0.05)
    elsewhere = replace(elsewhere, posterior=replace(one.posterior, elsewhere=0.7))
    assert elsewhere.verdict is Verdict.NOT_FOUND


def test_a_first_pose_with_a_rival_is_ambiguous_even_if_the_rival_is_not_listed(localization):
    one = changed(localization, probability=0.95, imprint_iou=0.8, refined=moved(localization))
    shift = np.eye(4)
    shift[0, 3] = 0.02
    rival = replace(
        one.best, probability=0.0, refined=replace(one.best.refined, T_sensor_object=shift @ one.best.T_sensor_object)
    )
    assert replace(one, unlisted=(rival,)).verdict is Verdict.AMBIGUOUS
    assert replace(one, unlisted=(replace(rival, imprint_iou=0.7),)).verdict is Verdict.CERTAIN
    assert replace(one, unlisted=(one.best,)).verdict is Verdict.CERTAIN
    unlikely = replace(one, unlisted=(replace(rival, prior_nats=-20.0),))
    assert unlikely.verdict is Verdict.CERTAIN, "the prior excludes the rival"
    assert replace(one, unlisted=(replace(rival, prior_nats=20.0),)).verdict is Verdict.AMBIGUOUS


@pytest.mark.parametrize(("std_m", "expected"), [(3e-4, Verdict.CERTAIN), (3e-3, Verdict.AMBIGUOUS)])
def test_a_first_pose_is_certain_only_if_its_covariance_leaves_no_larger_error_open(localization, std_m, expected):
    open_along_x = np.diag([std_m**2, *[1e-10] * 5])
    one = changed(localization, probability=1.0, refined=replace(moved(localization), covariance=open_along_x))
    assert one.verdict is expected


def test_the_summary_begins_with_the_verdict_and_names_the_first_pose(localization):
    one = changed(localization, probability=0.95, imprint_iou=0.8, refined=moved(localization))
    lines = one.summary().splitlines()
    assert lines[0] == f"certain: {MEANINGS[Verdict.CERTAIN]}"
    for value_m in one.best.T_sensor_object[:3, 3]:
        assert f"{1e3 * value_m:z.2f}" in lines[1]
    assert lines[2] == f"within 1 mm with at least {format_percent(CERTAIN)} probability, imprint IoU 80 %"
    assert str(one) == one.summary()
    assert not any(line.startswith("next: ") for line in lines)
    assert f"next: {NEXT_STEPS[Verdict.POOR_FIT]}" in changed(one, imprint_iou=0.3).summary().splitlines()
    assert str(replace(one, hypotheses=one.hypotheses[:1])).splitlines()[1].startswith("first of 1 pose: ")


def test_an_unrefined_pose_is_certain_only_within_a_tolerance_wider_than_the_grid(localization):
    grid_pose = RefinedPose(localization.best.T_sensor_object_grid, 1.0, True, 0)
    one = changed(localization, probability=0.95, imprint_iou=0.3, refined=grid_pose)  # its imprint means little
    assert one.verdict is Verdict.AMBIGUOUS
    wide = Tolerance(2 * localization.posterior.grid.spacing_m)
    assert tolerate(one, wide).verdict is Verdict.CERTAIN


def test_contradicting_touches_give_a_poor_fit_unless_the_outlier_is_known(localization):
    one = changed(localization, probability=0.95, imprint_iou=0.8, refined=moved(localization))
    two = replace(one, agreement=Agreement((0.9, 0.9), contradictory=True))
    assert two.verdict is Verdict.POOR_FIT
    outvoted = Agreement((0.9,) * 4, outliers=(1,), contradictory=True)
    four = replace(one, others=(one.touch,) * 3, agreement=outvoted)
    assert four.verdict is Verdict.CERTAIN
    three = replace(four, others=(one.touch,) * 2)  # two touches may agree by chance
    assert three.verdict is Verdict.POOR_FIT
    assert replace(one, others=(one.touch,), left_out=(one.touch,)).verdict is Verdict.POOR_FIT


def test_a_poor_fit_states_no_probability_and_of_several_touches_asks_for_the_sensor_poses(localization):
    one = changed(localization, probability=0.95, imprint_iou=0.3, refined=moved(localization))
    two = replace(one, others=(one.touch,))
    assert "T_base_sensor" not in one.summary()
    assert "imprint IoU 30 %" in one.summary().splitlines()
    assert "probability" not in one.summary()
    assert f"next: {CHECK_SENSOR_POSES}" in two.summary().splitlines()
    assert two.assessment.next_step == suggest_next_step(two) == CHECK_SENSOR_POSES
    assert name_next_step(Verdict.NOT_FOUND, 2) == NEXT_STEPS[Verdict.NOT_FOUND]


@pytest.mark.parametrize("verdict", list(Verdict))
def test_words_state_the_probability_only_beside_a_pose_that_may_be_right(localization, verdict):
    stated = verdict in (Verdict.CERTAIN, Verdict.AMBIGUOUS)
    assessed = replace(localization.assessment, verdict=verdict, probability_within=0.61)
    words = replace(localization, assessed=assessed).describe_within()
    assert words == ("within 1 mm with 61 % probability" if stated else "")


def test_a_limit_of_the_fit_is_no_probability(localization):
    """The covariance leaves larger errors open, so the fit is cut at its limit for poses that are left open."""
    loose = replace(moved(localization), covariance=np.diag([3e-3**2, *[1e-10] * 5]))
    left_open = changed(localization, probability=1.0, imprint_iou=0.9, refined=loose)
    assert left_open.verdict is Verdict.AMBIGUOUS
    assert left_open.probability_within() == MOST_UNDETERMINED
    assert left_open.state_within() is None
    assert (left_open.to_json()["probability_within"], left_open.describe_within()) == (None, "")
    assert "%" not in left_open.summary().splitlines()[2].partition("imprint")[0]
    sure = replace(left_open, assessed=replace(left_open.assessment, verdict=Verdict.CERTAIN))
    assert sure.describe_within() == f"within 1 mm with at least {format_percent(CERTAIN)} probability"
    missed = replace(left_open, posterior=replace(left_open.posterior, elsewhere=MOST_ELSEWHERE))
    assert "%" not in missed.describe_search()


def test_the_probability_within_a_tolerance_takes_a_text_or_a_tolerance(localization):
    one = changed(localization, refined=moved(localization))
    assert one.probability_within("1mm") == one.probability_within()
    assert one.probability_within("2mm,3deg") == one.probability_within(Tolerance.parse("2mm,3deg"))
    assert one.probability_within("0.001mm") < one.probability_within("5mm")
    with pytest.raises(ConfigError):
        one.probability_within("near")
