"""The refiner keeps every contract of its slot, and corrects a slide."""

from __future__ import annotations

from tactile_loc_centroid.refiner import CentroidRefiner

from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties
from tactile_loc.testing.problems import press_block


@parametrize_with_checks([CentroidRefiner()])
def test_contract(component, check):
    """Run one check of `tactile_loc.testing` on one component."""
    check(component)


@parametrize_with_properties([CentroidRefiner()])
def test_property(component, check):
    """Run one property of `tactile_loc.testing` on one component."""
    check(component)


def test_a_slide_is_undone():
    """A candidate 1 mm from the true pose ends within 0.05 mm of it."""
    problem = press_block()
    refined = CentroidRefiner().refine(problem.touch, problem.make_candidate((0.0008, -0.0006, 0.0)), problem.scene)
    assert problem.measure_error_m(refined) < 5e-5
    assert refined.converged
