"""The next step after a localisation, in words: where to touch again, relative to the touch just made."""

from collections.abc import Iterator

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, make_translation
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict, name_next_step
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.tracking.pose_modes import PoseModes

SHIFTS_MM = (5, 10, 20)
BACK_MM = 20  # the sensor starts this far back along its z axis
SIDES = {"+x": (1, 0), "-x": (-1, 0), "+y": (0, 1), "-y": (0, -1)}
LEAST_NATS = 0.05  # a touch with less expected information is not worth naming


def suggest_next_step(found: Localization) -> str:
    """Return what to do next, in words; empty if the verdict is certain.

    For an ambiguous result, presses beside the first touch are compared, with the sensor in the same orientation. The
    press with the greatest information gain is named, such as "touch again, 10 mm from this touch toward +x of the
    sensor". If none helps, or for other verdicts, the step is the verdict's.
    """
    plain = name_next_step(found.verdict, len(found.touches))
    if found.verdict is not Verdict.AMBIGUOUS:
        return plain
    try:
        best = choose_next_touch(PoseModes.of(found), list(list_shifted(found))).best
    except ConfigError:  # every press starts inside the object
        return plain
    if best.information < LEAST_NATS:
        return plain
    return f"touch again, {best.approach.name} of the sensor, and locate the touches together"


def list_shifted(found: Localization) -> Iterator[Approach]:
    """Yield presses beside the first touch, named by their distance and direction from it."""
    T = found.touch.T_base_sensor
    T_base_sensor: Floats = np.eye(4) if T is None else np.asarray(T)
    for name, (x, y) in SIDES.items():
        for mm in SHIFTS_MM:
            shift_m = 1e-3 * np.array([x * mm, y * mm, -BACK_MM])
            yield Approach(T_base_sensor @ make_translation(shift_m), name=f"{mm} mm from this touch toward {name}")
