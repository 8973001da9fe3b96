"""What the paper's tables need of single touches: errors in three metrics, and how ambiguous each touch is."""

import dataclasses

import pytest

from tactile_loc import ExampleTable, Localizer
from tactile_loc.core.poses.pose_errors import compute_add_s
from tactile_loc.evaluation.metrics import PoseJudge
from tactile_loc.evaluation.paper import single_touches
from tactile_loc.evaluation.paper.single_touches import METRICS, evaluate_touches, make_judgement_key
from tactile_loc.evaluation.protocol import LINES, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches

COUNT, TOUCHES = 4, SimulatedTouches("strong", 3)


@pytest.fixture(scope="module")
def found(localizer: Localizer) -> ExampleTable:
    return evaluate_touches(localizer, COUNT, TOUCHES)


def test_the_table_is_that_of_the_protocol_with_further_columns(found, localizer):
    plain = evaluate(localizer, COUNT, TOUCHES)
    assert all((found[name] == values).all() for name, values in plain.columns.items())
    further = {f"{line} {metric}_m" for line in LINES for metric in METRICS[1:]} | {"ambiguity", "contact_share"}
    assert set(found.columns) - set(plain.columns) == further
    assert {len(values) for values in found.columns.values()} == {COUNT}
    shares = [TOUCHES.draw_touch(localizer, number).contact_share for number in range(COUNT)]
    assert found["contact_share"].tolist() == shares


def test_every_line_has_the_errors_of_its_pose(found, localizer):
    judge = PoseJudge(localizer.object)
    for number, (poses, truth) in enumerate(zip(found["T_sensor_object"], found["T_true"], strict=True)):
        mssd, add, _ = judge.measure_errors(poses, truth).T
        add_s = compute_add_s(judge.points_m, poses, truth, every=single_touches.ASKED_EVERY)
        for metric, errors_m in zip(METRICS, (add, mssd, add_s), strict=True):
            measured = [found.errors_m(line, metric)[number] for line in LINES]
            assert measured == pytest.approx(errors_m, rel=1e-9, abs=1e-12), metric


def test_an_equivalent_pose_of_a_symmetric_object_has_no_error(localizer):
    """The pin rotated by 180 degrees about its axis looks the same, so such an estimate is correct."""
    truth = TOUCHES.draw_touch(localizer, 0).T_sensor_object
    same = localizer.model.grid.metric.equivalents(truth[None], 2e-4)[:, 0]
    assert len(same) == 2
    assert single_touches._measure_errors(PoseJudge(localizer.object), same, truth)[:, 0] == pytest.approx(0, abs=1e-9)


def test_touches_are_judged_once_for_all_encoders_and_all_columns_are_kept(found, localizer, monkeypatch):
    monkeypatch.setattr(single_touches, "measure_ambiguity", None)
    settings = {"encoder": {"name": "pixel", "cells": 5}, "refiner": "none"}
    other = Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, store=localizer.store, **settings)
    again = evaluate_touches(other, COUNT, TOUCHES)
    monkeypatch.setattr(single_touches, "_measure_errors", None)
    kept = evaluate_touches(localizer, COUNT, TOUCHES)
    assert all((kept[name] == values).all() for name, values in found.columns.items())
    assert (again["ambiguity"] == found["ambiguity"]).all()
    assert not (again.errors_m("best-1", "mssd") == found.errors_m("best-1", "mssd")).all()


def test_the_key_contains_every_input_that_changes_the_judgement(localizer):
    def digest(count=COUNT, noise="strong", seed=3):
        return make_judgement_key(localizer, count, dataclasses.replace(TOUCHES, noise=noise, seed=seed)).digest

    assert len({digest(), digest(count=5), digest(noise="mild"), digest(seed=4)}) == 4
