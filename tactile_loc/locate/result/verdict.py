"""The verdict on a located touch: one word with the same meaning in runs, tracks, live frames, recordings and ROS."""

from dataclasses import dataclass
from enum import StrEnum

from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.io.options import CERTAIN

MOSTLY_ELSEWHERE = 0.5  # a greater probability of "elsewhere" means that the pose was not found


class Verdict(StrEnum):
    """How far to trust the first pose."""

    CERTAIN = "certain"
    AMBIGUOUS = "ambiguous"
    POOR_FIT = "poor fit"
    NOT_FOUND = "not found"
    NO_CONTACT = "no contact"


@dataclass(frozen=True)
class Outcome:
    """The probabilities, 0 to 1, that the first pose is `right`, that `another` pose found is, and that none is.

    Right is within the tolerance of the true pose.
    """

    right: float
    another: float
    missed: float


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

    `probability`, 0 to 1, is None if it is unknown. Returns an empty text then, and if the verdict makes it misleading.
    """
    if probability is None or (verdict is not None and verdict not in STATES_PROBABILITY):
        return ""
    return f"within {tolerance.describe()} with {format_percent(probability)} probability"


def judge(outcome: Outcome | None, *, sure: bool = True, poor: bool = False, least: float = CERTAIN) -> Verdict:
    """Return the verdict on the first pose, given a touch.

    The `outcome` has the probability that the first pose is right; None if there is no pose. The pose is a `poor` fit
    if it explains a touch worse than right poses do. Otherwise, it is certain if its probability is at least `least`,
    unless something makes it un`sure`, such as a touch without depths.
    """
    if outcome is None:
        return Verdict.NOT_FOUND
    if poor:
        return Verdict.POOR_FIT
    if sure and outcome.right >= least:
        return Verdict.CERTAIN
    return Verdict.NOT_FOUND if outcome.missed > MOSTLY_ELSEWHERE else Verdict.AMBIGUOUS
