"""The verdict: the order of its rules, its thresholds, and its value in a result and its file."""

from dataclasses import replace

import numpy as np
import pytest
from locate_helpers import draw_examples, locate_together

from tactile_loc import Localizer, RunConfig, Tolerance, suggest_next_step
from tactile_loc.io.options import CERTAIN
from tactile_loc.locate.probability.outcome_model import load_outcome_model
from tactile_loc.locate.result.localization import QUANTILES_M, Agreement, Localization
from tactile_loc.locate.result.verdict import (
    CHECK_SENSOR_POSES,
    MEANINGS,
    MOSTLY_ELSEWHERE,
    NEXT_STEPS,
    Outcome,
    Verdict,
    judge,
    name_next_step,
)
from tactile_loc.plugin import ConfigError, RefinedPose

SENSOR = {"name": "gelsight-mini", "gel": "rigid"}
RIGHT, OPEN, MISSED = Outcome(0.97, 0.02, 0.01), Outcome(0.6, 0.3, 0.1), Outcome(0.1, 0.2, 0.7)


@pytest.mark.parametrize(
    ("outcome", "doubts", "expected"),
    [
        (Outcome(CERTAIN, 0.05, 0.0), {}, Verdict.CERTAIN),
        (Outcome(CERTAIN - 0.01, 0.06, 0.0), {}, Verdict.AMBIGUOUS),
        (Outcome(CERTAIN - 0.01, 0.06, 0.0), {"least": 0.9}, Verdict.CERTAIN),
        (RIGHT, {"least": 0.99}, Verdict.AMBIGUOUS),
        (RIGHT, {"sure": False}, Verdict.AMBIGUOUS),
        (RIGHT, {"poor": True}, Verdict.POOR_FIT),
        (MISSED, {"poor": True}, Verdict.POOR_FIT),
        (MISSED, {}, Verdict.NOT_FOUND),
        (Outcome(0.3, 0.7 - MOSTLY_ELSEWHERE, MOSTLY_ELSEWHERE), {}, Verdict.AMBIGUOUS),
        (Outcome(0.1, 0.9, 0.0), {}, Verdict.AMBIGUOUS),
        (None, {"poor": True}, Verdict.NOT_FOUND),
    ],
)
def test_the_first_matching_rule_gives_the_verdict(outcome, doubts, expected):
    assert judge(outcome, **doubts) is expected


def test_every_verdict_has_a_meaning():
    assert set(MEANINGS) == set(NEXT_STEPS) == set(Verdict)
    assert {str(one) for one in Verdict} == {"certain", "ambiguous", "poor fit", "not found", "no contact"}


def explain_poorly(found):
    """The same result, whose first pose leaves e^9 times as much of the touch unexplained."""
    return replace(found, evidence=replace(found.evidence, fits=found.evidence.fits + 9.0 * (np.arange(9) == 0)))


@pytest.fixture(scope="module")
def certain(localization):
    """The result with a first pose that is probably right, and the evidence of one that explains the touch."""
    perfect = np.array([[-5.0, *localization.evidence.fits[0, 1:]]])
    return replace(localization, outcome=RIGHT, evidence=replace(localization.evidence, fits=perfect))


def test_a_result_is_judged_by_its_outcome_and_by_what_its_first_pose_leaves_unexplained(certain):
    assert certain.verdict is Verdict.CERTAIN
    assert replace(certain, outcome=OPEN).verdict is Verdict.AMBIGUOUS
    alone = replace(certain.evidence, probe_losses=np.ones(6))
    assert not str(replace(certain, hypotheses=certain.hypotheses[:1], evidence=alone).freedom)
    assert (
        replace(certain, hypotheses=certain.hypotheses[:1], evidence=alone, outcome=MISSED).verdict is Verdict.NOT_FOUND
    )
    assert replace(certain, outcome=MISSED).verdict is Verdict.AMBIGUOUS  # other poses explain the touch as well
    more = -0.2 - load_outcome_model().measure_excess(certain.evidence).max()
    worse = replace(certain.evidence, fits=certain.evidence.fits + more * (np.arange(9) == 0))
    assert replace(certain, outcome=MISSED, evidence=worse).verdict is Verdict.NOT_FOUND  # but not this one
    assert replace(certain, outcome=None).verdict is Verdict.NOT_FOUND
    strict = replace(certain, config=certain.config.model_copy(update={"confidence": 0.99}))
    assert strict.verdict is Verdict.AMBIGUOUS
    poor = explain_poorly(certain)
    assert (poor.poor_touches, poor.verdict) == ((0,), Verdict.POOR_FIT)
    assert poor.assessment.poor_touches == (0,)
    grid_pose = RefinedPose(certain.best.T_sensor_object_grid, 1.0, True, 0)
    unrefined = replace(poor, hypotheses=(replace(certain.best, refined=grid_pose),))
    assert (unrefined.poor_touches, unrefined.verdict) == ((), Verdict.AMBIGUOUS), "it has no covariance"
    assert replace(certain, unexpected=True).verdict is Verdict.AMBIGUOUS


def test_contradicting_touches_give_a_poor_fit_unless_the_outlier_is_known(certain):
    two = replace(certain, agreement=Agreement((0.9, 0.9), contradictory=True))
    assert two.verdict is Verdict.POOR_FIT
    outvoted = Agreement((0.9,) * 4, outliers=(1,), contradictory=True)
    evidence = replace(certain.evidence, fits=np.repeat(certain.evidence.fits, 3, axis=0))
    four = replace(certain, others=(certain.touch,) * 3, agreement=outvoted, evidence=evidence)
    assert four.verdict is Verdict.CERTAIN
    three = replace(four, others=(certain.touch,) * 2)  # two touches may agree by chance
    assert three.verdict is Verdict.POOR_FIT
    assert replace(certain, others=(certain.touch,), left_out=(certain.touch,)).verdict is Verdict.POOR_FIT


def test_poor_touches_keep_their_numbers_beside_outliers(certain):
    fits = np.repeat(certain.evidence.fits, 3, axis=0) + 9.0 * np.outer([0, 1, 0], np.arange(9) == 0)
    four = replace(
        certain,
        others=(certain.touch,) * 3,
        agreement=Agreement((0.9,) * 4, outliers=(1,), contradictory=True),
        evidence=replace(certain.evidence, fits=fits),
    )
    assert four.poor_touches == (2,), "the second of the three that are no outliers"


def test_the_summary_begins_with_the_verdict_and_names_the_first_pose(certain):
    lines = certain.summary().splitlines()
    assert lines[0].startswith("certain: ")
    for value_m in certain.best.T_sensor_object[:3, 3]:
        assert f"{1e3 * value_m:z.2f}" in lines[1]
    assert all(words in lines[2] for words in ("within 1 mm", "97 %", "imprint IoU"))
    assert str(certain) == certain.summary()
    assert not any(line.startswith("next: ") for line in lines)
    assert str(replace(certain, hypotheses=certain.hypotheses[:1])).splitlines()[1].startswith("first of 1 pose: ")


def test_a_poor_fit_states_no_probability_and_of_several_touches_asks_for_the_sensor_poses(certain):
    one = explain_poorly(certain)
    assert f"next: {NEXT_STEPS[Verdict.POOR_FIT]}" in one.summary().splitlines()
    assert "T_base_sensor" not in one.summary()
    assert "probability" not in one.summary()
    fits = np.repeat(one.evidence.fits, 2, axis=0)
    two = replace(one, others=(one.touch,), evidence=replace(one.evidence, fits=fits))
    assert f"next: {CHECK_SENSOR_POSES}" in two.summary().splitlines()
    assert two.assessment.next_step == suggest_next_step(two) == CHECK_SENSOR_POSES
    assert name_next_step(Verdict.NOT_FOUND, 2) == NEXT_STEPS[Verdict.NOT_FOUND]


@pytest.mark.parametrize("verdict", list(Verdict))
def test_words_state_the_probability_only_beside_a_pose_that_may_be_right(localization, verdict):
    stated = verdict in (Verdict.CERTAIN, Verdict.AMBIGUOUS)
    assessed = replace(localization.assessment, verdict=verdict)
    words = replace(localization, assessed=assessed, outcome=Outcome(0.61, 0.2, 0.19)).describe_within()
    assert words == ("within 1 mm with 61 % probability" if stated else "")


def test_the_probability_within_a_tolerance_takes_a_text_or_a_tolerance(localization):
    assert localization.probability_within() == localization.probability_within("1mm") == localization.outcome.right
    assert localization.probability_within("2mm,3deg") == localization.probability_within(Tolerance.parse("2mm,3deg"))
    assert localization.probability_within("0.001mm") < localization.probability_within("5mm")
    with pytest.raises(ConfigError):
        localization.probability_within("near")


def test_the_error_quantile_is_the_least_tolerance_with_a_probability_of_95_percent(certain, monkeypatch):
    for least_m in (*QUANTILES_M, None):
        limit_m = 1.0 if least_m is None else least_m
        monkeypatch.setattr(
            Localization, "probability_within", lambda found, asked, m=limit_m: 0.96 if asked.distance_m >= m else 0.94
        )
        assert certain.find_error_quantile_m() == certain.assessment.error_quantile_m == least_m
        del vars(certain)["assessment"]
    assert replace(certain, outcome=None).find_error_quantile_m() is None


def test_the_probabilities_of_all_poses_sum_to_one_minus_elsewhere_in_the_order_of_the_poses(localization, localizer):
    others = (localizer.localize(touch, top=40) for touch in localizer.simulate(3, seed=8, noise="strong"))
    for found in (localization, *others):
        p = np.array([h.probability for h in (*found.hypotheses, *found.unlisted)])
        assert p.sum() + found.outcome.missed == pytest.approx(1)
        assert (np.diff(p) <= 1e-12).all()
        assert 0 < found.outcome.right < 1


def test_a_turned_twin_leaves_a_result_ambiguous_unless_it_is_declared(make_box, store):
    """A block looks the same after half a turn about each of its axes."""
    config = RunConfig.from_dict({"grid": {"name": "whole", "directions": 300}, "sensor": SENSOR})
    plain, declared = (
        Localizer(config, make_box(0.024, 0.014, 0.008, symmetry=symmetry), store) for symmetry in ("none", "x2*y2")
    )
    for touches in draw_examples(declared, 3, 2):
        twins, alone = (locate_together(one, touches) for one in (plain, declared))
        assert (twins.verdict, alone.verdict) == (Verdict.AMBIGUOUS, Verdict.CERTAIN)
        assert (twins.freedom.others, alone.freedom.others) == (3, 0)
        assert "180 degrees" in twins.summary().splitlines()[0]
