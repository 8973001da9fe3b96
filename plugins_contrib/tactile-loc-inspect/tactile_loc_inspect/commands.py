"""`tactile-loc inspect`: find where a located part differs from its model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from tactile_loc.commands import (
    UNEXPECTED,
    Finding,
    RunOptions,
    Store,
    Takes,
    declare,
    format_count,
    make_config,
    make_png_url,
    make_progress,
    open_localizer,
    read_touches,
    say,
    say_written,
    write_json,
)

if TYPE_CHECKING:
    from tactile_loc import Localization, Page

    from tactile_loc_inspect.inspection import Inspection

DEFAULT_OUT = Path("tactile-loc-inspection")
CAPTION = "Red: more material. Blue: less. Grey: not touched."

Result = Annotated[
    Path | None,
    typer.Argument(metavar="RESULT", help="Folder written by run, or its result.json. Without it, give --touch."),
]
Given = Annotated[
    RunOptions,
    Takes(
        "object",
        "units",
        "symmetry",
        "touch",
        "touch_unit",
        "touch_kind",
        "press_depth",
        "sensor",
        "zero",
        "option",
        "config",
        "tolerance",
        object="Mesh file (STL, OBJ, PLY, STEP, ...) or demo object: the model of the part. Only with --touch.",
        touch="A touch file, or a list (.toml) of touches of one part.",
    ),
]
Pose = Annotated[
    int | None,
    declare(
        "--pose N",
        "Inspect at pose N of the list, which you know to be right. Default: pose 1, if the verdict is certain.",
        min=1,
    ),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of inspection.json, inspection.png and report.html.")]


def inspect(
    result: Result = None, *, given: Given, pose: Pose = None, out: Out = DEFAULT_OUT, store: Store = None
) -> dict[str, Any]:
    """Find where a located part differs from its model.

    The touches of a result, or of --touch, are compared with the model at the part's pose. The first line is the
    verdict: as the model, within a stated size, or where the part differs and by how much. It holds only for the
    touched surface, and states its share. The exit code is 1 if the part differs, or if another pose explains the
    touches better.
    """
    from tactile_loc import save_figure, write_page

    from tactile_loc_inspect.inspection import inspect_localization
    from tactile_loc_inspect.picture import draw_inspection

    located = _locate(result, given, store)
    with make_progress().task("comparing the touches with the model", 1) as advance:
        found = inspect_localization(located, pose)
        advance(1)
    document = found.to_json()
    written = [
        write_json(out / "inspection.json", document),
        save_figure(out / "inspection.png", draw_inspection(found)),
    ]
    written.append(write_page(make_inspection_page(found, located, written[1]), out / "report.html"))
    _say(found)
    document["written"] = say_written(written)
    if found.verdict != "as the model":
        raise Finding(UNEXPECTED, document)
    return document


def _locate(result: Path | None, given: RunOptions, store: Path | None) -> Localization:
    """Return the stored result, or locate the part from the given touches."""
    from tactile_loc import Localization, localize_together

    from tactile_loc_inspect.inspection import InspectionError

    if result is None and given.touch is None:
        raise InspectionError("inspection needs touches; give the folder that run wrote, or --object and --touch")
    if result is not None:
        if given != RunOptions():
            raise InspectionError(
                f"{result} states the part, the touches and the sensor; leave out the other options, or give --object "
                "and --touch instead of it"
            )
        if not (result / "result.json" if result.is_dir() else result).is_file() or result.suffix == ".toml":
            raise InspectionError(
                f"{result} is not the folder of a result; give the folder that run wrote, or a list of touches as "
                "--touch, with --object"
            )
        return Localization.load(result)
    if given.object is None and given.config is None:
        raise InspectionError("--touch does not state which part was touched; give --object FILE or a demo object")
    localizer = open_localizer(make_config(given), store)
    return localize_together(read_touches(localizer, Path(str(given.touch))))


def _say(found: Inspection) -> None:
    """Show the verdict, the differences and what they mean for the pose."""
    say(found.describe())
    touches = format_count(len(found.comparisons), "touch")
    for number, one in enumerate(found.differences, 1):
        say(f"{number}. {one.describe()}; shown by {one.touches} of {touches}")
        if one.against:
            say(f"   {one.against} of {touches} found the opposite: check the sensor poses, and touch again")
    for one in found.unconfirmed:
        say(f"unconfirmed, seen by one touch: {one.describe()}; touch there again")
    for line in found.list_notes():
        say(line)


def make_inspection_page(found: Inspection, located: Localization, picture: Path) -> Page:
    """Return the page of an inspection; `picture` is its picture."""
    from tactile_loc import Page, Section

    names = ", ".join(touch.name for touch in located.touches)
    detectable = f"{1e3 * found.detectable_m:.2f} mm" if math.isfinite(found.detectable_m) else "unknown"
    numbers = [
        ("verdict", found.verdict, "only for the touched surface"),
        ("touched", f"{100 * found.touched:.1f} %", "of the surface"),
        ("detectable", detectable, "height found with 95 % probability where touched; noise and images: less often"),
        ("pose moved", f"{1e3 * found.moved_m:.2f} mm", "by the differences, without this inspection"),
    ]
    sizes = ("height (mm)", "+- (mm)", "x (mm)", "y (mm)", "z (mm)", "width (mm)")
    header = ("difference", *sizes, "touches")
    kinds = (("", found.differences), ("unconfirmed ", found.unconfirmed))
    rows = [
        [
            f"{kind}{number}",
            f"{'at least ' if one.at_least else ''}{1e3 * one.height_m:+.2f}",
            f"{2e3 * one.std_m:.2f}",
            *(f"{v:.1f}" for v in 1e3 * one.point_m),
            f"{1e3 * one.width_m:.1f}",
            str(one.touches),
        ]
        for kind, some in kinds
        for number, one in enumerate(some, 1)
    ]
    note = (
        "Heights are along the surface normal: + is material that the model lacks. +- is twice the standard deviation. "
        "Places are in the part's frame. With contact shapes, at most 2 % of clean parts show a difference. "
        "Photos of real sensors were measured on a ball and a prism only."
    )
    sections = [
        Section("summary", "", {"numbers": numbers, "notes": found.list_notes()}),
        Section("drawing", "Differences", {"picture": make_png_url(picture.read_bytes()), "caption": CAPTION}),
        Section("rows", "List", {"header": header, "rows": rows, "left": 1, "note": note, "label": "differences"}),
    ]
    return Page("tasks", f"Inspection of {found.object.name}: {found.verdict}", f"touches: {names}", sections, {}, [])
