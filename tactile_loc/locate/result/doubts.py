"""Doubts about a result, shown as warnings on the terminal, in reports and in tables of many touches."""

from __future__ import annotations

import numpy as np

from tactile_loc.locate.result.localization import Localization

MOVED = 0.1  # a touch that another pose explains better by this imprint IoU may have been taken after a motion
WRONG_PRESS = 0.15  # share of the press by which a wrongly stated press differs at least
LEAST_PRESS_M = 3e-5


def list_doubts(found: Localization) -> list[str]:
    """Return the reasons why a result may be wrong, one sentence each; empty if there are none."""
    return [*_list_contradictions(found), *_list_unexplained(found), *_list_unexpected(found)]


def _list_unexplained(found: Localization) -> list[str]:
    if not found.poor_touches or not found.best.is_refined:
        return []
    fits = [(found.touches[k].name, 100 * found.best.imprint_ious[k]) for k in found.poor_touches]
    names = ", ".join(f"{name} ({percent:.0f} %)" for name, percent in fits)
    return [
        f"the best pose explains {names} worse than right poses do (imprint IoU in brackets), and is probably wrong; "
        f"{name_likely_cause(found)}"
    ]


def name_likely_cause(found: Localization) -> str:
    """Return in words what to check if the first pose explains touches poorly, from what remains unexplained."""
    if found.unexpected:
        return "the prior contradicts the touches: check its unit, frame and standard deviations"
    if pressed := _find_wrong_press(found):
        return f"the touches fit a {pressed} press: check the press depth, the unit, and the sensor's depth"
    best, here = np.array(found.agreement.best_ious), np.array(found.best.imprint_ious)
    if len(found.touches) > 1 and len(best) == len(here) and (best - here).max() > MOVED:
        return "other poses explain single touches better: the object moved meanwhile, or a T_base_sensor is wrong"
    if len(found.touches) > 1:
        return "check each T_base_sensor, the object, the sensor and the unit of these touches"
    return "check the object, the sensor, the unit and the press of the touch"


def _find_wrong_press(found: Localization) -> str:
    """Return whether the touches seem to be pressed "deeper" or "lighter" than stated; empty if that is not clear."""
    if found.evidence is None:
        return ""
    off_m = found.evidence.press_m
    pressed_m = np.mean([touch.indentation_m for touch in found.touches])
    alike = abs(np.sign(off_m).sum()) == len(off_m)
    clear = alike and np.abs(off_m).min() > max(WRONG_PRESS * pressed_m, LEAST_PRESS_M)
    return "" if not clear else "deeper" if off_m[0] > 0 else "lighter"


def _list_unexpected(found: Localization) -> list[str]:
    if not found.unexpected:
        return []
    return [
        "the prior contradicts the touches: poses that it makes very improbable explain them better; check the prior's "
        "unit, frame and standard deviations, or locate the touches without it"
    ]


def _list_contradictions(found: Localization) -> list[str]:
    touches, ious, agreement = found.touches, found.best.imprint_ious, found.agreement
    fits = [
        f"{touch.name} {100 * iou:.0f} % ({100 * best:.0f} %)"
        for touch, iou, best in zip(touches, ious, agreement.best_ious or ious, strict=False)
    ]
    outliers = [fits[number] for number in agreement.outliers]
    said = [f"{touch.name} contradicts the other touches and was left out" for touch in found.left_out]
    if outliers:
        said.append(
            f"{len(touches) - len(outliers)} of {len(touches)} touches agree on a pose; imprint IoU of this pose (and "
            f"of another pose) for the others: {', '.join(outliers)}. Check T_base_sensor and the object of these "
            "touches"
        )
    elif agreement.contradictory:
        said.append(
            f"no pose explains all touches; imprint IoU of the best pose (and of another pose): {', '.join(fits)}. "
            "Check each T_base_sensor, and that each touch is of this object"
        )
    return said
