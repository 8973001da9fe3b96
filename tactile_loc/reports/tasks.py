"""Reports without plots: an identification, the touches of a folder, and a sensor's checks."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from tactile_loc.core.geometry.rigid import format_pose
from tactile_loc.core.runtime.formatting import format_mm, format_percent
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.sensor_damage import PART, TOUCHES, Damage
from tactile_loc.locate.identify import Identification, KnownObject
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import explain_verdict, name_verdict
from tactile_loc.locate.touch_files import LocatedFile
from tactile_loc.planning.identification_files import NONE_OF_THESE, describe_identification
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.pictures import draw_shape, encode_photo
from tactile_loc.sensors.reading.passport import Examination, SensorFinding

CHANGES = 8  # factor by which small changes of colour are shown
POSE = ("x (mm)", "y (mm)", "z (mm)", "rotation (°)", "about axis")
DEPTHS = "Dark: pressed deepest. Touches are drawn as the sensor sees them, x right and y down."


def make_identification_page(found: Identification, touches: Sequence[Touch]) -> Page:
    """Return the page of an identification of touches. Its title is the verdict."""
    located, first = [_list_known_cells(one, one.found) for one in found.objects if one.found], found.objects[0]
    others = len(found.objects) - len(located)
    note = "Poses are in the first touch's sensor frame, if this object was touched."
    note += f" {others} more objects explain the touches worse and were not located." if others else ""
    numbers = [
        ("verdict", str(found.verdict), "how far to trust the first object"),
        ("first object", first.name, f"probability {format_percent(first.probability)}"),
        (NONE_OF_THESE, format_percent(found.none), "probability that none of the objects was touched"),
    ]
    rows = [*located, [NONE_OF_THESE, f"{100 * found.none:.1f}", *[""] * 7]]
    header = ("object", "prob. (%)", "misfit (nats)", "imprint IoU (%)", *POSE)
    sections = [
        Section("summary", "", {"numbers": numbers, "notes": []}),
        Section("rows", "Objects", {"header": header, "rows": rows, "left": 1, "note": note, "label": "objects"}),
        Section("pictures", "Contact shapes", _show({touch.name: touch for touch in touches}, len(touches))),
    ]
    names = ", ".join(touch.name for touch in touches)
    return _make_page(describe_identification(found), f"touches: {names}", sections)


def make_folder_page(found: Sequence[LocatedFile], shown: Mapping[str, Touch], about: str) -> Page:
    """Return the page of touches that were located one by one. Its title counts the verdicts.

    `shown` are the touches whose contact shapes are drawn, by the names of their files. `about` names the object, the
    sensor and the folder.
    """
    counts = Counter(name_verdict(one.verdict) for one in found)
    numbers = [(one, str(n), _explain(one, found)) for one, n in counts.most_common()]
    header = ("touch", "verdict", "prob. (%)", "imprint IoU (%)", *POSE)
    rows = [_list_located_cells(one) for one in found]
    note = "Each touch is located alone. Poses are in the sensor's frame."
    sections = [
        Section("summary", "", {"numbers": numbers, "notes": [one.problem for one in found if one.best is None]}),
        Section("rows", "Touches", {"header": header, "rows": rows, "left": 2, "note": note, "label": "touches"}),
        Section("pictures", "Contact shapes", _show(shown, len(found))),
    ]
    title = f"{len(found)} touches: {', '.join(f'{n} {one}' for one, n in counts.most_common())}"
    return _make_page(title, f"{len(found)} touches of {about}", sections)


def make_passport_page(
    sensor: str, seen: Examination, findings: Sequence[SensorFinding], damage: Sequence[Damage]
) -> Page:
    """Return the page of a sensor's checks. Its title counts the faults."""
    faults, whole = [one for one in findings if one.is_fault], damage[0]
    errors = {one.finding.check.name: _name_error(one) for one in damage if one.finding is not None}
    numbers = [
        ("faults", str(len(faults)), f"of {len(findings)} checks on {len(seen.photos)} photos"),
        ("pose error", _name_error(whole), f"of touches of the part {PART} without faults"),
    ]
    header = ("check", "state", "value", "limit", "pose error", "what to do")
    rows = [_list_check_cells(one, seen, errors) for one in findings]
    note = f"Pose errors are medians of {TOUCHES} simulated touches of {PART}, read as the faulty sensor reads them."
    now, before = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (seen.today, seen.before))
    change = np.clip(np.rint(128 + CHANGES * seen.change), 0, 255).astype(np.uint8)
    photos = {"untouched gel of the calibration": before, "untouched gel in the photos": now}
    photos |= {f"change, {CHANGES} times": change, "first photo": seen.photos[0]}
    images = [(caption, encode_photo(image)) for caption, image in photos.items()]
    for one in damage:
        if one.touch is not None:
            name = "without faults" if one.finding is None else one.finding.check.name
            images.append((f"{PART}, {name}", draw_shape(one.touch.contact_shape, one.touch.geometry)))
    sections = [
        Section("summary", "", {"numbers": numbers, "notes": [f"{one.says}: {one.check.advice}." for one in faults]}),
        Section("rows", "Checks", {"header": header, "rows": rows, "left": 2, "note": note, "label": "checks"}),
        Section("pictures", "Pictures", {"images": images, "note": "Contact shapes: dark is pressed deepest."}),
    ]
    state = "no fault found" if not faults else f"{len(faults)} {'fault' if len(faults) == 1 else 'faults'}"
    return _make_page(f"{sensor}: {state}", f"passport of the sensor {sensor}", sections)


def _name_error(damage: Damage) -> str:
    return f"{format_mm(damage.error_m)} mm" if np.isfinite(damage.error_m) else "no pose"


def _list_check_cells(one: SensorFinding, seen: Examination, errors: Mapping[str, str]) -> list[str]:
    scale, unit = (1e3, "mm") if one.check.unit == "m" else (1.0, one.check.unit)
    known = np.isfinite(one.value)
    value, limit = (f"{scale * v:.3g} {unit}".strip() for v in (one.value, one.check.find_limit(seen)))
    state = (one.says or "ok") if known else "not judged"
    advice = one.check.advice if one.is_fault else ""
    return [one.check.name, state, value if known else "", limit, errors.get(one.check.name, ""), advice]


def _make_page(title: str, about: str, sections: Sequence[Section]) -> Page:
    return Page("tasks", title, about, sections, {}, [])


def _show(shown: Mapping[str, Touch], touches: int) -> dict[str, object]:
    """Return the values of the section with the contact shapes of some of the `touches`."""
    images = [(name, draw_shape(touch.contact_shape, touch.geometry)) for name, touch in shown.items()]
    left = touches - len(images)
    return {"images": images, "note": f"{DEPTHS} {left} touches are not drawn." if left else DEPTHS}


def _explain(verdict: str, found: Sequence[LocatedFile]) -> str:
    return next(explain_verdict(one.verdict) for one in found if name_verdict(one.verdict) == verdict)


def _list_known_cells(one: KnownObject, found: Localization) -> list[str]:
    numbers = [f"{100 * one.probability:.1f}", f"{one.misfit:.1f}", f"{100 * found.best.imprint_iou:.0f}"]
    return [one.name, *numbers, *format_pose(found.best.T_sensor_object)]


def _list_located_cells(one: LocatedFile) -> list[str]:
    verdict = name_verdict(one.verdict)
    if one.best is None:
        return [one.name, verdict, *[""] * 7]
    numbers = [f"{100 * one.best.probability:.1f}", f"{100 * one.best.imprint_iou:.0f}"]
    return [one.name, verdict, *numbers, *format_pose(one.best.T_sensor_object)]
