"""Evaluation of what `run` answers, on a coarse search: errors, verdicts, examples without a pose, and resuming."""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest

from tactile_loc import ExampleTable, Localization, Localizer, NoContactError, StageStore, localize_together
from tactile_loc.core.poses.pose_errors import RIGHT_M
from tactile_loc.evaluation.metrics import METRICS, PoseJudge
from tactile_loc.evaluation.recall import evaluation as module
from tactile_loc.evaluation.recall.evaluation import evaluate_recall, make_recall_key
from tactile_loc.evaluation.recall.examples import DrawnExamples, TouchedExample
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.plugin.helpers import invert

SETTINGS = {"grid": {"name": "whole", "directions": 300}, "temperature": 0.05, "top": 3}
COUNT = 3


@pytest.fixture(scope="module")
def hook(store: StageStore) -> Localizer:
    return Localizer.create("hook", store=store, **SETTINGS)


@pytest.fixture(scope="module")
def examples(hook: Localizer) -> DrawnExamples:
    return DrawnExamples(hook, SimulatedTouches("none", 3), COUNT, 2)


@pytest.fixture(scope="module")
def found(hook: Localizer, examples: DrawnExamples) -> ExampleTable:
    return evaluate_recall(hook, examples, (1, 2))


def measure_listed(hook, observations) -> tuple[Localization, np.ndarray]:
    """Return what `run` answers, and the METRICS (K, M), metres, of its poses."""
    told = localize_together(observations)
    poses = np.stack([one.T_sensor_object for one in told.hypotheses])
    return told, PoseJudge(hook.object).measure_errors(poses, observations[0][1].T_sensor_object)


def test_the_errors_are_those_of_what_run_lists(hook, examples, found):
    told, errors_m = measure_listed(hook, examples.draw(1).observations)
    (row,) = np.flatnonzero((found["example"] == 1) & (found["touches"] == 2))
    for number, metric in enumerate(METRICS):
        assert found.errors_m("first", metric)[row] == errors_m[0, number]
        assert found.errors_m("listed", metric)[row] == errors_m[:, number].min()
    assert found["probability"][row] == told.hypotheses[0].probability
    assert found["verdict"][row] == told.verdict


def test_a_wrong_pose_that_explains_the_touches_as_well_makes_them_undetermined(hook, examples, found):
    alone = found.group("touches")[1,]
    undetermined = alone["example"][~alone["determined"]]
    assert len(undetermined)
    for number in undetermined:
        _, errors_m = measure_listed(hook, examples.draw(int(number)).observations[:1])
        assert (errors_m[:, METRICS.index("mssd")] > RIGHT_M).any()


@dataclasses.dataclass(frozen=True)
class Troubled:
    """Three examples: one complete, one whose second touch cannot be read, one with a single touch."""

    examples: DrawnExamples
    count: int = 3
    labels: ClassVar = {"noise": "troubled", "seed": -1}

    def draw(self, number: int) -> TouchedExample:
        observations = self.examples.draw(number).observations
        return [
            TouchedExample(observations),
            TouchedExample(observations[:1], problem="b.npz is damaged"),
            TouchedExample(observations[:1]),
        ][number]

    def describe(self) -> dict[str, str]:
        return {"kind": "troubled"}


def test_examples_that_cannot_be_located_are_kept_with_their_reason(hook, examples, monkeypatch):
    def refuse(observations, *rest):
        if len(observations) == 1 and observations[0][1].name.startswith("example-0002"):
            raise NoContactError("nothing touches the gel")
        return localize_together(observations, *rest)

    monkeypatch.setattr(module, "localize_together", refuse)
    found = evaluate_recall(hook, Troubled(examples), (1, 2))
    labels = list(zip(found["example"], found["touches"], strict=True))
    assert labels == [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1)]  # the third example has a single touch
    assert (found["verdict"][3], found["problem"][3]) == ("refused", "b.npz is damaged")
    assert (found["verdict"][4], found["problem"][4]) == ("no contact", "nothing touches the gel")
    assert np.isinf(found.errors_m()[4])
    assert np.isfinite(found.errors_m()[1])
    assert np.isnan(found["seconds"][4])


def test_poses_are_in_the_first_sensor_s_frame_if_the_first_touch_is_left_out(examples):
    observations = examples.draw(0).observations
    first, second = (touch for _, touch in observations)
    told = localize_together(observations[1:])
    T = module._view_from_first(observations, told)[0]
    T_base_object = second.T_base_sensor @ told.best.T_sensor_object
    assert np.allclose(T, invert(first.T_base_sensor) @ T_base_object)


def test_the_key_depends_on_settings_examples_and_numbers(hook, examples, store):
    keys = [
        make_recall_key(hook, examples, (1, 2)),
        make_recall_key(hook, examples, (1,)),
        make_recall_key(hook, dataclasses.replace(examples, source=SimulatedTouches("none", 4)), (1, 2)),
        make_recall_key(Localizer.create("hook", store=store, **{**SETTINGS, "top": 4}), examples, (1, 2)),
    ]
    assert len({key.digest for key in keys}) == len(keys)
