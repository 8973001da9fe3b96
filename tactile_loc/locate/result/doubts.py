"""Doubts about a result, shown as warnings on the terminal, in reports and in tables of many touches."""

import numpy as np

from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict

FITS = 0.7  # a touch whose best imprint IoU with any pose is lower fits no pose
WRONG_PRESS = 0.15  # share of the press by which a wrongly stated press differs at least
LEAST_PRESS_M = 3e-5
UNEXPECTED = "the prior contradicts the touches"
CHECK_PRIOR = "check the prior's unit, frame and standard deviations"


def list_doubts(found: Localization) -> list[str]:
    """Return the reasons why a result may be wrong, one sentence each; empty if there are none.

    The last sentence names the likely cause, unless the result only lacks touches that were left out.
    """
    said = [*_list_contradictions(found), *_list_unexplained(found)]
    left_out = [f"{touch.name} contradicts the other touches and was left out" for touch in found.left_out]
    if found.unexpected:
        better = "poses that it makes very improbable explain them better"
        return [*left_out, *said, f"{UNEXPECTED}: {better}; {CHECK_PRIOR}, or locate the touches without it"]
    if not said and found.verdict is Verdict.CERTAIN:
        return left_out
    if not said and len(found.touches) > 1 and (pressed := _find_wrong_press(found)):
        return [*left_out, _name_press(pressed)]
    return [*left_out, *said[:-1], *(f"{sentence}; {name_likely_cause(found)}" for sentence in said[-1:])]


def name_likely_cause(found: Localization) -> str:
    """Return in words what to check if the first pose explains touches poorly, from what remains unexplained."""
    if found.unexpected:
        return f"{UNEXPECTED}: {CHECK_PRIOR}"
    if pressed := _find_wrong_press(found):
        return _name_press(pressed)
    if len(found.touches) == 1:
        return "check the object, the sensor, the unit and the press of the touch"
    if found.agreement.outliers:
        return "the object moved meanwhile, a T_base_sensor is wrong, or these touches are of another part"
    if unfit := _list_unfit(found):
        return f"{', '.join(unfit)} fit no pose: the mesh, its unit or the sensor may be wrong"
    return (
        "each touch fits a pose, but no pose fits all: the object moved meanwhile, a T_base_sensor is wrong, or the "
        "images are mirrored"
    )


def _name_press(pressed: str) -> str:
    return f"the touches fit a {pressed} press: check the press depth, the unit, and the zero level of the images"


def _list_unexplained(found: Localization) -> list[str]:
    """Return the touches that the first pose explains too poorly; without a pose, those that fit no pose."""
    if not found.best.is_refined or not found.touches[0].has_depths:
        return []
    if found.poor_touches:
        fits = [(found.touches[k].name, 100 * found.best.imprint_ious[k]) for k in found.poor_touches]
        names = ", ".join(f"{name} ({percent:.0f} %)" for name, percent in fits)
        return [
            f"the best pose explains {names} worse than right poses do (imprint IoU in brackets), and is probably wrong"
        ]
    if found.verdict is Verdict.NOT_FOUND and _list_unfit(found):
        return ["the search found no pose that explains all touches"]
    return []


def _list_unfit(found: Localization) -> list[str]:
    """Return the names of the touches that no pose explains, of several."""
    best = found.agreement.best_ious
    return [touch.name for touch, iou in zip(found.touches, best, strict=False) if iou < FITS]


def _find_wrong_press(found: Localization) -> str:
    """Return whether the touches seem to be pressed "deeper" or "lighter" than stated; empty if that is not clear.

    A touch that the first pose does not meet shows nothing about the press. Of several touches, two must show it.
    """
    if found.evidence is None:
        return ""
    off_m = found.evidence.press_m
    known_m = off_m[off_m != 0]
    pressed_m = np.mean([touch.indentation_m for touch in found.touches])
    alike = len(known_m) >= min(2, len(found.touches)) and abs(np.sign(known_m).sum()) == len(known_m)
    clear = alike and np.abs(known_m).min() > max(WRONG_PRESS * pressed_m, LEAST_PRESS_M)
    return "" if not clear else "deeper" if known_m[0] > 0 else "lighter"


def _list_contradictions(found: Localization) -> list[str]:
    touches, ious, agreement = found.touches, found.best.imprint_ious, found.agreement
    fits = [
        f"{touch.name} {100 * iou:.0f} % ({100 * best:.0f} %)"
        for touch, iou, best in zip(touches, ious, agreement.best_ious or ious, strict=False)
    ]
    if outliers := [fits[number] for number in agreement.outliers]:
        return [
            f"{len(touches) - len(outliers)} of {len(touches)} touches agree on a pose; imprint IoU of this pose (and "
            f"of another pose) for the others: {', '.join(outliers)}"
        ]
    if agreement.contradictory:
        return ["no pose explains all touches; imprint IoU of the best pose (and of another pose): " + ", ".join(fits)]
    return []
