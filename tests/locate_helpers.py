"""Helpers of the tests that locate touches: examples from another renderer, and the errors of poses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactile_loc import Localization, Localizer, PoseMetric, RobotTouches, Touch, localize_together
from tactile_loc.core.sensing.noise import TouchNoise, make_noise
from tactile_loc.plugin import registry

NONE = make_noise("none")


def draw_examples(
    localizer: Localizer, seed: int, count: int, touches: int = 3, noise: TouchNoise = NONE
) -> list[list[Touch]]:
    """Return touches of an object at rest, pressed from anywhere and rendered by ray casting, for each example."""
    renderer = registry().create("renderer", "zbuffer", {})
    source = RobotTouches(localizer.object, localizer.scene.geometry, renderer, noise=noise)
    return [source.draw_example(touches, np.random.default_rng([seed, k]))[0] for k in range(count)]


def locate_together(localizer: Localizer, touches: Sequence[Touch], **settings: Any) -> Localization:
    """Locate touches of one sensor together."""
    return localize_together([(localizer, touch) for touch in touches], **settings)


def measure_errors_mm(localizer: Localizer, poses: np.ndarray, touch: Touch) -> np.ndarray:
    """Return the errors (K,), mm, of poses (K, 4, 4), metres, in the frame of a touch of known pose."""
    truth = np.broadcast_to(np.asarray(touch.T_sensor_object), poses.shape)
    return 1e3 * PoseMetric(localizer.object).symmetric_distance(poses, truth)


def list_poses(found: Localization) -> np.ndarray:
    """Return the poses (K, 4, 4), metres, of a result's hypotheses."""
    return np.stack([h.T_sensor_object for h in found.hypotheses])
