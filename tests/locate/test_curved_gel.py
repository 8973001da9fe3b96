"""An object is located with a curved gel as well as with a flat one, but not if the gel is taken for flat."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.slots.registry import registry


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    sensor = {"name": "digit-curved", "gel": "rigid"}
    return Localizer.create("cotter", store=store, sensor=sensor, grid="whole")


@pytest.fixture(scope="module")
def examples(localizer) -> list[list[Touch]]:
    source = RobotTouches(localizer.object, localizer.scene.geometry, registry().create("renderer", "raycast", {}))
    return [source.draw_example(3, np.random.default_rng([7, k]))[0] for k in range(6)]


def off_mm(localizer: Localizer, T: np.ndarray, touch: Touch) -> float:
    truth = np.asarray(touch.T_sensor_object)
    return 1e3 * float(PoseMetric(localizer.object).symmetric_distance(T[None], truth[None])[0])


@pytest.mark.slow
def test_three_touches_of_a_curved_gel_locate_the_object(localizer, examples):
    found = [localize_together([(localizer, touch) for touch in some]).best.T_sensor_object for some in examples]
    errors_mm = [off_mm(localizer, T, some[0]) for T, some in zip(found, examples, strict=True)]
    assert np.median(errors_mm) < 0.1


def test_the_joint_refiner_stays_at_the_truth(localizer, examples):
    refined = [
        localizer.refinement.refiner.refine(
            some[0], Candidate(np.asarray(some[0].T_sensor_object), 0, 0.0), scene
        ).T_sensor_object
        for some in examples
        for scene in [localizer.scene.match_touch(some[0])]
    ]
    errors_mm = [off_mm(localizer, T, some[0]) for T, some in zip(refined, examples, strict=True)]
    assert np.median(errors_mm) < 0.02


def test_true_poses_explain_touches_worse_if_the_gel_is_taken_for_flat(localizer, examples):
    flat = dataclasses.replace(localizer.scene.geometry, relief_m=None)
    for touch in (touch for some in examples for touch in some):
        truth = np.asarray(touch.T_sensor_object)[None]
        as_flat = dataclasses.replace(touch, geometry=flat)
        curved_iou = localizer.scene.match_touch(touch).imprint_ious(truth, touch)[0]
        flat_iou = localizer.scene.match_touch(as_flat).imprint_ious(truth, as_flat)[0]
        assert curved_iou > 0.95
        assert flat_iou < curved_iou
