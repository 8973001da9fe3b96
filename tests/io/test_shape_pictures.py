"""Pictures of contact shapes: the colour scale, pixels without contact, and pixels that the sensor does not see."""

import dataclasses

import numpy as np

from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.io.shape_pictures import DEPTHS, NO_CONTACT, UNSEEN, paint_shape, read_colour
from tactile_loc.slots.registry import registry


def test_the_scale_runs_from_full_penetration_to_the_press_depth():
    geometry = registry().create("sensor", "gelsight-mini", {}).geometry.resize_long_side(40)
    observed = np.ones(geometry.shape, bool)
    observed[0, 0] = False
    depth = np.full(geometry.shape, 1e-3, np.float32)
    depth[2, 2], depth[2, 3], depth[2, 4] = 0.0, 5e-4, 0.999e-3
    picture = paint_shape(ContactShape(depth, 1e-3), dataclasses.replace(geometry, observed=observed))
    assert picture.shape == (*geometry.shape, 3)
    assert tuple(picture[0, 0]) == read_colour(UNSEEN)
    assert tuple(picture[5, 5]) == read_colour(NO_CONTACT)
    assert tuple(picture[2, 2]) == read_colour(DEPTHS[0])
    assert tuple(picture[2, 3]) == read_colour(DEPTHS[2])
    np.testing.assert_allclose(picture[2, 4], read_colour(DEPTHS[-1]), atol=2)
