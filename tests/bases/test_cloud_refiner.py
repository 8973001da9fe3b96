"""The base class of refiners that register clouds, tested with given registrations."""

import dataclasses

import numpy as np
import pytest

from tactile_loc.plugin.helpers import CloudRefiner, Registration, make_translation
from tactile_loc.testing.problems import OFFSETS, press_block, replace_depth


class Given(CloudRefiner):
    """Return a given registration and store the clouds."""

    answer = Registration()

    def register(self, source, target):
        self.source, self.target = source, target
        return self.answer


def answering(T_mm, converged=True) -> Given:
    refiner = Given()
    refiner.answer = Registration(T_mm, converged, 3)
    return refiner


def test_the_transform_moves_the_candidate_in_the_sensor_frame():
    problem = press_block()
    candidate = problem.make_candidate((0.0008, 0.0, 0.3))
    result = answering(make_translation([-0.8, 0.0, 0.0])).refine(problem.touch, candidate, problem.scene)
    expected = make_translation([-0.0008, 0.0, 0.0]) @ candidate.T_sensor_object
    np.testing.assert_allclose(result.T_sensor_object, expected, atol=1e-12)
    assert (result.converged, result.iterations) == (True, 3)


def test_a_registration_that_lowers_the_iou_is_rejected():
    problem = press_block()
    candidate = problem.make_candidate(OFFSETS[0])
    result = answering(make_translation([5.0, 0.0, 0.0])).refine(problem.touch, candidate, problem.scene)
    np.testing.assert_array_equal(result.T_sensor_object, candidate.T_sensor_object)
    assert (result.converged, result.iterations) == (False, 3)


def test_a_pose_without_overlap_has_not_converged():
    problem = press_block()
    away = dataclasses.replace(problem.make_candidate(), T_sensor_object=make_translation([0.2, 0, 0]) @ problem.truth)
    result = answering(np.eye(4)).refine(problem.touch, away, problem.scene)
    assert (result.contact_iou, result.converged) == (0.0, False)


def test_clouds_are_in_mm_and_have_their_spacing():
    problem = press_block()
    refiner = answering(np.eye(4))
    refiner.refine(problem.touch, problem.make_candidate(), problem.scene)
    standoff_mm = 1e3 * problem.touch.geometry.standoff_m
    assert refiner.target.points_mm[:, 2].min() == pytest.approx(standoff_mm, abs=0.01)
    assert refiner.target.spacing_mm == pytest.approx(0.4)  # pixels of 0.4 mm, all of them used
    np.testing.assert_allclose(np.linalg.norm(refiner.source.normals, axis=1), 1.0)


def test_clouds_are_reduced_to_about_the_requested_size():
    problem = press_block()
    refiner = Given(Given.Options(moving_points=100, fixed_points=200))
    refiner.refine(problem.touch, problem.make_candidate(), problem.scene)
    assert 65 < len(refiner.source) < 150
    assert 130 < len(refiner.target) < 300
    assert refiner.source.spacing_mm > refiner.target.spacing_mm > 0.4


@pytest.mark.parametrize("pixels", [1, 2])
def test_a_touch_of_very_few_points_is_not_registered(pixels):
    problem = press_block()
    depth = np.full(problem.touch.geometry.shape, problem.touch.press_depth_m, np.float32)
    depth[30, 30 : 30 + pixels] = 0.0
    refiner = Given(Given.Options(walls=False))
    result = refiner.refine(replace_depth(problem.touch, depth), problem.make_candidate(), problem.scene)
    assert not hasattr(refiner, "source")
    assert not result.converged


def test_each_candidate_gets_its_own_registration():
    """A candidate without contact is not registered."""

    class Numbering(Given):
        def register_many(self, sources, target):
            return [Registration(make_translation([0.01 * i, 0.0, 0.0]), True, i) for i in range(len(sources))]

    problem = press_block()
    away = dataclasses.replace(problem.make_candidate(), T_sensor_object=make_translation([0.2, 0, 0]) @ problem.truth)
    candidates = [problem.make_candidate(), away, problem.make_candidate()]
    many = Numbering().refine_many(problem.touch, candidates, problem.scene)
    assert [result.iterations for result in many] == [0, 0, 1]
    assert [result.converged for result in many] == [True, False, True]
    np.testing.assert_allclose(many[2].T_sensor_object, make_translation([1e-5, 0, 0]) @ problem.truth, atol=1e-9)
