"""`tactile-loc replay-dataset`: locate the object in each row of a data set, and add the results as columns."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from tactile_loc import LiveLocator, LocatedFrame, RosPose, Tracker, read_sensor_track
from tactile_loc.commands import (
    RunOptions,
    Store,
    Takes,
    declare,
    format_count,
    make_config,
    make_progress,
    open_localizer,
    say,
    say_written,
)
from tactile_loc.plugin import ConfigError, TouchError

if TYPE_CHECKING:
    from tactile_loc_datasets.episodes import Episode

Source = Annotated[
    Path,
    typer.Argument(
        metavar="DATASET", help="Folder of a LeRobot or Hugging Face data set, or a Parquet file.", show_default=False
    ),
]
Number = Annotated[
    int | None, declare("--episode N", "Number of the episode. Default: the first one of LeRobot, else all rows.")
]
Column = Annotated[
    str | None, declare("--column NAME", "Column of the images, such as observation.images.gel. Default: the only one.")
]
Track = Annotated[bool, declare("--track", "Track the object through the rows. Default: locate each row separately.")]
Poses = Annotated[
    Path | None, declare("--poses FILE.csv", "Poses of the sensor by time (time_s), in the base frame; with --track.")
]
Turn = Annotated[
    float | None,
    declare(
        "--turn DEG", "Turn of the images about the gel's normal, if the data set has the gel's poses. Default: 0."
    ),
]
Out = Annotated[Path, declare("--out FILE.parquet", "Table with the results. Default: located.parquet.")]
Given = Annotated[
    RunOptions,
    Takes(
        "object",
        "units",
        "symmetry",
        "touch_unit",
        "touch_kind",
        "press_depth",
        "sensor",
        "zero",
        "grid",
        "renderer",
        "encoder",
        "matcher",
        "refiner",
        "option",
        "config",
        "seed",
    ),
]


def replay_dataset(
    dataset: Source,
    *,
    given: Given,
    episode: Number = None,
    column: Column = None,
    track: Track = False,
    poses: Poses = None,
    turn: Turn = None,
    out: Out = Path("located.parquet"),
    store: Store = None,
) -> dict[str, Any]:
    """Locate an object in the tactile images of a data set.

    The table has all columns of the data set, and object_pose (x, y, z in metres, and qx, qy, qz, qw, in the sensor's
    frame), object_covariance (36 numbers, in ROS's order), object_probability and object_verdict.
    """
    from tactile_loc_datasets.known_motions import place_sensor
    from tactile_loc_datasets.readers import read_episode

    if out.suffix.lower() != ".parquet":
        raise ConfigError(f"--out {out.name} must end in .parquet; choose another name")
    if poses is not None and not track:
        raise ConfigError("--poses places the sensor for a track; give --track, or leave it out")
    rows = read_episode(dataset, episode, column)
    if turn is not None and (poses is not None or rows.T_base_gel is None):
        source = "--poses gives the sensor's poses" if poses is not None else f"{rows.name} has no poses of the gel"
        raise ConfigError(f"--turn needs the data set's poses of the gel, but {source}; leave out --turn")
    localizer = open_localizer(make_config(given), store)
    tracker = Tracker(localizer) if track else None
    motion = None if poses is None else read_sensor_track(poses)
    if motion is None and rows.T_base_gel is not None:
        motion = place_sensor(rows, localizer.sensor.geometry.standoff_m, turn or 0.0)
    locator = LiveLocator(localizer, tracker, motion)
    found = locate_rows(rows, locator)
    if all(one.T_sensor_object is None for one in found):
        reason = next((one.says for one in found if one.says), "they show no contact")
        raise TouchError(f"no image of {rows.name} can be located; first reason: {reason}")
    written = rows.write(out, make_columns(found))
    counts = Counter(one.word for one in found)
    say(f"{rows.name}: {format_count(len(found), 'row')}: " + ", ".join(f"{n} {word}" for word, n in counts.items()))
    return {"rows": len(found), "verdicts": dict(counts), "column": rows.column, "written": say_written([written])}


def locate_rows(rows: "Episode", locator: LiveLocator) -> list[LocatedFrame]:
    """Return the result of each row, in order."""
    found = []
    with make_progress().task(f"locating {rows.name}", len(rows.times_s)) as advance:
        for frame in rows.read_frames():
            found.append(locator.locate(frame).located)
            advance(1)
    return found


def make_columns(found: Sequence[LocatedFrame]) -> dict[str, list[Any]]:
    """Return the columns of results; a row without a pose has None."""
    poses = [None if one.T_sensor_object is None else RosPose.of(one.T_sensor_object, None) for one in found]
    covariances = [None if pose is None else one.covariance for pose, one in zip(poses, found, strict=True)]
    return {
        "object_pose": [None if one is None else [*one.position_m, *one.quaternion_xyzw] for one in poses],
        "object_covariance": [None if C is None else C.ravel().tolist() for C in covariances],
        "object_probability": [one.probability for one in found],
        "object_verdict": [one.word for one in found],
    }
