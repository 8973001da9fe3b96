"""The touches of an evaluation are always the same."""

import numpy as np
import pytest

from tactile_loc import Localizer
from tactile_loc.evaluation.simulated_touches import SimulatedTouches


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, grid={"name": "face", "spacing_mm": 8}, refiner="none")


def test_equal_seeds_give_equal_touches_and_other_seeds_give_other_touches(localizer):
    first, again = (SimulatedTouches(seed=3).draw_touch(localizer, 2) for _ in range(2))
    assert first.name == again.name == "touch-0002"
    np.testing.assert_array_equal(first.contact_shape.depth_m, again.contact_shape.depth_m)
    np.testing.assert_array_equal(first.T_sensor_object, again.T_sensor_object)
    other = SimulatedTouches(seed=4).draw_touch(localizer, 2)
    assert not np.allclose(first.T_sensor_object, other.T_sensor_object)
