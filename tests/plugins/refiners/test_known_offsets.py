"""Refiners of clouds undo a known offset of a candidate from the true pose, to a fraction of a pixel of 0.4 mm."""

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_translation
from tactile_loc.slots.registry import registry
from tactile_loc.testing.problems import CAMERAS, OFFSETS, press_block


@pytest.mark.parametrize(("name", "library"), [("icp", "open3d"), ("filterreg", "numba"), ("kiss-icp", "kiss_icp")])
@pytest.mark.parametrize("camera", CAMERAS)
def test_a_known_offset_is_undone_whatever_the_z_of_the_candidate(name, library, camera):
    pytest.importorskip(library)
    refiner, problem = registry().create("refiner", name), press_block(camera)
    for candidate in map(problem.make_candidate, OFFSETS):
        lifted = make_translation([0.0, 0.0, 0.002]) @ candidate.T_sensor_object
        refined, same = (
            refiner.refine(problem.touch, dataclasses.replace(candidate, T_sensor_object=T), problem.scene)
            for T in (candidate.T_sensor_object, lifted)
        )
        assert refined.converged
        assert problem.measure_error_m(candidate) > 0.8e-3
        assert problem.measure_error_m(refined) < 0.1e-3
        np.testing.assert_allclose(refined.T_sensor_object, same.T_sensor_object, atol=1e-6)
