"""The refiner keeps every contract of its slot, undoes small displacements, and reports its iterations."""

import numpy as np
import pytest
from tactile_loc.plugin.helpers import Cloud, make_contact_cloud
from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties
from tactile_loc.testing.problems import CAMERAS, OFFSETS, press_block, replace_depth

from tactile_loc_small_gicp.refiner import SmallGicpRefiner


def with_options(**options) -> SmallGicpRefiner:
    return SmallGicpRefiner(SmallGicpRefiner.Options(**options))


@parametrize_with_checks([SmallGicpRefiner()])
def test_contract(component, check):
    check(component)


@parametrize_with_properties([SmallGicpRefiner()])
def test_property(component, check):
    check(component)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("offset", OFFSETS)
def test_a_small_displacement_is_undone(camera, offset):
    """The error of a candidate, 0.7 to 1 mm or 5 degrees, falls below a third of a pixel (0.4 mm)."""
    problem = press_block(camera)
    before = problem.measure_error_m(problem.make_candidate(offset))
    refined = SmallGicpRefiner().refine(problem.touch, problem.make_candidate(offset), problem.scene)
    assert before > 3e-4
    assert problem.measure_error_m(refined) < 1.3e-4
    assert 1 <= refined.iterations <= 40


def test_too_few_iterations_do_not_converge():
    problem, candidate = press_block(), press_block().make_candidate(OFFSETS[1])
    short, long = (with_options(iterations=n).refine(problem.touch, candidate, problem.scene) for n in (1, 40))
    assert (short.converged, long.converged) == (False, True)
    assert short.iterations <= 1 < long.iterations
    assert problem.measure_error_m(long) < problem.measure_error_m(short)


def test_clouds_out_of_reach_are_not_registered():
    """The least reach is 4 pixels of 0.4 mm, so a contact three times as far away has no corresponding points."""
    problem = press_block()
    depth = np.full_like(problem.touch.contact_shape.depth_m, problem.touch.press_depth_m)
    depth[2:8, 2:8] = 0
    far = replace_depth(problem.touch, depth)
    candidate = problem.make_candidate()
    near = with_options(reach_mm=0.1, iterations=50).refine(far, candidate, problem.scene)
    np.testing.assert_array_equal(near.T_sensor_object, candidate.T_sensor_object)
    assert not near.converged


def test_voxels_thin_the_clouds():
    problem = press_block()
    points_m, normals = make_contact_cloud(problem.touch.contact_shape, problem.touch.geometry, walls=False)
    cloud = Cloud(1e3 * points_m, normals, spacing_mm=0.4)
    sizes = [with_options(voxel_mm=mm).prepared(cloud).points.size() for mm in (0.25, 1.0, 2.0)]
    assert sizes[0] > 2 * sizes[1] > 4 * sizes[2] > 40
    assert with_options(voxel_mm=50.0).prepared(cloud) is None
    refined = with_options(voxel_mm=50.0).refine(problem.touch, problem.make_candidate(), problem.scene)
    assert not refined.converged
