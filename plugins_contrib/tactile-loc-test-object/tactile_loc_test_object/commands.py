"""`tactile-loc test-object`: make the object to print, or score a sensor's photos of it."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from tactile_loc.commands import (
    RunOptions,
    Store,
    Takes,
    complain,
    declare,
    make_config,
    make_progress,
    open_localizer,
    say,
    say_table,
    say_written,
    write_atomically,
    write_json,
)

DEFAULT_OUT = Path("tactile-loc-test-object")

QuarterTurn = StrEnum("QuarterTurn", {"NONE": "0", "RIGHT": "90", "HALF": "180", "LEFT": "270"})

Made = Annotated[Path, typer.Argument(metavar="OUT", help="Folder of test-object.stl, places.csv and drawing.png.")]
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the photos 1.png to 10.png, and 1b.png, ...")]
Given = Annotated[
    RunOptions,
    Takes(
        "touch_unit",
        "touch_kind",
        "press_depth",
        "sensor",
        "zero",
        "option",
        "config",
        sensor="Sensor that took the photos: its calibration folder, or its description file or name.",
    ),
]
Turned = Annotated[
    QuarterTurn,
    declare("--turn DEG", "Angle by which the plate appears turned in the photos, from x to y (clockwise)."),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of score.json, row.json and report.html.")]

application = typer.Typer()


@application.command()
def make(out: Made) -> dict[str, Any]:
    """Write the test object to print, the list of its places, and a drawing with their numbers.

    The mesh is in mm, watertight, and prints without support.
    """
    from tactile_loc import save_figure

    from tactile_loc_test_object.picture import draw_places
    from tactile_loc_test_object.shape import PLACES, write_places, write_stl

    written = [
        write_atomically(out / "test-object.stl", write_stl),
        write_atomically(out / "places.csv", write_places),
        save_figure(out / "drawing.png", draw_places()),
    ]
    say(f"{len(PLACES)} places; print test-object.stl in mm, with the places up and without support")
    return {"written": say_written(written), "places": len(PLACES)}


@application.command()
def score(
    folder: Folder, *, given: Given, turn: Turned = QuarterTurn.NONE, out: Out = DEFAULT_OUT, store: Store = None
) -> dict[str, Any]:
    """Score a sensor's photos of the test object.

    Each photo is located near its place, and the gel's surface is compared with the object. The first line is the score
    of 100 points. row.json is the line for a table of sensors.
    """
    from tactile_loc import write_page

    from tactile_loc_test_object.picture import make_score_page
    from tactile_loc_test_object.score import score_photos
    from tactile_loc_test_object.scoring import TestObjectError, list_photos
    from tactile_loc_test_object.shape import PLACES, make_object

    if given.sensor is None and given.config is None:
        raise TestObjectError("no sensor was named; give --sensor with its calibration folder")
    photos = list_photos(folder)
    config = make_config(replace(given, object=None))
    localizer = open_localizer(config, store, make_object())
    found = score_photos(localizer, photos, math.radians(int(turn)), make_progress())
    document = found.to_json(Path(given.sensor or config.sensor.name).name)
    for line in found.describe():
        say(line)
    rows = found.list_rows()
    say_table(rows, left=(0, 1, 2))
    for press in found.presses:
        if press.refused:
            complain("refused", press.refused)
    if unfit := [press.photo.path.name for press in found.presses if press not in found.located and not press.refused]:
        complain(
            "warning", f"{', '.join(unfit)} fit no pose at their places; check the numbers of the files, and --turn"
        )
    if missing := [str(place.number) for place in PLACES if not found.by_place[place.number]]:
        complain("warning", f"no photo of the places {', '.join(missing)}, which count as 0 points")
    written = [
        write_json(out / "score.json", document),
        write_json(out / "row.json", document["row"]),
        write_page(make_score_page(found, folder), out / "report.html"),
    ]
    return {**document, "written": say_written(written)}
