"""Key touches: a few touches of a sequence, at sensor poses far apart."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert, rotation_angle
from tactile_loc.core.sensing.touch import Touch

Floats = NDArray[np.float64]

WIDER = 1.5  # growth of the least distance while there are too many key touches


def measure_motion_m(T_base_first: Floats, T_base_second: Floats, gel_m: Floats, lever_m: float) -> float:
    """Return the distance that the point `gel_m` (3,), metres, of a sensor moved between two poses (4, 4), metres.

    A rotation counts as the motion at the end of a lever of `lever_m` metres.
    """
    T = invert(T_base_first) @ T_base_second
    shift_m = np.linalg.norm(T[:3, :3] @ gel_m + T[:3, 3] - gel_m)
    return float(shift_m + lever_m * rotation_angle(T[:3, :3]))


def choose_key_touches(touches: Iterable[Touch], most: int, apart_m: float, lever_m: float) -> list[Touch]:
    """Return at most `most` touches, in order, whose sensor poses are at least `apart_m` metres apart.

    Of touches nearer to each other, the one with more contact is kept. The touches need sensor poses. They are read
    once, so they may come from a long recording.
    """
    kept: list[Touch] = []
    for touch in touches:
        kept = _add(kept, touch, apart_m, lever_m)
        while len(kept) > 3 * most:
            apart_m *= WIDER
            kept = _thin(kept, apart_m, lever_m)
    while len(kept) > most:
        apart_m *= WIDER
        kept = _thin(kept, apart_m, lever_m)
    return kept


def drop_nearest(touches: Sequence[Touch], lever_m: float) -> list[Touch]:
    """Return touches without one of the two whose sensor poses are nearest to each other: the one with less contact."""
    gel_m, poses = touches[0].geometry.gel_middle_m, [np.asarray(touch.T_base_sensor) for touch in touches]
    nearest = min(
        itertools.combinations(range(len(touches)), 2),
        key=lambda pair: measure_motion_m(poses[pair[0]], poses[pair[1]], gel_m, lever_m),
    )
    less = min(nearest, key=lambda number: _measure_contact(touches[number]))
    return [touch for number, touch in enumerate(touches) if number != less]


def _thin(touches: list[Touch], apart_m: float, lever_m: float) -> list[Touch]:
    kept: list[Touch] = []
    for touch in touches:
        kept = _add(kept, touch, apart_m, lever_m)
    return kept


def _add(kept: list[Touch], touch: Touch, apart_m: float, lever_m: float) -> list[Touch]:
    """Return the touches with another one, unless a near one has as much contact; nearer ones with less are dropped."""
    gel_m = touch.geometry.gel_middle_m
    near = [
        one
        for one in kept
        if measure_motion_m(np.asarray(one.T_base_sensor), np.asarray(touch.T_base_sensor), gel_m, lever_m) < apart_m
    ]
    if any(_measure_contact(one) >= _measure_contact(touch) for one in near):
        return kept
    return [*(one for one in kept if all(one is not other for other in near)), touch]


def _measure_contact(touch: Touch) -> int:
    return int(touch.contact_shape.contact.sum())
