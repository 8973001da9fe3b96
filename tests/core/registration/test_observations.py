"""The image of a touch: the nearest contact of each pixel, and the least height in each square of pixels."""

import numpy as np
import pytest

from tactile_loc import ContactShape, SensorGeometry, Touch
from tactile_loc.core.registration.observations import MILLI, observe

CAMERA = SensorGeometry("pinhole", 31, 23, 60.0, 58.0, 15.5, 11.5, 0.02, 0.002)


def test_a_square_shows_its_least_contact_or_the_gel_and_the_nearest_contact():
    depth_m = np.full(CAMERA.shape, 0.001, np.float32)
    depth_m[10:14, 5:9] = np.random.default_rng(1).uniform(0, 9e-4, (4, 4))
    touch = Touch(ContactShape(depth_m, 0.001), CAMERA)
    seen = observe([touch], max(CAMERA.shape), 100, 3e-5, 1e-3, 1e-6)
    image = seen.images.reshape(*seen.sizes[0], 3)
    points_mm = touch.geometry.backproject(depth_m + touch.geometry.standoff_m) * MILLI
    for row, column in [(9, 4), (10, 5), (12, 7), (13, 8)]:
        assert image[row, column, 0] == pytest.approx(points_mm[row : row + 2, column : column + 2, 2].min(), abs=1e-5)
    assert image[3, 20, 0] == pytest.approx(-MILLI * touch.geometry.surface_m, abs=1e-5), "the gel, negated"
    np.testing.assert_allclose(image[11, 6, 1:], points_mm[11, 6, :2], atol=1e-5)
    np.testing.assert_allclose(image[2, 20, 1:], points_mm[10, 8, :2], atol=1e-5, err_msg="the nearest corner")


def test_nothing_is_nearest_if_thinning_leaves_no_contact():
    depth_m = np.full(CAMERA.shape, 0.001, np.float32)
    depth_m[11, 11] = 0
    images = observe([Touch(ContactShape(depth_m, 0.001), CAMERA)], 15, 100, 3e-5, 1e-3, 1e-6).images
    assert np.isinf(images[:, 1:]).all()
    assert (images[:, 0] < 0).all()
