"""The distance between touches: shifts of the gel, and rotations by a lever."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.tracking.key_touches import measure_motion_m

LEVER_M = 1e-2


def test_a_rotation_counts_as_the_motion_of_a_lever():
    turned = make_transform(rotation_about([0, 0, 1], 0.2), [0.0, 0.0, 0.0])
    assert measure_motion_m(np.eye(4), turned, np.zeros(3), LEVER_M) == pytest.approx(0.2 * LEVER_M)
    assert measure_motion_m(np.eye(4), make_translation([3e-3, 0, 4e-3]), np.zeros(3), LEVER_M) == pytest.approx(5e-3)
    gel_m = np.array([0.05, 0.0, 0.0])  # the gel moves, although the origin does not
    assert measure_motion_m(np.eye(4), turned, gel_m, 0.0) == pytest.approx(2 * 0.05 * np.sin(0.1))
