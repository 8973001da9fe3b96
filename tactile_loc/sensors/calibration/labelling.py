"""Labels for a folder or a video of presses: a table of the presses and a description of the sensor."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, SensorError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.sensors.calibration.frames import PressImage, list_pictures, name_frames_folder, read_frames
from tactile_loc.sensors.calibration.presses import SENSOR, TABLE, summarize_table, write_scale
from tactile_loc.sensors.calibration.unlabelled import FoundPresses, estimate_depths_mm, find_presses, write_labels

SAME_SCALE = 1e-6


@dataclass(frozen=True, eq=False)
class BallLabels:
    """The balls that were found in the images, and the least and the largest press depth, mm, by their circles."""

    found: FoundPresses
    depths_mm: tuple[float, float]

    @property
    def title(self) -> str:
        """The number of used images in words."""
        return f"{len(self.found.used)} of {len(self.found.presses)} presses are used"

    def describe(self) -> list[str]:
        """Return sentences about the images, the images that are not used, and the press depths."""
        found, (least_mm, most_mm) = self.found, self.depths_mm
        untouched = len(found.untouched_names)
        composed = "none of the untouched gel, so its image was composed from others"
        gel = f"{untouched} of the untouched gel" if untouched else composed
        dropped = [f"  not used: {press.name}: {press.dropped}" for press in found.presses if press.dropped]
        depths = f"press depths, estimated from the circles: {least_mm:.2f} to {most_mm:.2f} mm"
        return [f"images: {len(found.used)} with a ball, {gel}", *dropped, f"{depths}; check that they are plausible"]


@dataclass(frozen=True, eq=False)
class LabelledFolder:
    """A `folder` with the table of presses, and the path `sensor` of the sensor's file, which may be missing.

    `labels` are those that were just written to the table, or None if the table existed. `unlisted` is the number of
    images that are not in an existing table.
    """

    folder: Path
    sensor: Path
    labels: BallLabels | None = None
    unlisted: int = 0


def label_presses(
    source: Path,
    sensor: str | None,
    ball_radius_mm: float | None,
    mm_per_px: float | None,
    progress: Progress | None = None,
) -> LabelledFolder:
    """Return the folder of a source with `presses.csv` and its sensor's file.

    An existing table is used unchanged. Otherwise, the ball of radius `ball_radius_mm` is detected in the images, and
    the table is written. `sensor` is the sensor's file, by default that in the folder. If there is none, it is written
    for the scale `mm_per_px`. Raises CalibrationError, ConfigError or SensorError for unusable input.
    """
    _require_lengths(ball_radius_mm, mm_per_px)
    folder = name_frames_folder(source) if os.path.isfile(source) else source
    if os.path.exists(folder / TABLE) or not os.path.exists(source):
        unlisted = 0
        if ball_radius_mm is not None and os.path.exists(source):
            unlisted = _count_unlisted(folder, ball_radius_mm)
        return LabelledFolder(folder, find_sensor_file(folder, sensor, mm_per_px, None), None, unlisted)
    if ball_radius_mm is None:
        raise CalibrationError(
            f"there is no table {folder / TABLE}; give `ball_radius` to write it from the images, or write it "
            "yourself (docs/sensors.md)"
        )
    if not os.access(source if source.is_dir() else source.parent, os.W_OK):
        raise CalibrationError(f"labels cannot be written beside {source}; copy it to a folder that you may write to")
    scale = _find_scale(folder, sensor, mm_per_px)
    folder, frames = read_frames(source)
    labels = _find_labels(folder, frames, scale, ball_radius_mm, progress)
    return LabelledFolder(folder, find_sensor_file(folder, sensor, mm_per_px, frames[0].image.shape[:2]), labels)


def _count_unlisted(folder: Path, ball_radius_mm: float) -> int:
    """Return how many images are not in the table. Raises ConfigError if a ball in the table has another radius."""
    names, radii_mm = summarize_table(folder)
    other = next((mm for mm in radii_mm if not math.isclose(mm, ball_radius_mm, rel_tol=SAME_SCALE)), None)
    if other is not None:
        raise ConfigError(
            f"{folder / TABLE} has a ball of radius {other:g} mm, but the given one has {ball_radius_mm:g} mm; correct "
            "the table or `ball_radius`, or remove the table to detect the balls again"
        )
    return len(list_pictures(folder) - names)


def _find_scale(folder: Path, sensor: str | None, mm_per_px: float | None) -> float:
    """Return the pixel size in mm, from the sensor's file if it exists, and otherwise `mm_per_px`.

    Raises CalibrationError if neither is given, SensorError if the named file does not exist, and ConfigError if both
    differ.
    """
    file = folder / SENSOR if sensor is None else Path(sensor)
    if sensor is None and not file.exists():
        if mm_per_px is not None:
            return mm_per_px
        raise CalibrationError(
            f"the size of a pixel is unknown; give `mm_per_px` or the sensor file {file}. To measure it, divide the "
            "length of an object on the gel in mm by its length in the image in pixels"
        )
    if not file.is_file():
        raise SensorError(f"there is no sensor file {file}; write it (docs/files.md), or give `mm_per_px`")
    return _read_scale(file, mm_per_px)


def _read_scale(file: Path, mm_per_px: float | None) -> float:
    """Return the pixel size from the sensor's file, in mm. Raises ConfigError if `mm_per_px` differs."""
    scale = 1e3 * read_sensor_file(file).pixel_pitch_m
    if mm_per_px is not None and not math.isclose(scale, mm_per_px, rel_tol=SAME_SCALE):
        raise ConfigError(
            f"`mm_per_px` is {mm_per_px:g}, but {file} has {scale:.6g}; correct one, or remove the file to write it "
            "again"
        )
    return scale


def find_sensor_file(folder: Path, sensor: str | None, mm_per_px: float | None, shape: tuple[int, int] | None) -> Path:
    """Return the path of the sensor's file: the given file, or the file in the folder.

    If the folder has no such file, the file is written from `mm_per_px`. `shape` is the images' size (rows, columns),
    by default that of the first image. Raises ConfigError if file and `mm_per_px` differ.
    """
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
    for setting, value in (("ball_radius", ball_radius_mm), ("mm_per_px", mm_per_px)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f"`{setting}` cannot be {value:g}; give a positive number (mm)")


def _find_labels(
    folder: Path, frames: list[PressImage], mm_per_px: float, ball_radius_mm: float, progress: Progress | None
) -> BallLabels:
    found = find_presses(frames, ball_radius_mm / mm_per_px, progress)
    labels = BallLabels(found, estimate_depths_mm(found, ball_radius_mm, mm_per_px))
    write_labels(folder, found, ball_radius_mm, mm_per_px)
    return labels
