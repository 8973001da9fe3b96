"""Doubts about a result: what people are warned of on the terminal, in reports and in lists of many touches."""

from __future__ import annotations

from tactile_loc.locate.results.result_json import ResultRecord
from tactile_loc.locate.results.verdict import LEAST_IOU


def list_doubts(record: ResultRecord) -> list[str]:
    """Return why an answer may be wrong, a sentence each; empty if nothing speaks against it."""
    return [*_list_contradictions(record), *_list_unexplained(record)]


def _list_unexplained(record: ResultRecord) -> list[str]:
    best = record.hypotheses[0]
    refined = best.T_sensor_object != best.T_sensor_object_grid
    if record.other_touches or not refined or best.imprint_iou >= LEAST_IOU:
        return []
    return [
        f"the best pose explains {100 * best.imprint_iou:.0f} % of what {record.touch.name} shows (imprint IoU), and "
        f"below {100 * LEAST_IOU:.0f} % hardly one is right: check the object, the sensor, the unit, and the prior if "
        "there is one"
    ]


def _list_contradictions(record: ResultRecord) -> list[str]:
    touches = [record.touch, *record.other_touches]
    fits = [
        f"{touch.name} to {100 * iou:.0f} % (another pose to {100 * (touch.best_imprint_iou or iou):.0f} %)"
        for touch, iou in zip(touches, record.hypotheses[0].imprint_ious, strict=False)
    ]
    outliers = [fit for touch, fit in zip(touches, fits, strict=False) if touch.outlier]
    said = [f"{touch.name} contradicted the other touches and was left out" for touch in record.left_out]
    if outliers:
        said.append(
            f"the pose on which {len(touches) - len(outliers)} of {len(touches)} touches agree explains "
            f"{', '.join(outliers)}; was that sensor where T_base_sensor says, and did it touch this object?"
        )
    elif record.contradictory:
        who = "which of two is wrong nobody can say" if len(touches) == 2 else "which is wrong does not show"
        said.append(f"no pose was found that explains all touches: the best explains {', '.join(fits)}; {who}")
    return said
