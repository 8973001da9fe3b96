"""The verdict on a located touch: one word with the same meaning in runs, tracks, live frames, recordings and ROS."""

from __future__ import annotations

import math
from enum import StrEnum

from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.io.options import CERTAIN

LEAST_IOU = 0.5  # imprint IoU of one touch: below it, 1 of 83 simulated touches had the right pose
MOSTLY_ELSEWHERE = 0.5  # a greater probability of "elsewhere" means that the pose was not found


class Verdict(StrEnum):
    """How far to trust the first pose."""

    CERTAIN = "certain"
    AMBIGUOUS = "ambiguous"
    POOR_FIT = "poor fit"
    NOT_FOUND = "not found"
    NO_CONTACT = "no contact"


NEXT_STEPS = {
    Verdict.CERTAIN: "",
    Verdict.AMBIGUOUS: "touch again at another place, best at an edge or a corner, and locate the touches together",
    Verdict.POOR_FIT: "check the object, the sensor and the unit of the touch; then touch again",
    Verdict.NOT_FOUND: "touch again at another place, deeper if the gel allows, and locate the touches together",
    Verdict.NO_CONTACT: "press the sensor onto the object",
}
CHECK_SENSOR_POSES = "check each T_base_sensor, the object, the sensors and the unit of the touches; then touch again"
STATES_PROBABILITY = (Verdict.CERTAIN, Verdict.AMBIGUOUS)  # beside other verdicts, the probability misleads
REFUSED = "refused"  # for a frame that cannot be read, which has no verdict
MEANINGS = {
    Verdict.CERTAIN: "the first pose explains the touch and is probable enough to act on",
    Verdict.AMBIGUOUS: "several poses explain the touch; the first is not certain",
    Verdict.POOR_FIT: "the first pose does not explain the touch",
    Verdict.NOT_FOUND: "the search found no pose, or the pose is more likely one that the search missed",
    Verdict.NO_CONTACT: "nothing touches the sensor",
}


def name_verdict(verdict: Verdict | None) -> str:
    """Return the verdict's word, or "refused" if there is no verdict."""
    return REFUSED if verdict is None else verdict.value


def explain_verdict(verdict: Verdict | None) -> str:
    """Return the meaning of a verdict, or of its absence."""
    return "the frame cannot be read" if verdict is None else MEANINGS[verdict]


def name_next_step(verdict: Verdict, touches: int) -> str:
    """Return what to do next after locating a number of touches together; empty if the verdict is certain.

    If several touches fit poorly, the sensor poses may be wrong, so the step names them first.
    """
    return CHECK_SENSOR_POSES if verdict is Verdict.POOR_FIT and touches > 1 else NEXT_STEPS[verdict]


def describe_within(verdict: Verdict | None, probability: float | None, tolerance: Tolerance) -> str:
    """Return in words how probable it is that the first pose is within the tolerance.

    `probability`, 0 to 1, is None if it is unknown. Returns an empty text if it is unknown and the verdict is not
    certain, or if the verdict makes it misleading.
    """
    if verdict is not None and verdict not in STATES_PROBABILITY:
        return ""
    if probability is None and verdict is not Verdict.CERTAIN:
        return ""
    stated = f"at least {format_percent(CERTAIN)}" if probability is None else format_percent(probability)
    return f"within {tolerance.describe()} with {stated} probability"


def judge(
    probability: float | None,
    imprint_iou: float = math.nan,
    elsewhere: float = 0.0,
    *,
    touched: bool = True,
    certain: float = CERTAIN,
    least_iou: float = LEAST_IOU,
    depths_known: bool = True,
) -> Verdict:
    """Return the verdict on the first pose.

    `probability`, 0 to 1, is that the first pose is right; None if there is no pose. `imprint_iou`, 0 to 1, states how
    well the first pose explains the touch; NaN if unknown. `elsewhere`, 0 to 1, is the probability that the search
    missed the true pose. `touched` states whether there is a touch. A pose is certain if its probability is at least
    `certain`, and if the depths of all touches are known. A pose is a poor fit if its imprint IoU is below `least_iou`.
    """
    if not touched:
        return Verdict.NO_CONTACT
    if probability is None:
        return Verdict.NOT_FOUND
    if imprint_iou < least_iou:  # False for NaN
        return Verdict.POOR_FIT
    if probability >= certain and depths_known:
        return Verdict.CERTAIN
    return Verdict.NOT_FOUND if elsewhere > MOSTLY_ELSEWHERE else Verdict.AMBIGUOUS
