"""Refiners of clouds undo a known offset of a candidate from the true pose."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.slots.registry import registry


@pytest.mark.parametrize(("name", "library"), [("icp", "open3d"), ("filterreg", "numba"), ("kiss-icp", "kiss_icp")])
def test_a_known_offset_is_undone(pin_scene, pin_touches, off_by, error_mm, name, library):
    pytest.importorskip(library)
    refiner = registry().create("refiner", name)
    errors, before = [], []
    for i, touch in enumerate(pin_touches):
        candidate = off_by(touch, 1.0, 3.0, float(i))
        refined = refiner.refine(touch, candidate, pin_scene)
        assert is_rigid(refined.T_sensor_object)
        assert refined.converged
        errors.append(error_mm(touch, refined.T_sensor_object))
        before.append(error_mm(touch, candidate.T_sensor_object))
    assert min(before) > 0.9
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5 * min(before)
