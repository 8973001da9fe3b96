"""The next step names the press beside the touch that distinguishes the poses, or the verdict's own step."""

import numpy as np
import pytest
from planning_helpers import join_boxes

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.result.localization import Hypothesis, Localization
from tactile_loc.locate.result.verdict import NEXT_STEPS, Outcome, Verdict
from tactile_loc.planning.next_step import suggest_next_step

GEL = SensorGeometry("orthographic", 80, 60, 8000.0, 8000.0, 40.0, 30.0, 0.01, 1e-3)  # 10 x 7.5 mm
HALF_TURN = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))
ON_GEL = make_transform(rotation_about([1, 0, 0], np.pi), [0.0, 0.0, 0.0145])  # its top is 0.5 mm deep in the gel


@pytest.fixture
def plate(make_object) -> ObjectModel:
    """Return a plate, 80 x 80 x 10 mm, with a knob of 3 mm on its top, 20 mm from its middle along +x."""
    return make_object(join_boxes(((0.08, 0.08, 0.01), [0, 0, 0]), ((0.003, 0.002, 0.003), [0.02, 0, 0.006])))


def located(obj: ObjectModel, poses: list[np.ndarray], p: list[float], T_base_sensor=None) -> Localization:
    """Return a result whose first pose is right with its probability."""
    depth = np.full(GEL.shape, 1e-3, np.float32)
    depth[20:40, 20:60] = 5e-4
    touch = Touch(ContactShape(depth, 1e-3), GEL, T_base_sensor=T_base_sensor)
    hypotheses = []
    for k, (share, T) in enumerate(zip(p, poses, strict=True)):
        refined = RefinedPose(T @ make_translation([1e-6, 0, 0]), 1.0, True, 1, 1e-12 * np.eye(6))
        hypotheses.append(Hypothesis(share, T, refined, k, 1, 0.9, T_base_sensor=T_base_sensor))
    posterior = PosePosterior(PoseGrid(np.stack(poses), PoseMetric(obj)), np.log(p))
    outcome = Outcome(p[0], sum(p[1:]), 0.0)
    return Localization(touch, posterior, tuple(hypotheses), {}, config=RunConfig(), outcome=outcome)


@pytest.mark.parametrize("T_base_sensor", [None, make_transform(rotation_about([1, 2, 3], 1.0), [0.3, 0.1, 0.2])])
def test_the_press_toward_the_knob_is_named(plate, T_base_sensor):
    one = located(plate, [ON_GEL, ON_GEL @ HALF_TURN], [0.5, 0.5], T_base_sensor)
    assert one.verdict is Verdict.AMBIGUOUS
    step = suggest_next_step(one)
    assert "20 mm from this touch toward +x" in step or "20 mm from this touch toward -x" in step


def test_the_verdicts_step_is_given_if_no_press_beside_the_touch_helps(make_box):
    plain = make_box(0.3, 0.3, 0.01, symmetry="none")
    one = located(plain, [ON_GEL, ON_GEL @ HALF_TURN], [0.5, 0.5])
    assert suggest_next_step(one) == NEXT_STEPS[Verdict.AMBIGUOUS]


def test_a_certain_result_needs_no_step(plate):
    assert suggest_next_step(located(plate, [ON_GEL], [1.0])) == ""
