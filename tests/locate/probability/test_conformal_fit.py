"""Held-out examples of conformal sets are drawn once, located as a user's touches are, and stored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.runtime.progress import NOTE
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.probability import conformal_fit as module
from tactile_loc.locate.probability.misses import predict_miss
from tactile_loc.store.store import StageStore

COARSE = {"grid": {"name": "face", "spacing_mm": 8}, "temperature": 0.01}


@pytest.fixture(scope="module")
def small():
    """Few examples, of one and two touches."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "EXAMPLES", {1: (6, 4, 2), 2: (4, 4, 2)})
        yield


@pytest.fixture(scope="module")
def localizer(store, small):
    return Localizer.create("pin", store=store, **COARSE)


def test_a_localisation_lists_the_poses_of_the_set(localizer):
    touch = localizer.simulate(1, seed=3, noise="strong")[0]
    few, many = (localizer.localize(touch, top=1, coverage=c) for c in (0.2, 0.8))
    for found in (few, many):
        assert len(found.hypotheses) == found.pose_set.poses
        assert found.pose_set.radius_m == module.RIGHT_M
    assert len(few.hypotheses) <= len(many.hypotheses)
    assert localizer.localize(touch).pose_set is None


def test_the_configuration_may_request_the_coverage(store, small):
    localizer = Localizer.create("pin", store=store, coverage=0.8, **COARSE)
    touch = localizer.simulate(1, seed=3)[0]
    assert localizer.localize(touch).pose_set.coverage == 0.8


@pytest.mark.slow
def test_examples_are_drawn_once_for_all_numbers_of_touches(tmp_path, small, monkeypatch, caplog):
    first = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    with caplog.at_level(NOTE):
        sets = first.conformal_sets
    assert 0 < len(sets.scores) <= 22
    assert all(0 <= score <= 1 for score in sets.scores)
    assert "pin" in caplog.text
    monkeypatch.setattr(module.ConformalFit, "_score", None)
    again = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    assert again.conformal_sets == sets


@pytest.mark.slow
def test_other_refiners_have_other_examples(localizer, store, small):
    """Without refinement, a pose counts as the true one within the radius of a mode."""
    plain = Localizer.create("pin", store=store, refiner="none", **COARSE)
    assert plain.conformal_sets.radius_m == plain.mode_radius_m
    assert plain.conformal_sets.scores != localizer.conformal_sets.scores


def test_several_touches_share_the_sets(localizer):
    touches = [replace(t, T_base_sensor=invert(np.asarray(t.T_sensor_object))) for t in localizer.simulate(2, seed=1)]
    found = localize_together([(localizer, touch) for touch in touches], coverage=0.8)
    assert found.pose_set.examples == len(localizer.conformal_sets.scores)
    assert len(found.hypotheses) == found.pose_set.poses


def test_touches_that_are_explained_worse_miss_the_pose_more_often_and_more_touches_less_often(localizer):
    found = localizer.localize(localizer.simulate(1, seed=2)[0])
    worse = tuple(replace(h, imprint_iou=0.5 * h.imprint_iou) for h in found.hypotheses)
    assert 0 < predict_miss(found.hypotheses, 1) < predict_miss(worse, 1) < 1
    assert predict_miss(found.hypotheses, 3) < predict_miss(found.hypotheses, 1)
