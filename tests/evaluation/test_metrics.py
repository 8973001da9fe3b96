"""The metrics of an answer, against values known by hand."""

import dataclasses

import numpy as np
import pytest

from tactile_loc.evaluation.metrics import METRICS, PoseJudge
from tactile_loc.plugin.helpers import SymmetryGroup, make_transform, rotation_about

TRUE_POSE = make_transform(rotation_about([1, 2, 3], 0.7), [0.01, 0.02, 0.03])


def measure_mm(obj, *moves) -> dict[str, np.ndarray]:
    """Return each of the METRICS, mm, of the true pose after moves (4, 4) of the object."""
    return dict(
        zip(METRICS, 1e3 * PoseJudge(obj).measure_errors(TRUE_POSE @ np.stack(moves), TRUE_POSE).T, strict=True)
    )


def test_all_metrics_of_the_true_pose_and_its_equivalents_are_zero(cylinder):
    found = measure_mm(cylinder, np.eye(4), cylinder.symmetry.list_elements(0.1)[7])
    assert found["mssd"] == pytest.approx(0, abs=1e-3)
    assert found["add"] == pytest.approx(0, abs=1e-3)
    assert found["shape"] == pytest.approx(0, abs=0.02)  # between the flat faces of the mesh


def test_a_turned_shaft_has_its_shape_in_place_but_a_wrong_pose(cylinder):
    """As if a flat that the mesh does not show told the turns apart."""
    shaft = dataclasses.replace(cylinder, symmetry=SymmetryGroup.parse("none", cylinder.mesh.centroid_m))
    found = measure_mm(shaft, make_transform(rotation_about([0, 0, 1], 0.5), np.zeros(3)))
    assert found["shape"] < 0.1
    assert found["mssd"] > 1
