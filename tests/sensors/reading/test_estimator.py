"""An estimator's input features."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.reading.estimator import (
    COLOUR_STEP,
    FIXED,
    PLANES,
    scale_difference,
    stack_features,
    stack_fixed_features,
)

WIDE = SensorGeometry("orthographic", 80, 64, 4000.0, 4000.0, 40.0, 32.0, 0.01, 1.5e-3)


def test_fixed_features_are_scaled_and_oriented():
    gel = np.zeros((64, 80, 3), np.uint8)
    gel[..., 0] = 255
    fixed = stack_fixed_features(gel, WIDE)
    assert fixed.shape == (64, 80, FIXED)
    np.testing.assert_allclose(fixed[..., :3], np.broadcast_to([1, -1, -1], (64, 80, 3)), atol=1e-6)
    np.testing.assert_allclose(fixed[[0, 63], :, 4], [[-1] * 80, [1] * 80])
    np.testing.assert_allclose(fixed[:, [0, 79], 3], [[-1, 1]] * 64)


def test_features_of_a_crop_equal_those_of_the_whole_image():
    rng = np.random.default_rng(0)
    image, gel = (rng.integers(0, 256, (64, 80, 3), dtype=np.uint8) for _ in range(2))
    difference = scale_difference(image, gel)
    assert difference[3, 5, 1] == (int(image[3, 5, 1]) - int(gel[3, 5, 1])) / COLOUR_STEP
    fixed, part = stack_fixed_features(gel, WIDE), np.s_[10:20, 30:50]
    whole = stack_features(image, gel, fixed)
    assert whole.shape == (64, 80, PLANES)
    np.testing.assert_array_equal(stack_features(image[part], gel[part], fixed[part]), whole[part])
