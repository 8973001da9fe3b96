"""Labels for a folder or a video of presses: a table of the presses and a description of the sensor."""

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
    """Return the folder with `presses.csv`, the sensor's file, and the labels for the command's result.

    An existing table is used unchanged. Otherwise the ball is detected in the images, and the table and the sheet
    `labels.png` are written. Raises CalibrationError, ConfigError or SensorError for unusable input.
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
            f"there is no table {folder / TABLE}; give --ball-radius to write it from the images, or write it "
            "yourself (docs/sensors.md)"
        )
    if not os.access(source if source.is_dir() else source.parent, os.W_OK):
        raise CalibrationError(f"labels cannot be written beside {source}; copy it to a folder that you may write to")
    scale = _find_scale(folder, sensor, mm_per_px)
    folder, frames = read_frames(source)
    found = _find_labels(folder, frames, scale, ball_radius_mm)
    return folder, find_sensor_file(folder, sensor, mm_per_px, frames[0].image.shape[:2]), found


def _use_table(folder: Path, ball_radius_mm: float) -> None:
    """Report that the table is used, and how many images are not in it.

    Raises ConfigError if a ball in the table has another radius.
    """
    from tactile_loc.calibration.frames import list_pictures
    from tactile_loc.calibration.presses import TABLE, summarize_table

    names, radii_mm = summarize_table(folder)
    other = next((mm for mm in radii_mm if not math.isclose(mm, ball_radius_mm, rel_tol=SAME_SCALE)), None)
    if other is not None:
        raise ConfigError(
            f"--ball-radius is {ball_radius_mm:g} mm, but {folder / TABLE} has a ball of {other:g} mm; correct one, or "
            "remove the table to detect the balls again"
        )
    new = len(list_pictures(folder) - names)
    more = f"; {new} images are not in this table: remove it to detect the balls again" if new else ""
    say(f"using the labels in {folder / TABLE}{more}")


def _find_scale(folder: Path, sensor: str | None, mm_per_px: float | None) -> float:
    """Return the pixel size in mm, from the sensor's file if it exists, and otherwise `mm_per_px`.

    Raises CalibrationError if neither is given, SensorError if the named file does not exist, and ConfigError if both
    differ.
    """
    from tactile_loc.calibration.presses import SENSOR

    file = folder / SENSOR if sensor is None else Path(sensor)
    if sensor is None and not file.exists():
        if mm_per_px is not None:
            return mm_per_px
        raise CalibrationError(
            f"the size of a pixel is unknown; give --mm-per-px or the sensor file {file}. To measure it, divide the "
            "length of an object on the gel in mm by its length in the image in pixels"
        )
    if not file.is_file():
        raise SensorError(f"there is no sensor file {file}; write it (docs/files.md), or give --mm-per-px")
    return _read_scale(file, mm_per_px)


def _read_scale(file: Path, mm_per_px: float | None) -> float:
    """Return the pixel size from the sensor's file, in mm. Raises ConfigError if `mm_per_px` differs."""
    from tactile_loc.io.sensor_files import read_sensor_file

    scale = 1e3 * read_sensor_file(file).pixel_pitch_m
    if mm_per_px is not None and not math.isclose(scale, mm_per_px, rel_tol=SAME_SCALE):
        raise ConfigError(
            f"--mm-per-px is {mm_per_px:g}, but {file} has {scale:.6g}; correct one, or remove the file to write it "
            "again"
        )
    return scale


def find_sensor_file(folder: Path, sensor: str | None, mm_per_px: float | None, shape: tuple[int, int] | None) -> Path:
    """Return the path of the sensor's file: the given file, or the file in the folder.

    If the folder has no such file, the file is written from `mm_per_px`. `shape` is the images' size (rows, columns),
    by default that of the first image. Raises ConfigError if file and `mm_per_px` differ.
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
            raise ConfigError(f"{flag} cannot be {value:g}; give a positive number (mm)")


def _find_labels(folder: Path, frames: list[Any], mm_per_px: float, ball_radius_mm: float) -> dict[str, Any]:
    from tactile_loc.calibration.frames import SHEET
    from tactile_loc.calibration.unlabelled import estimate_depths_mm, find_presses, write_labels
    from tactile_loc.drawing.calibration import draw_labels
    from tactile_loc.drawing.pictures import save_figure

    found = find_presses(frames, ball_radius_mm / mm_per_px, make_progress())
    least_mm, most_mm = estimate_depths_mm(found, ball_radius_mm, mm_per_px)
    table = write_labels(folder, found, ball_radius_mm, mm_per_px)
    title = f"{len(found.used)} of {len(found.presses)} presses are used"
    sheet = save_figure(folder / SHEET, draw_labels(found, title))
    _report(found)
    say(f"press depths, estimated from the circles: {least_mm:.2f} to {most_mm:.2f} mm; check that they are plausible")
    say(f"written: {table} (look at {sheet}; if a circle is wrong, edit its row and run the command again)")
    dropped = {press.name: press.dropped for press in found.presses if press.dropped}
    return {"labels": {"table": str(table), "sheet": str(sheet), "used": len(found.used), "dropped": dropped}}


def _report(found: FoundPresses) -> None:
    untouched = len(found.untouched_names)
    gel = (
        f"{untouched} of the untouched gel"
        if untouched
        else "none of the untouched gel, so its image was composed from others"
    )
    say(f"images: {len(found.used)} with a ball, {gel}")
    for press in found.presses:
        if press.dropped:
            say(f"  not used: {press.name}: {press.dropped}")
