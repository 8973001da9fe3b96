"""Depth maps and contact masks: what their values mean, their units, and maps with the opposite meaning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import TouchError, advise_choice
from tactile_loc.core.sensing.gel import Gel

DepthKind = Literal["distance", "indentation", "height"]
DepthUnit = Literal["m", "mm", "um"]
TouchKind = Literal["distance", "indentation", "height", "mask"]  # a mask has no depths: see `Touch.from_mask`
MASK: TouchKind = "mask"
KINDS: tuple[DepthKind, ...] = get_args(DepthKind)
METRES_PER_UNIT: dict[DepthUnit, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
OPPOSITE: dict[DepthKind, DepthKind] = {"distance": "indentation", "indentation": "distance"}

LEVEL = 0.05  # depths within this share of the range count as equal to the least depth
MOST_DEEPEST, MOST_BORDER = 0.3, 0.5  # shares of the image and of its border that a real touch presses in deepest
TOP, FLAT_TOP = 0.01, 0.2  # the largest depths, share of the range; least share of such depths in a hole's lower half


def require_kind(kind: str, name: str, kinds: Sequence[str] = KINDS) -> None:
    """Raise TouchError if a touch called `name` has none of the `kinds`, by default those of depth maps."""
    if kind not in kinds:
        raise TouchError(f"there is no kind {kind!r}, which {name} should have; {advise_choice(kind, kinds)}")


def find_indentation(values: NDArray[Any], kind: DepthKind, gel: Gel) -> NDArray[np.float64]:
    """Return how far a gel is pressed in, metres (H, W), and 0 where it is not.

    `values` (H, W), metres, are indentations, or heights, which are negative where the gel is pressed in. No gel is
    pulled out. So the largest value of the wrong sign is the noise, and less indentation in a rigid gel is none. An
    elastic gel bulges beside the contact; all its indentations are kept. NaN is 0.
    """
    indentation = np.nan_to_num(-values if kind == "height" else values, nan=0.0, posinf=0.0, neginf=0.0)
    noise = 0.0 if gel.is_elastic else max(0.0, -float(indentation.min(initial=0.0)))
    return np.where(indentation > noise, indentation, 0.0)


def is_deepest_around(depth_m: NDArray[np.float32]) -> bool:
    """Return whether the deepest level covers much of contact depths (H, W), metres, and most of their border.

    This is so in maps with the opposite meaning, whose untouched gel has this level. It is also so if a flat face
    fills the image except for a hole.
    """
    deepest = depth_m <= depth_m.min() + LEVEL * np.ptp(depth_m)
    border = np.concatenate([deepest[0], deepest[-1], deepest[1:-1, 0], deepest[1:-1, -1]])
    return bool(np.ptp(depth_m) > 0 and deepest.mean() > MOST_DEEPEST and border.mean() > MOST_BORDER)


def has_flat_top(depth_m: NDArray[np.float32]) -> bool:
    """Return whether many of the pixels in the upper half of (H, W) contact depths have the largest depth.

    This is so if they show the bottom of a hole, and if they show a flat tip in a map with the opposite meaning.
    """
    below_m = depth_m.max() - depth_m
    top, upper = (np.count_nonzero(below_m <= share * np.ptp(depth_m)) for share in (TOP, 0.5))
    return bool(top >= FLAT_TOP * upper)


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
