"""The preparation of a localizer: the presses to build, and examples that compile and load what later calls need."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.places.places import PRESS_STEP_M
from tactile_loc.core.poses.priors import GaussianPrior
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.touch import Touch

TOUCHES = 4  # simulated touches of each sensor
AWAY = make_transform(rotation_about([0.0, 0.6, 0.8], 0.2), [4e-3, 3e-3, 0.0])  # error of a wrong sensor pose
STD_M, STD_RAD = 2e-3, 0.1  # standard deviations of a prior


def list_presses(deepest_m: float, trained: bool) -> list[float]:
    """Return the press depths, metres, at which touches are compared, the lightest last, because it is used most.

    Banks of a trained encoder take long, so that only the deepest is prepared.
    """
    if trained:
        return [deepest_m]
    return [deepest_m, *(PRESS_STEP_M * np.arange(int(deepest_m / PRESS_STEP_M), 0, -1)).tolist()]


def list_examples(touches: Sequence[Touch], masks: bool) -> Iterator[tuple[list[Touch], dict[str, Any]]]:
    """Yield touches to locate together, and further arguments: all kinds of input that need code of their own.

    Contact masks are among them if `masks` is set.
    """
    first, *others = touches
    for count in range(1, len(touches) + 1):
        yield list(touches[:count]), {}
    yield [first, *others[:-1], replace(others[-1], T_base_sensor=np.asarray(others[-1].T_base_sensor) @ AWAY)], {}
    yield [first, others[0]], {"prior": GaussianPrior(np.asarray(first.T_sensor_object), STD_M, STD_RAD)}
    if not masks:
        return
    with suppress(TouchError):  # masks are located with a rigid gel only
        mask = Touch.from_mask(first.contact_shape.contact, sensor=first.geometry, T_base_sensor=first.T_base_sensor)
        yield [mask, others[0]], {}
