"""Doubts about a result, shown as warnings on the terminal, in reports and in tables of many touches."""

from __future__ import annotations

from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import LEAST_IOU

NOT_EXPLAINED = 0.05  # imprint IoU below which a pose explains nothing of a touch


def list_doubts(found: Localization) -> list[str]:
    """Return the reasons why a result may be wrong, one sentence each; empty if there are none."""
    return [*_list_contradictions(found), *_list_unexplained(found), *_list_unexpected(found)]


def _list_unexplained(found: Localization) -> list[str]:
    if found.others:
        return _list_touches_not_explained(found)
    best = found.best
    if not best.is_refined or best.imprint_iou >= LEAST_IOU:
        return []
    return [
        f"the best pose of {found.touch.name} has an imprint IoU of {100 * best.imprint_iou:.0f} %, which is below "
        f"{100 * LEAST_IOU:.0f} %, and is probably wrong; check the object, the sensor, the unit and the prior"
    ]


def _list_unexpected(found: Localization) -> list[str]:
    if not found.unexpected:
        return []
    return [
        f"the prior makes the best pose of {found.touch.name} very improbable; check the prior's unit, frame and "
        "standard deviations, or locate the touch without it"
    ]


def _list_touches_not_explained(found: Localization) -> list[str]:
    unexplained = [
        touch.name
        for number, (touch, iou) in enumerate(zip(found.touches, found.best.imprint_ious, strict=False))
        if iou < NOT_EXPLAINED and number not in found.agreement.outliers
    ]
    if not unexplained:
        return []
    names = ", ".join(unexplained)
    return [
        f"the best pose explains nothing of {names} (imprint IoU below {100 * NOT_EXPLAINED:.0f} %), and is "
        "probably wrong; check T_base_sensor and the object of these touches, or locate the object without them"
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
