"""Doubts about a result, shown as warnings on the terminal, in reports and in tables of many touches."""

from __future__ import annotations

from tactile_loc.locate.result.result_json import ResultRecord
from tactile_loc.locate.result.verdict import LEAST_IOU

NOT_EXPLAINED = 0.05  # imprint IoU below which a pose explains nothing of a touch


def list_doubts(record: ResultRecord) -> list[str]:
    """Return the reasons why a result may be wrong, one sentence each; empty if there are none."""
    return [*_list_contradictions(record), *_list_unexplained(record), *_list_unexpected(record)]


def _list_unexplained(record: ResultRecord) -> list[str]:
    if record.other_touches:
        return _list_touches_not_explained(record)
    best = record.hypotheses[0]
    refined = best.T_sensor_object != best.T_sensor_object_grid
    if not refined or best.imprint_iou >= LEAST_IOU:
        return []
    return [
        f"the best pose of {record.touch.name} has an imprint IoU of {100 * best.imprint_iou:.0f} %, which is below "
        f"{100 * LEAST_IOU:.0f} %, and is probably wrong; check the object, the sensor, the unit and the prior"
    ]


def _list_unexpected(record: ResultRecord) -> list[str]:
    if not record.unexpected:
        return []
    return [
        f"the prior makes the best pose of {record.touch.name} very improbable; check the prior's unit, frame and "
        "standard deviations, or locate the touch without it"
    ]


def _list_touches_not_explained(record: ResultRecord) -> list[str]:
    touches, ious = [record.touch, *record.other_touches], record.hypotheses[0].imprint_ious
    unexplained = [
        touch.name for touch, iou in zip(touches, ious, strict=False) if iou < NOT_EXPLAINED and not touch.outlier
    ]
    if not unexplained:
        return []
    names = ", ".join(unexplained)
    return [
        f"the best pose explains nothing of {names} (imprint IoU below {100 * NOT_EXPLAINED:.0f} %), and is "
        "probably wrong; check T_base_sensor and the object of these touches, or locate the object without them"
    ]


def _list_contradictions(record: ResultRecord) -> list[str]:
    touches = [record.touch, *record.other_touches]
    fits = [
        f"{touch.name} {100 * iou:.0f} % ({100 * (touch.best_imprint_iou or iou):.0f} %)"
        for touch, iou in zip(touches, record.hypotheses[0].imprint_ious, strict=False)
    ]
    outliers = [fit for touch, fit in zip(touches, fits, strict=False) if touch.outlier]
    said = [f"{touch.name} contradicts the other touches and was left out" for touch in record.left_out]
    if outliers:
        said.append(
            f"{len(touches) - len(outliers)} of {len(touches)} touches agree on a pose; imprint IoU of this pose (and "
            f"of another pose) for the others: {', '.join(outliers)}. Check T_base_sensor and the object of these "
            "touches"
        )
    elif record.contradictory:
        said.append(
            f"no pose explains all touches; imprint IoU of the best pose (and of another pose): {', '.join(fits)}. "
            "Check each T_base_sensor, and that each touch is of this object"
        )
    return said
