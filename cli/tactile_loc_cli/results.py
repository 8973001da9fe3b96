"""Tables and lines that show results, in millimetres, degrees and per cent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import format_pose
from tactile_loc.core.runtime.formatting import format_duration, format_millimetres, format_mm
from tactile_loc_cli.console import format_count, say, say_table, write_flags

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.io.mount_files import HandEyeRecord, HandEyeTouchRecord
    from tactile_loc.locate.identify import Identification, KnownObject
    from tactile_loc.locate.result.hypothesis import Hypothesis
    from tactile_loc.locate.result.localization import Localization
    from tactile_loc.locate.touch_files import LocatedFile
    from tactile_loc.planning.next_touch import NextTouch, RatedApproach

IMPRINT = "imprint IoU %"
MOST_NAMED = 3  # names of touches that are shown
MOST_RANKED = 10  # listed poses that are shown
NEXT_TOUCHES = 3  # approaches that are shown after an identification
LEAST_SHOWN = 0.01  # least probability of unlisted poses that is shown
POSE = ("x mm", "y mm", "z mm", "angle deg", "about axis")


def make_title(found: Localization) -> str:
    """Return the picture's title: verdict, object, sensor, stated probability, and error if it is known."""
    errors_m = found.measure_errors_m(found.object)
    error = "" if errors_m is None else f"error {format_millimetres(errors_m[0])}"
    text = f"{found.verdict}: {found.object.name} on {found.made_with.sensor_name}"
    return ", ".join(filter(None, (text, found.describe_within(), error)))


def say_result(found: Localization) -> None:
    """Write the verdict, a table of the hypotheses with the object's pose, and a summary.

    The poses are in the base frame or, if the sensor's pose is unknown, in the sensor frame.
    """
    errors_m, next_step = found.measure_errors_m(found.object), found.assessment.next_step
    header = ["rank", "prob. %", *POSE, IMPRINT, *([] if errors_m is None else ["error mm"])]
    within = found.describe_within()
    say(f"{found.verdict}: {found.explain()}{within and f' ({within})'}")
    if next_step:
        say(f"next: {next_step}")
    frame = f"frame of {found.made_with.sensor_name}" if found.best.T_base_object is None else "base frame"
    say(f"{found.object.name} in the {frame}, {_describe_touches(found)}")
    rows = [[str(rank), *_list_cells(h)] for rank, h in enumerate(found.hypotheses, 1)]
    if errors_m is not None:
        rows = [[*row, format_mm(error_m)] for row, error_m in zip(rows, errors_m, strict=True)]
    say_table([header, *rows], left=0, gap=2)
    for line in _summarise(found):
        say(line)


def _describe_touches(found: Localization) -> str:
    """Return the number of simulated touches, the name of one touch, or the number and the first names of several."""
    names = [touch.name for touch in found.touches]
    if found.config is None or found.config.touch.path is None:
        return format_count(len(names), "simulated touch")
    if len(names) == 1:
        return names[0]
    more = ", ..." if len(names) > MOST_NAMED else ""
    return f"{format_count(len(names), 'touch')}: {', '.join(names[:MOST_NAMED])}{more}"


def say_alone(alone: Localization, obj: ObjectModel) -> None:
    """Write what the first simulated touch alone shows of an object."""
    errors_m = alone.measure_errors_m(obj)
    off = "" if errors_m is None else f"; first pose: {format_millimetres(errors_m[0])} off"
    say(f"the first touch alone: {alone.verdict}, {alone.count_explanations()}{off}")


def say_ranks(before: NDArray[np.float64], after: NDArray[np.float64]) -> None:
    """Write the probabilities (K,), 0 to 1, of listed poses before and after the touches, the most probable first."""
    order = np.argsort(-after, kind="stable")[:MOST_RANKED]
    rows = [[str(k + 1), f"{100 * before[k]:.1f}", f"{100 * after[k]:.1f}"] for k in order]
    say_table([["listed pose", "before %", "after %"], *rows], left=0, gap=2)
    say(f"other poses: {100 * (1 - after.sum()):.1f} %")


def _summarise(found: Localization) -> Iterator[str]:
    """Yield the lines below the table."""
    yield from _describe_std(found.best)
    yield (
        f"normalised entropy: {found.normalised_entropy:.2f} (0: one pose is certain, 1: nothing is known), "
        f"{found.describe_search()}"
    )
    if (listed := found.pose_set) is not None:
        yield f"{listed.title}: {listed.size}. {listed.meaning}"
    missed = found.posterior.elsewhere if found.outcome is None else found.outcome.missed
    unlisted = 1 - missed - sum(h.probability for h in found.hypotheses)
    if unlisted > LEAST_SHOWN and found.pose_set is None:
        yield f"{100 * unlisted:.0f} % of the probability belongs to poses not listed; --top N lists more"
    grid = found.made_with.configuration["grid"]
    if grid["name"] == "whole" and not found.others:  # several touches rarely touch one face
        yield (
            "searched: the whole object. If you know which face touches, search only that face: --grid face "
            f"-o grid.face={_name_side(found)}"
        )
    if (grid["name"], grid["options"].get("face")) == ("face", "auto"):
        yield (
            f"searched: {_describe_side(found)}, on which its centroid lies lowest. For another side, add "
            "-o grid.face=SIDE with +x, -x, +y, -y, +z or -z; for the whole object, add --grid whole"
        )
    if (errors := found.assessment.errors) is not None:
        yield (
            f"pose error: {format_mm(errors.best_m)} mm (best pose), {format_mm(errors.best_listed_m)} mm (nearest "
            f"listed pose), {format_mm(errors.closest_in_grid_m)} mm (nearest grid pose): the largest displacement of "
            "any surface point, with symmetric poses counted as equal"
        )
    yield "time: " + ", ".join(f"{stage} {format_duration(s)}" for stage, s in found.seconds.items())


def _describe_side(found: Localization) -> str:
    """Name the searched side by its outward normal in the object's frame. The normal points into the sensor."""
    x, y, z = -found.best.T_sensor_object_grid[2, :3] + 0.0
    return f"the object's side ({x:z.2f}, {y:z.2f}, {z:z.2f})"


def _name_side(found: Localization) -> str:
    """Name the side that touches in the first pose, such as +z: the object's axis nearest to the contact's normal.

    The name is SIDE if the first pose is not certain.
    """
    from tactile_loc.locate.result.verdict import Verdict

    if found.verdict is not Verdict.CERTAIN:
        return "SIDE"
    outwards = -found.best.T_sensor_object[2, :3]
    axis = int(np.argmax(abs(outwards)))
    return f"{'+' if outwards[axis] > 0 else '-'}{'xyz'[axis]}"


def _describe_std(best: Hypothesis) -> Iterator[str]:
    """Yield a line with the standard deviations of the best pose in the frame of the table, if they are known."""
    frame, covariance = "sensor", best.covariance
    if best.T_base_object is not None:
        frame, covariance = "base", best.base_covariance
    if covariance is not None:
        yield f"standard deviations of the best pose: {_format_std(covariance, frame)}"


def _format_std(covariance: NDArray[np.float64], frame: str) -> str:
    std = np.sqrt(np.diag(covariance))
    along, about = (", ".join(f"{v:.2f}" for v in part) for part in (1e3 * std[:3], np.degrees(std[3:])))
    return f"{along} mm along and {about} degrees about the {frame}'s x, y and z axes"


def _list_cells(h: Hypothesis) -> list[str]:
    pose = format_pose(h.T_sensor_object if h.T_base_object is None else h.T_base_object)
    return [f"{100 * h.probability:.1f}", *pose, f"{100 * h.imprint_iou:.0f}"]


def say_mount(record: HandEyeRecord) -> None:
    """Write the mount, its standard deviations, and the residual of each touch."""
    T, C = np.array(record.T_flange_sensor), np.array(record.covariance)
    say(f"{record.sensor} in the frame of the flange, from {len(record.touch)} touches of {record.object}")
    say_table([list(POSE), format_pose(T)], left=0, gap=2)
    say(f"standard deviations: {_format_std(C, 'flange')}")
    say_table(
        [["touch", "residual mm", "residual deg", IMPRINT], *map(_list_hand_eye_cells, record.touch)], left=1, gap=2
    )
    for one in record.touch:
        if one.left_out:
            say(f"{one.name} was left out: {one.left_out}")


def _list_hand_eye_cells(touch: HandEyeTouchRecord) -> list[str]:
    off = (1e3 * (touch.residual_m or 0.0), np.degrees(touch.residual_rad or 0.0))
    return [touch.name, *(f"{v:z.2f}" for v in off), f"{100 * (touch.imprint_iou or 0.0):.0f}"]


def say_next_touch(found: NextTouch, top: int) -> None:
    """Write the best approaches, the approaches out of reach, and the poses that no approach distinguishes."""
    modes = found.modes
    poses = format_count(len(modes.probabilities), "possible pose")
    say(f"{modes.object_names}: {poses}, entropy {modes.entropy:z.2f} nats")
    header = ["rank", "approach", "information nats", "entropy left nats", "contact %", "travel mm", "cost", "worth"]
    rows = [[str(rank), *_list_rated_cells(one)] for rank, one in enumerate(found.ranked[:top], 1)]
    say_table([header, *rows], left=2, gap=2)
    for one, reason in found.out_of_reach[:top]:
        say(f"out of reach: {one.name} {reason}")
    if (more := len(found.out_of_reach) - top) > 0:
        say(f"out of reach: {more} more; next_touch.json has the reasons")
    if modes.unlisted > LEAST_SHOWN:
        say(
            f"{100 * modes.unlisted:.0f} % of the probability belongs to poses not listed in the result; "
            "run --top N lists more"
        )
    if set(modes.symmetries.split(" or ")) != {"none"}:
        say(f"symmetric poses ({modes.symmetries}) count as one: no touch distinguishes them")
    for group in found.alike:
        say(f"no approach distinguishes poses {', '.join(map(modes.name_mode, group))}")
    if found.stops:
        count = next(len(group) for group in found.alike if 0 in group)
        say(f"no further touch of these can tell these {count} poses apart: stop")
    if found.alike and found.doubt_left > LEAST_SHOWN:
        say(
            "even after any of these approaches, the most probable pose is wrong with a probability of at least "
            f"{100 * found.doubt_left:.0f} %"
        )


def _list_rated_cells(one: RatedApproach) -> list[str]:
    travel_mm = 1e3 * one.travel_m[np.isfinite(one.travel_m)]
    travel = f"{travel_mm.min():.1f} to {travel_mm.max():.1f}" if len(travel_mm) else "-"
    numbers = [f"{one.information:z.2f}", f"{one.entropy:z.2f}", f"{100 * one.meets:.0f}"]
    return [one.approach.name, *numbers, travel, f"{one.cost:g}", f"{one.worth:.2f}"]


def say_identification(found: Identification, touches: int, next_touch: NextTouch | None) -> None:
    """Write the verdict, a table of the located objects, the most probable first, and the next touch, if any.

    `touches` is the number of touches that were identified.
    """
    from tactile_loc.planning.identification_files import NONE_OF_THESE, describe_identification

    header = ["object", "prob. %", "misfit nats", IMPRINT, *POSE]
    rows = [_list_known_cells(one, one.found) for one in found.objects if one.found]
    say(f"{describe_identification(found)} ({format_count(touches, 'touch')})")
    say_table([header, *rows, [NONE_OF_THESE, f"{100 * found.none:.1f}"]], left=1, gap=2)
    if others := len(found.objects) - len(rows):
        say(f"not located, because others explain the touches better or no pose explains them: {others} more")
    if next_touch is not None:
        say_next_touch(next_touch, NEXT_TOUCHES)


def _list_known_cells(one: KnownObject, found: Localization) -> list[str]:
    numbers = [f"{100 * one.probability:.1f}", f"{one.misfit:.1f}", f"{100 * found.best.imprint_iou:.0f}"]
    return [one.name, *numbers, *format_pose(found.best.T_sensor_object)]


def say_located(files: Sequence[LocatedFile]) -> None:
    """Write a line for each touch, with its best pose or the reason why it has no pose."""
    header = ["touch", "verdict", "right %", IMPRINT, *POSE]
    say_table([header, *([one.name, *_list_best_cells(one)] for one in files)], left=2, gap=2)


def _list_best_cells(located: LocatedFile) -> list[str]:
    if (best := located.best) is None:
        return [write_flags(located.problem)]
    right = "-" if located.probability_within is None else f"{100 * located.probability_within:.1f}"
    numbers = [right, f"{100 * best.imprint_iou:.0f}"]
    return [str(located.verdict), *numbers, *format_pose(best.T_sensor_object)]
