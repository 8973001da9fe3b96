"""Touches of a sequence at sensor poses far apart."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert, rotation_angle
from tactile_loc.core.sensing.touch import Touch

Floats = NDArray[np.float64]


def measure_motion_m(T_base_first: Floats, T_base_second: Floats, gel_m: Floats, lever_m: float) -> float:
    """Return the distance that the point `gel_m` (3,), metres, of a sensor moved between two poses (4, 4), metres.

    A rotation counts as the motion at the end of a lever of `lever_m` metres.
    """
    T = invert(T_base_first) @ T_base_second
    shift_m = np.linalg.norm(T[:3, :3] @ gel_m + T[:3, 3] - gel_m)
    return float(shift_m + lever_m * rotation_angle(T[:3, :3]))


def drop_nearest(touches: Sequence[Touch], lever_m: float) -> list[Touch]:
    """Return touches without one of the two whose sensor poses are nearest to each other: the one with less contact."""
    gel_m, poses = touches[0].geometry.gel_middle_m, [np.asarray(touch.T_base_sensor) for touch in touches]
    nearest = min(
        itertools.combinations(range(len(touches)), 2),
        key=lambda pair: measure_motion_m(poses[pair[0]], poses[pair[1]], gel_m, lever_m),
    )
    less = min(nearest, key=lambda number: _measure_contact(touches[number]))
    return [touch for number, touch in enumerate(touches) if number != less]


def _measure_contact(touch: Touch) -> int:
    return int(touch.contact_shape.contact.sum())
