"""A folder of presses, or a video, becomes one with a table of labels and a description of the sensor."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.errors import CalibrationError, ConfigError, SensorError
from tactile_loc_cli.console import make_progress, say

if TYPE_CHECKING:
    from tactile_loc.calibration.unlabelled import FoundPresses

SAME_SCALE = 1e-6


def label_presses(
    source: Path, sensor: str | None, ball_radius_mm: float | None, mm_per_px: float | None
) -> tuple[Path, Path, dict[str, Any]]:
    """Return the folder whose `presses.csv` lists the presses, the sensor's file, and what was found, for the result.

    A table that is there is taken as it is; otherwise the ball is looked for, the table is written, and the sheet
    `labels.png` beside it. Raises CalibrationError, ConfigError or SensorError.
    """
    from tactile_loc.calibration.frames import name_frames_folder, read_frames
    from tactile_loc.calibration.presses import TABLE

    _require_lengths(ball_radius_mm, mm_per_px)
    folder = name_frames_folder(source) if os.path.isfile(source) else source
    if os.path.exists(folder / TABLE) or not os.path.exists(source):
        if ball_radius_mm is not None and os.path.exists(source):
            _use_table(folder, ball_radius_mm)
        return folder, find_sensor_file(folder, sensor, mm_per_px, None), {}
    if ball_radius_mm is None:
        raise CalibrationError(
            f"there is no table {folder / TABLE}; give --ball-radius and it is written from what the images show, "
            "or write it yourself (docs/sensors.md)"
        )
    if not os.access(source if source.is_dir() else source.parent, os.W_OK):
        raise CalibrationError(f"labels cannot be written beside {source}; copy it to where you may write")
    if not _has_scale(folder, sensor, mm_per_px):
        raise CalibrationError(
            f"the size of a pixel is not known; press something of known length flat on the gel, divide its mm by its "
            f"pixels, and give that as --mm-per-px, or describe the sensor in {folder / 'sensor.toml'}"
        )
    folder, frames = read_frames(source)
    found = _find_labels(folder, frames, _find_scale(folder, sensor, mm_per_px), ball_radius_mm)
    return folder, find_sensor_file(folder, sensor, mm_per_px, frames[0].image.shape[:2]), found


def _use_table(folder: Path, ball_radius_mm: float) -> None:
    """Say that the table is used, and what it lacks. Raises ConfigError when it is of balls of another radius."""
    from tactile_loc.calibration.frames import list_pictures
    from tactile_loc.calibration.presses import TABLE, summarize_table

    names, radii_mm = summarize_table(folder)
    other = next((mm for mm in radii_mm if not math.isclose(mm, ball_radius_mm, rel_tol=SAME_SCALE)), None)
    if other is not None:
        raise ConfigError(
            f"--ball-radius is {ball_radius_mm:g}, but {folder / TABLE} has a ball of {other:g} mm; correct one, or "
            "remove the table to have the balls looked for again"
        )
    new = len(list_pictures(folder) - names)
    more = f"; {new} other images are not in it: remove it to have the balls looked for again" if new else ""
    say(f"the labels in {folder / TABLE} are used as they are{more}")


def _find_scale(folder: Path, sensor: str | None, mm_per_px: float | None) -> float:
    """The size of a pixel, mm, given or of the sensor's file. Raises ConfigError, SensorError; writes nothing."""
    from tactile_loc.calibration.presses import SENSOR

    file = folder / SENSOR if sensor is None else Path(sensor)
    if mm_per_px is not None and sensor is None and not file.exists():
        return mm_per_px
    if not file.is_file():
        raise SensorError(f"there is no {file}; describe the sensor in it (docs/sensors.md), or give --mm-per-px")
    return _read_scale(file, mm_per_px)


def _read_scale(file: Path, mm_per_px: float | None) -> float:
    """The size of a pixel of the sensor's file, mm. Raises ConfigError when another is given."""
    from tactile_loc.io.sensor_files import read_sensor_file

    scale = 1e3 * read_sensor_file(file).pixel_pitch_m
    if mm_per_px is not None and not math.isclose(scale, mm_per_px, rel_tol=SAME_SCALE):
        raise ConfigError(
            f"--mm-per-px is {mm_per_px:g}, but {file} says {scale:.6g}; correct one, or remove the file to have it "
            "written anew"
        )
    return scale


def find_sensor_file(folder: Path, sensor: str | None, mm_per_px: float | None, shape: tuple[int, int] | None) -> Path:
    """Return the file that describes the sensor: the one given, the folder's, or one written to it from the scale.

    `shape` is the images' (rows, columns); it is read from the table's first image when it is None. Raises ConfigError
    when the scale is given twice, differently.
    """
    from tactile_loc.calibration.frames import read_frames
    from tactile_loc.calibration.presses import SENSOR, write_scale

    file = folder / SENSOR if sensor is None else Path(sensor)
    if mm_per_px is None:
        return file
    if file.exists():
        _read_scale(file, mm_per_px)
        return file
    if sensor is not None or not folder.is_dir():
        return file
    return write_scale(folder, shape or read_frames(folder)[1][0].image.shape[:2], mm_per_px)


def _require_lengths(ball_radius_mm: float | None, mm_per_px: float | None) -> None:
    for flag, value in (("--ball-radius", ball_radius_mm), ("--mm-per-px", mm_per_px)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{flag} is {value:g}; it must be a positive number of mm")


def _has_scale(folder: Path, sensor: str | None, mm_per_px: float | None) -> bool:
    from tactile_loc.calibration.presses import SENSOR

    return mm_per_px is not None or sensor is not None or (folder / SENSOR).exists()


def _find_labels(folder: Path, frames: list[Any], mm_per_px: float, ball_radius_mm: float) -> dict[str, Any]:
    from tactile_loc.calibration.frames import SHEET
    from tactile_loc.calibration.unlabelled import estimate_depths_mm, find_presses, write_labels
    from tactile_loc.drawing.labels import draw_labels
    from tactile_loc.drawing.pictures import save_figure

    found = find_presses(frames, ball_radius_mm / mm_per_px, make_progress())
    least_mm, most_mm = estimate_depths_mm(found, ball_radius_mm, mm_per_px)
    table = write_labels(folder, found, ball_radius_mm, mm_per_px)
    title = f"{len(found.used)} of {len(found.presses)} presses are used"
    sheet = save_figure(folder / SHEET, draw_labels(found, title))
    _report(found)
    say(f"by their circles they were pressed {least_mm:.2f} to {most_mm:.2f} mm deep: is that so?")
    say(f"written: {table} (look at {sheet}; correct the table if need be, and give the command again)")
    dropped = {press.name: press.dropped for press in found.presses if press.dropped}
    return {"labels": {"table": str(table), "sheet": str(sheet), "used": len(found.used), "dropped": dropped}}


def _report(found: FoundPresses) -> None:
    untouched = len(found.untouched_names)
    gel = f"{untouched} of the untouched gel" if untouched else "none of the untouched gel, which was pieced together"
    say(f"images: {len(found.used)} with a ball, {gel}")
    for press in found.presses:
        if press.dropped:
            say(f"  {press.name} is not used: {press.dropped}")
