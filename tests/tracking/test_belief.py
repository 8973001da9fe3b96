"""The belief in a pose: it grows with the touches that prefer it, and not with those that leave it open."""

from dataclasses import replace

import numpy as np
import pytest
from track_settings import SETTINGS

from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.verdict import Outcome
from tactile_loc.tracking.belief import LEAST_TOUCHES, believe, measure_share_within

UNSURE = Outcome(0.4, 0.2, 0.4)


@pytest.fixture(scope="module")
def pin(store) -> Localizer:
    return Localizer.create("pin", store=store, **SETTINGS)


@pytest.fixture(scope="module")
def located(pin):
    """Return the result of touches that determine the pose, as if the model of outcomes were unsure."""
    return replace(pin.localize(pin.simulate_together(4, seed=3)), outcome=UNSURE)


def believed(found, pin) -> Outcome:
    return believe(found, pin.object, ONE_MILLIMETRE).outcome


def test_touches_that_rule_out_all_other_poses_are_believed(pin, located):
    found = believed(located, pin)
    assert found.right > 0.95
    assert found.right + found.another + found.missed == pytest.approx(1)
    assert found.another / found.missed == pytest.approx(UNSURE.another / UNSURE.missed)


def test_a_pose_that_explains_the_touches_as_well_shares_the_belief(pin, located):
    first = located.hypotheses[0]
    rivals = [replace(one, imprint_iou=first.imprint_iou) for one in (*located.hypotheses[1:], *located.unlisted)]
    assert not located.evidence.near[1:].all()
    assert believed(replace(located, hypotheses=(first,), unlisted=tuple(rivals)), pin).right <= 0.5


def test_few_touches_are_judged_by_the_model_alone(pin, located):
    few = replace(located, others=located.others[: LEAST_TOUCHES - 2])
    assert believed(few, pin) is UNSURE


def test_a_pose_is_within_a_tolerance_as_often_as_its_covariance_says(pin):
    narrow, wide = (np.diag(np.square([std_m] * 3 + [1e-6] * 3)) for std_m in (1e-4, 1e-2))
    assert measure_share_within(np.eye(4), narrow, pin.object, ONE_MILLIMETRE) == 1
    assert measure_share_within(np.eye(4), wide, pin.object, ONE_MILLIMETRE) < 0.05
