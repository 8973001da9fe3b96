"""An object is located with a curved gel as well as with a flat one, but not if the gel is taken for flat."""

import dataclasses

import numpy as np
import pytest
from locate_helpers import draw_examples, locate_together, measure_errors_mm

from tactile_loc import Localizer, Touch
from tactile_loc.plugin import Candidate


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    sensor = {"name": "digit-curved", "gel": "rigid"}
    return Localizer.create("cotter", store=store, sensor=sensor, grid="whole")


@pytest.fixture(scope="module")
def examples(localizer) -> list[list[Touch]]:
    return draw_examples(localizer, 7, 6)


@pytest.mark.slow
def test_three_touches_of_a_curved_gel_locate_the_object(localizer, examples):
    best = [locate_together(localizer, some).best.T_sensor_object[None] for some in examples]
    errors_mm = [measure_errors_mm(localizer, T, some[0])[0] for T, some in zip(best, examples, strict=True)]
    assert np.median(errors_mm) < 0.1


def test_the_joint_refiner_stays_at_the_truth(localizer, examples):
    errors_mm = []
    for touch, *_ in examples:
        true = Candidate(np.asarray(touch.T_sensor_object), 0, 0.0)
        refined = localizer.refinement.refiner.refine(touch, true, localizer.scene.match_touch(touch))
        errors_mm.append(measure_errors_mm(localizer, refined.T_sensor_object[None], touch)[0])
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
