"""Depth maps and contact masks: what their values mean, their units, and maps with the opposite meaning."""

import logging
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.runtime.errors import TouchError, advise_choice
from tactile_loc.core.sensing.gel import Gel

logger = logging.getLogger(__name__)

DepthKind = Literal["distance", "indentation", "height"]
DepthUnit = Literal["m", "mm", "um"]
TouchKind = Literal["distance", "indentation", "height", "mask"]  # a mask has no depths: see `Touch.from_mask`
MASK: TouchKind = "mask"
KINDS: tuple[DepthKind, ...] = get_args(DepthKind)
METRES_PER_UNIT: dict[DepthUnit, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
OPPOSITE: dict[DepthKind, DepthKind] = {"distance": "indentation", "indentation": "distance"}

LEAST_PRESS_M = 1e-5  # no gel shows a smaller press; such a number has another unit
LEVEL = 0.05  # depths within this share of the range count as equal to the least depth
MOST_DEEPEST, MOST_BORDER = 0.3, 0.5  # shares of the image and of its border that a real touch presses in deepest
MOST_DIMPLE = 0.5  # depth, share of a given press depth, of a dimple in a flat face that fills the image
TOP, FLAT_TOP = 0.01, 0.2  # the largest depths, share of the range; least share of such depths in a hole's lower half


def require_kind(kind: str, name: str, kinds: Sequence[str] = KINDS) -> None:
    """Raise TouchError if a touch called `name` has none of the `kinds`, by default those of depth maps."""
    if kind not in kinds:
        raise TouchError(f"there is no kind {kind!r}, which {name} should have; {advise_choice(kind, kinds)}")


def find_indentation(values: NDArray[Any], kind: DepthKind, gel: Gel) -> Floats:
    """Return how far a gel is pressed in, metres (H, W), and 0 where it is not.

    `values` (H, W), metres, are indentations, or heights, which are negative where the gel is pressed in. No gel is
    pulled out. So the largest value of the wrong sign is the noise, and less indentation in a rigid gel is none. An
    elastic gel bulges beside the contact; all its indentations are kept. NaN is 0.
    """
    indentation = np.nan_to_num(-values if kind == "height" else values, nan=0.0, posinf=0.0, neginf=0.0)
    noise = 0.0 if gel.is_elastic else max(0.0, -float(indentation.min(initial=0.0)))
    return np.where(indentation > noise, indentation, 0.0)


def require_numbers(values: NDArray[Any], name: str) -> NDArray[Any]:
    """Return an array if it is (H, W) numbers. Raises TouchError otherwise."""
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fiu":
        raise TouchError(
            f"{name} is an array of shape {values.shape} and type {values.dtype}; a contact shape is (H, W) numbers, "
            "depth from full penetration"
        )
    return values


def require_in_range(press_depth_m: float, max_depth_m: float, name: str) -> None:
    """Raise TouchError if a press depth is beyond the sensor's range, or so small that its unit is wrong."""
    if not LEAST_PRESS_M <= press_depth_m <= max_depth_m * (1 + 1e-6):
        raise TouchError(
            f"{name} has a press depth of {press_depth_m * 1e3:.6g} mm, but the sensor's range is "
            f"{LEAST_PRESS_M * 1e3:g} to {max_depth_m * 1e3:.6g} mm; choose the sensor that took it, or check the unit"
        )


def refuse_opposite(depth_m: Float32, press_depth_m: float | None, name: str, kind: DepthKind, option: str) -> None:
    """Raise TouchError if contact depths (H, W), metres, have the opposite meaning; log a warning if they may have it.

    In a map with the opposite meaning, the untouched gel has the deepest level, which covers much of the image and most
    of its border. It is also so if a flat face fills the image except for a hole. Then many pixels in the upper half
    have the largest depth, but also those of a flat tip in a map with the opposite meaning. If the largest depth is
    much less than the given press depth, the shape is in contact everywhere, so it is right.
    """
    range_m, highest_m = np.ptp(depth_m), depth_m.max()
    if range_m == 0 or (press_depth_m is not None and highest_m < MOST_DIMPLE * press_depth_m):
        return
    deepest = depth_m <= depth_m.min() + LEVEL * range_m
    border = np.concatenate([deepest[0], deepest[-1], deepest[1:-1, 0], deepest[1:-1, -1]])
    if deepest.mean() <= MOST_DEEPEST or border.mean() <= MOST_BORDER:
        return
    other = OPPOSITE[kind]
    meanings = {"distance": "distances from full penetration", "indentation": "indentations (0 = no contact)"}
    finding = f"{name} is deepest around the border of the image, so its values may be {meanings[other]}"
    top, upper = (np.count_nonzero(highest_m - depth_m <= share * range_m) for share in (TOP, 0.5))
    if top >= FLAT_TOP * upper:
        logger.warning("%s; if so, use %s", finding, option.format(other))
        return
    raise TouchError(
        f"{finding}; if so, use {option.format(other)}, and if the object does touch around the border, give the "
        "press depth"
    )


def reaches(depth_m: Float32, limit_m: float) -> Bools:
    """Return which depths reach a limit, with a tolerance for rounding in unit conversions."""
    return depth_m >= np.float32(limit_m) * (1 - 1e-6)


def find_deepest_step(depth_m: Float32, max_depth_m: float) -> float:
    """Return the press depth, metres, of contact depths (H, W): see `contact_shape_from_array`."""
    contact = depth_m[~reaches(depth_m, max_depth_m)]
    deepest = float(contact.max(initial=0.0))
    if contact.size == depth_m.size and np.ptp(depth_m) > 0.1 * max_depth_m:
        return deepest
    return min(max_depth_m, max(1.0001 * deepest, 0.25 * max_depth_m))


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


def find_contact(mask: NDArray[Any], name: str) -> Bools:
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
