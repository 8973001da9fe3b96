"""The protocol on a coarse grid: relations between the lines of every touch, and resuming with the same results."""

import dataclasses

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import ExampleTable, Localizer, PoseJudge, StageKey, StageStore
from tactile_loc.core.poses.pose_errors import compute_adds
from tactile_loc.evaluation.protocol import (
    LINES,
    STAGES,
    TouchEvaluator,
    evaluate,
    make_evaluation_key,
    measure_in_shards,
)
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import find_scale_m, normalise_errors
from tactile_loc.plugin import ConfigError, TouchError

COUNT = 6


@pytest.fixture(scope="module")
def evaluation(localizer: Localizer) -> ExampleTable:
    return evaluate(localizer, COUNT, SimulatedTouches("strong", 3))


def fresh(store: StageStore, **settings) -> Localizer:
    return Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, store=store, **settings)


@pytest.fixture(scope="module")
def plain(localizer: Localizer) -> ExampleTable:
    """Without refinement, whose threads may sum in another order, results are equal to the bit."""
    return evaluate(fresh(localizer.store, refiner="none"), COUNT, SimulatedTouches("strong", 3))


def assert_same(a: ExampleTable, b: ExampleTable) -> None:
    assert all((a.errors_m(line, "add") == b.errors_m(line, "add")).all() for line in LINES)
    assert (a["T_sensor_object"] == b["T_sensor_object"]).all()


def test_every_touch_has_every_line_and_stage(evaluation):
    assert evaluation["T_sensor_object"].shape == (COUNT, len(LINES), 4, 4)
    assert all((evaluation.errors_m(line, "add") >= 0).all() for line in LINES)
    assert all((evaluation[f"{stage}_s"] > 0).all() for stage in STAGES)
    assert {len(values) for values in evaluation.columns.values()} == {COUNT}


def test_errors_equal_the_distances_of_the_poses(evaluation, localizer):
    points_m = localizer.object.mesh.sample(20_000, np.random.default_rng(9))
    for number in range(COUNT):
        truth = SimulatedTouches("strong", 3).draw_touch(localizer, number).T_sensor_object
        for line in LINES:
            error_m = compute_adds(
                localizer.object, points_m, evaluation["T_sensor_object"][number, LINES.index(line)][None], truth
            )
            assert evaluation.errors_m(line, "add")[number] == pytest.approx(error_m, rel=0.03, abs=1e-6)


def test_the_closest_line_uses_the_nearest_pose_of_the_whole_grid(evaluation, localizer):
    points_m = PoseJudge(localizer.object).points_m
    for number in range(COUNT):
        touch = SimulatedTouches("strong", 3).draw_touch(localizer, number)
        grid = localizer.listed.press_grid(touch).T_sensor_object
        every = compute_adds(localizer.object, points_m, grid, touch.T_sensor_object)
        assert evaluation.errors_m("closest", "add")[number] == pytest.approx(every.min(), rel=1e-6)


def test_the_random_line_has_a_normalised_mean_of_one(evaluation):
    assert normalise_errors(evaluation, "random").mean() == pytest.approx(1)
    assert normalise_errors(evaluation, "best-1") * find_scale_m(evaluation) == pytest.approx(
        evaluation.errors_m("best-1", "add")
    )


@pytest.mark.slow
def test_equal_seeds_give_equal_errors_and_other_seeds_give_other_errors(plain, localizer, tmp_path):
    again = evaluate(fresh(StageStore(tmp_path), refiner="none"), COUNT, SimulatedTouches("strong", 3))
    assert_same(plain, again)
    other = evaluate(fresh(localizer.store, refiner="none"), 2, SimulatedTouches("strong", 4))
    assert not np.allclose(other.errors_m("best-1", "add"), plain.errors_m("best-1", "add")[:2])


def test_the_number_of_touches_does_not_change_the_first_ones(evaluation, localizer):
    """With refinement, results are equal up to the rounding of its threads."""
    fewer = evaluate(localizer, 2, SimulatedTouches("strong", 3))
    for line in LINES:
        np.testing.assert_allclose(fewer.errors_m(line, "add"), evaluation.errors_m(line, "add")[:2], atol=1e-8)


@pytest.mark.slow
def test_all_encoders_get_the_same_touches(plain, localizer):
    settings = {"encoder": {"name": "pixel", "cells": 5}, "refiner": "none"}
    other = evaluate(fresh(localizer.store, **settings), COUNT, SimulatedTouches("strong", 3))
    for line in ("random", "random-10"):
        assert (other.errors_m(line, "add") == plain.errors_m(line, "add")).all()
    assert not (other.errors_m("best-1", "add") == plain.errors_m("best-1", "add")).all()


def test_interrupted_measurements_resume_with_the_last_shard_and_finished_ones_are_not_repeated(tmp_path):
    asked: list[list[int]] = []

    def make(numbers):
        asked.append(list(numbers))
        if len(asked) == 2:
            raise KeyboardInterrupt
        return [np.array(numbers), np.array(numbers)[:, None] / 2]

    def measure():
        key = StageKey("shards", 1, {"of": "a test"})
        return measure_in_shards(StageStore(tmp_path), key, ("whole", "half"), 5, 2, make)

    with pytest.raises(KeyboardInterrupt):
        measure()
    for _ in range(2):
        found = measure()
        assert (found["whole"].tolist(), found["half"][:, 0].tolist()) == ([0, 1, 2, 3, 4], [0, 0.5, 1, 1.5, 2])
    assert asked == [[0, 1], [2, 3], [2, 3], [4]]


def test_the_key_contains_every_input_that_changes_the_errors(localizer):
    def digest(local=localizer, count=COUNT, noise="strong", seed=3):
        return make_evaluation_key(local, count, SimulatedTouches(noise, seed)).digest

    store = localizer.store
    others = [digest(count=7), digest(noise="mild"), digest(seed=4)]
    for settings in ({"refiner": "none"}, {"encoder": {"name": "pixel", "cells": 10}}, {"matcher": "faiss"}):
        others.append(digest(fresh(store, **settings)))
    assert digest() == digest(fresh(store))
    assert len({digest(), *others}) == 7


def test_touches_without_a_true_pose_and_unknown_noise_are_refused(localizer):
    touch = dataclasses.replace(SimulatedTouches().draw_touch(localizer, 0), T_sensor_object=None)
    with pytest.raises(TouchError, match="touch-0000"):
        TouchEvaluator(localizer).measure(touch, np.random.default_rng(0))
    with pytest.raises(ConfigError, match=naming("'loud'", "mild")):
        evaluate(localizer, 1, SimulatedTouches("loud"))
