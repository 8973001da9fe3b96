"""Contact masks: which pixels touch, without depths. The press is known roughly, or assumed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.gel import Gel

ASSUMED_PRESS, ASSUMED_STD = 0.6, 0.2  # an unknown press and its standard deviation, as shares of the maximal depth
KNOWN_STD = 0.05  # standard deviation of a given press, as a share of it
FULL = 255  # value of contact in 8-bit pictures


def assume_press(
    max_depth_m: float, press_depth_m: float | None = None, press_std_m: float | None = None
) -> tuple[float, float]:
    """Return the press depth of a mask and the standard deviation of its error, both in metres.

    Without a `press_depth_m`, the press is ASSUMED_PRESS of the sensor's maximal depth `max_depth_m`, with the standard
    deviation ASSUMED_STD of it. By default, the standard deviation of a given press is KNOWN_STD of it. Raises
    TouchError if the standard deviation is not positive.
    """
    if press_std_m is not None and not press_std_m > 0:
        raise TouchError(f"the standard deviation of a press is {press_std_m * 1e3:.3g} mm; give more than 0")
    if press_depth_m is None:
        return ASSUMED_PRESS * max_depth_m, press_std_m or ASSUMED_STD * max_depth_m
    return press_depth_m, press_std_m or KNOWN_STD * press_depth_m


def find_contact(mask: NDArray[Any], name: str) -> NDArray[np.bool_]:
    """Return which pixels (H, W) of a mask are in contact.

    The mask is bool, or has two values: 0, and 1 or FULL. Raises TouchError for any other array.
    """
    values = set() if mask.dtype.kind not in "buif" or mask.ndim != 2 else set(np.unique(mask).tolist())
    if not (values and (values <= {0, 1} or values <= {0, FULL})):
        raise TouchError(
            f"{name} is an array of shape {mask.shape} and type {mask.dtype}; a contact mask is (H, W), with True or 1 "
            f"({FULL} in pictures) in contact and 0 elsewhere"
        )
    return np.asarray(mask != 0)


def require_rigid_gel(gel: Gel, name: str) -> None:
    """Raise TouchError if a sensor's gel is elastic, because the depth at the outline is then unknown."""
    if gel.is_elastic:
        raise TouchError(
            f"{name} is a contact mask, and masks are located only with a rigid gel; set the sensor's gel to 'rigid', "
            "or give a depth map"
        )
