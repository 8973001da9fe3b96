"""Simulated touches: random contact poses and the clean contact shapes they make."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.errors import TouchError
from tactile_loc.core.grids import random_contact_poses
from tactile_loc.core.interfaces import GridSampler
from tactile_loc.core.scene import Scene
from tactile_loc.core.sensing import ContactShape, Touch

MOST_ROUNDS = 200  # of drawing what is missing


def simulate_touches(
    sampler: GridSampler, scene: Scene, count: int, rng: np.random.Generator, press_depth_m: float | None = None
) -> list[Touch]:
    """Make `count` touches with known poses, pressed `press_depth_m` metres deep (by default the sensor's deepest).

    Raises TouchError for a press beyond the sensor's range or one that hardly ever leaves an imprint, GridError when
    the object hardly ever touches.
    """
    deepest = scene.geometry.max_depth_m
    press = deepest if press_depth_m is None else press_depth_m
    if not 0 < press <= deepest:
        raise TouchError(
            f"a press of {press * 1e3:.3g} mm is outside the sensor's range of 0 to {deepest * 1e3:.3g} mm"
        )
    touches: list[Touch] = []
    rounds = 0
    while len(touches) < count:
        if rounds == MOST_ROUNDS:
            raise TouchError(
                f"hardly any press of {scene.object.name} by {press * 1e3:.3g} mm leaves an imprint with an edge or a "
                "feature; press deeper or choose another face"
            )
        rounds += 1
        poses = random_contact_poses(sampler, scene, count - len(touches), rng)
        for T, depth in zip(poses, scene.contact_depths(poses, press), strict=True):
            touch = _touch(depth, press, scene, T, f"touch-{len(touches):04d}")
            touches += [touch] if touch is not None else []
    return touches


def _touch(depth: np.ndarray, press_m: float, scene: Scene, T: np.ndarray, name: str) -> Touch | None:
    """One touch, or None where the imprint is no touch: nothing but a flat face all over the sensor."""
    try:
        return Touch(ContactShape(depth, press_m), scene.geometry, name, T_sensor_object=T)
    except TouchError:
        return None
