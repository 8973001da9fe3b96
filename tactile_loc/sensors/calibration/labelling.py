"""Labels for a folder or a video of presses: a table of the presses and a description of the sensor."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, SensorError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.photo_map import PhotoMap
from tactile_loc.io.images import write_image
from tactile_loc.io.sensor_files import read_camera, write_sensor_file
from tactile_loc.sensors.calibration.frames import PressImage, list_pictures, name_frames_folder, read_frames
from tactile_loc.sensors.calibration.labels import STEEPEST
from tactile_loc.sensors.calibration.press_table import SENSOR, TABLE, UNTOUCHED, read_rows, write_table
from tactile_loc.sensors.calibration.unlabelled import FoundPresses, find_presses
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.rectification import SeenView, StatedView, see_view
from tactile_loc.store.files import write_atomically

SAME_SCALE = 1e-6
EVENED = 0.01  # largest relative change of the scale when photos are rectified to whole pixels
ROUNDS = 2  # times that photos are rectified as they show; the second time, circles are found in even photos
SHALLOWEST_MM = 0.05  # least depth of the deepest press; a smaller depth shows that the ball's radius is wrong


@dataclass(frozen=True, eq=False)
class LabelledFolder:
    """A `folder` with the table of presses, and the path `sensor` of the sensor's file, which may be missing.

    If the table was just written, `found` are the balls in the images, and `depths_mm` are the least and the largest
    press depth, mm, of those whose circles show it. Otherwise, `unlisted` is the number of images that are not in the
    table. `view` is the view of the gel that the photos show, if it is not the stated one.
    """

    folder: Path
    sensor: Path
    found: FoundPresses | None = None
    depths_mm: tuple[float, float] | None = None
    unlisted: int = 0
    view: SeenView | None = None

    def list_doubts(self) -> list[str]:
        """Return a sentence about the view, if it is not the stated one."""
        return [] if self.view is None else [self.view.says]

    def describe(self) -> list[str]:
        """Return sentences about the images, the images that are not used, and the press depths."""
        if self.found is None:
            return []
        found = self.found
        untouched = len(found.untouched_names)
        composed = "none of the untouched gel, so its image was composed from others"
        gel = f"{untouched} of the untouched gel" if untouched else composed
        if found.drift is not None:
            gel += f" ({found.untouched_names[0]}; since then {found.drift.describe()}; corrected in {UNTOUCHED})"
        dropped = [f"  not used: {press.name}: {press.dropped}" for press in found.presses if press.dropped]
        lines = [f"images: {len(found.used)} with a ball, {gel}", *dropped]
        if self.depths_mm is not None:
            depths = f"{self.depths_mm[0]:.2f} to {self.depths_mm[1]:.2f} mm"
            lines.append(f"press depths, estimated from the circles: {depths}; check that they are plausible")
        return lines


def label_presses(
    source: Path,
    sensor: str | None,
    ball_radius_mm: float | None,
    mm_per_px: float | None,
    progress: Progress | None = None,
    view: StatedView | None = None,
) -> LabelledFolder:
    """Return the folder of a source with `presses.csv` and its sensor's file.

    An existing table is used unchanged. Otherwise, the ball of radius `ball_radius_mm` is detected in the images, and
    the table is written. `sensor` is the sensor's file, by default that in the folder. If there is none, it is written
    for the scale `mm_per_px` and the `view`. If nothing states how the camera sees the gel, and the photos show that it
    does not see it straight, they are rectified. Raises CalibrationError, ConfigError or SensorError for unusable
    input.
    """
    for setting, value in (("ball_radius", ball_radius_mm), ("mm_per_px", mm_per_px)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ConfigError(f"`{setting}` cannot be {value:g}; give a positive number (mm)")
    folder = name_frames_folder(source) if os.path.isfile(source) else source
    file = folder / SENSOR if sensor is None else Path(sensor)
    if os.path.exists(folder / TABLE) or not os.path.exists(source):
        if mm_per_px is not None and file.exists():
            _read_scale(file, mm_per_px)
        elif mm_per_px is not None and sensor is None and folder.is_dir():
            shape = read_frames(folder)[1][0].image.shape[:2]
            write_sensor_file(folder / SENSOR, *(view or StatedView()).make_camera(shape, mm_per_px))
        unlisted = 0
        if ball_radius_mm is not None and os.path.exists(source):
            unlisted = _count_unlisted(folder, ball_radius_mm)
        return LabelledFolder(folder, file, unlisted=unlisted)
    if ball_radius_mm is None:
        raise CalibrationError(
            f"there is no table {folder / TABLE}; give `ball_radius` to write it from the images, or write it "
            "yourself (docs/sensors.md)"
        )
    if not os.access(source if source.is_dir() else source.parent, os.W_OK):
        raise CalibrationError(f"labels cannot be written beside {source}; copy it to a folder that you may write to")
    if file.is_file():
        if view is not None:
            raise ConfigError(f"{file} states the camera's view; remove it, or leave out `corners` and `camera_matrix`")
        _read_scale(file, mm_per_px)
    elif sensor is not None or file.exists():
        raise SensorError(f"there is no sensor file {file}; write it (docs/files.md), or give `mm_per_px`")
    elif mm_per_px is None and (view is None or view.gel_mm is None):
        raise CalibrationError(
            f"the size of a pixel is unknown; give `mm_per_px` or the sensor file {file}. To measure it, divide the "
            "length of an object on the gel in mm by its length in the image in pixels"
        )
    folder, frames = read_frames(source)
    stated = file.is_file()
    camera, photo_map = (
        read_camera(file) if stated else (view or StatedView()).make_camera(frames[0].image.shape[:2], mm_per_px)
    )
    scale = 1e3 * camera.pixel_pitch_m
    found = find_presses(_rectify_frames(frames, photo_map), ball_radius_mm / scale, progress)
    seen = None
    for _ in range(0 if stated or view is not None else ROUNDS):
        shown = [(one.frame.image, one.circle) for one in found.used if one.circle is not None]
        better = see_view(UntouchedGel.of(found.untouched), shown, camera, seen)
        if better is None:
            break
        seen = better
        found = find_presses(_rectify_frames(frames, seen.photo_map), ball_radius_mm / scale, progress)
    depths_mm = _estimate_depths_mm(found, ball_radius_mm, scale)
    _write_labels(folder, found, ball_radius_mm)
    if not stated:
        write_sensor_file(file, *((camera, photo_map) if seen is None else (seen.camera, seen.photo_map)))
    return LabelledFolder(folder, file, found, depths_mm, view=seen)


def _rectify_frames(frames: list[PressImage], photo_map: PhotoMap | None) -> list[PressImage]:
    if photo_map is None:
        return frames
    return [PressImage(frame.name, photo_map.rectify(frame.image)) for frame in frames]


def _count_unlisted(folder: Path, ball_radius_mm: float) -> int:
    """Return how many images are not in the table. Raises ConfigError if a ball in the table has another radius."""
    rows = read_rows(folder / TABLE)
    for radius_mm in (row.read_number("ball_radius_mm") for row in rows if row.kind == "ball"):
        if not math.isclose(radius_mm, ball_radius_mm, rel_tol=SAME_SCALE):
            raise ConfigError(
                f"{folder / TABLE} has a ball of radius {radius_mm:g} mm, but the given one has {ball_radius_mm:g} mm; "
                "correct the table or `ball_radius`, or remove the table to detect the balls again"
            )
    return len(list_pictures(folder) - {row.values["image"] for row in rows})


def _read_scale(file: Path, mm_per_px: float | None) -> float:
    """Return the pixel size from the sensor's file, in mm. Raises ConfigError if `mm_per_px` differs."""
    camera, photo_map = read_camera(file)
    scale, close = 1e3 * camera.pixel_pitch_m, SAME_SCALE if photo_map is None else EVENED
    if mm_per_px is not None and not math.isclose(scale, mm_per_px, rel_tol=close):
        raise ConfigError(
            f"`mm_per_px` is {mm_per_px:g}, but {file} has {scale:.6g}; correct one, or remove the file to write it "
            "again"
        )
    return scale


def _estimate_depths_mm(found: FoundPresses, ball_radius_mm: float, mm_per_px: float) -> tuple[float, float] | None:
    """Estimate the least and the largest press depth, mm, from the visible circles that are narrower than the ball.

    Return None if all circles are wider. Raises CalibrationError when even the largest depth is below SHALLOWEST_MM.
    """
    every_mm = mm_per_px * np.array([press.circle.radius_px for press in found.used if press.circle is not None])
    radii_mm = every_mm[every_mm <= STEEPEST * ball_radius_mm]
    if not len(radii_mm):
        return None
    depths_mm = ball_radius_mm - np.sqrt(ball_radius_mm**2 - radii_mm**2)
    if len(radii_mm) == len(every_mm) and depths_mm.max() < SHALLOWEST_MM:
        raise CalibrationError(
            f"imprints of radius {radii_mm.min():.2g} to {radii_mm.max():.2g} mm would be at most "
            f"{depths_mm.max():.1g} mm deep for a ball of radius {ball_radius_mm:g} mm; check `ball_radius` and "
            "`mm_per_px`, both in mm"
        )
    return float(depths_mm.min()), float(depths_mm.max())


def _write_labels(folder: Path, found: FoundPresses, ball_radius_mm: float) -> None:
    """Write `presses.csv` with the used presses. Write a composed or corrected untouched gel, too."""
    names = list(found.untouched_names)
    if not names or found.drift is not None:
        write_atomically(folder / UNTOUCHED, lambda path: write_image(path, found.untouched))
        names = [UNTOUCHED]
    rows: list[tuple[str, tuple[float, float, float] | None]] = [(name, None) for name in names]
    for press in found.used:
        assert press.circle is not None
        x, y, radius = (round(v, 2) for v in (press.circle.x_px, press.circle.y_px, press.circle.radius_px))
        rows.append((press.name, (x, y, radius)))
    write_table(folder / TABLE, rows, ball_radius_mm)
