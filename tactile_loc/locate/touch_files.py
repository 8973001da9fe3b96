"""Touches read from paths: a folder or pattern of separate touches, or a list of touches of one object."""

import csv
import dataclasses
import io
import logging
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import axis_angle
from tactile_loc.core.runtime.errors import NoContactError, TactileLocError, TouchError
from tactile_loc.core.runtime.formatting import is_unicode, show_name
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import SlotConfig, find_sensor_kind
from tactile_loc.io.mount_files import Mount
from tactile_loc.io.touch_lists import ListedTouch, read_touch_list
from tactile_loc.io.touches import TOUCH_SUFFIXES, TRUE_POSES, list_touches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Hypothesis, Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.store.files import write_text

log = logging.getLogger(__name__)

COLUMNS = (
    "touch",
    "verdict",
    "probability",
    "probability_within",
    "imprint_iou",
    "x_mm",
    "y_mm",
    "z_mm",
    "turn_deg",
    "axis_x",
    "axis_y",
    "axis_z",
    "says",
)


@dataclass(frozen=True, eq=False)
class LocatedFile:
    """The result for one touch file: its best hypothesis and verdict, or the `problem` in one sentence.

    A file that cannot be read has no verdict. `probability_within`, 0 to 1, is the probability that the best hypothesis
    is within the tolerance of the true pose; None if it is unknown.
    """

    path: Path
    best: Hypothesis | None = None
    problem: str = ""
    verdict: Verdict | None = None
    probability_within: float | None = None

    @property
    def name(self) -> str:
        """The name of the file, as printable text."""
        return show_name(self.path.name)

    def make_row(self) -> dict[str, str]:
        """Return a row of results.csv, whose columns are COLUMNS: the best pose in mm and degrees."""
        row = {"touch": self.name, "verdict": self.verdict or "", "says": self.problem}
        if self.best is None:
            return row
        row |= {"probability": f"{self.best.probability:.4f}", "imprint_iou": f"{self.best.imprint_iou:.3f}"}
        if self.probability_within is not None:
            row["probability_within"] = f"{self.probability_within:.4f}"
        return row | make_pose_cells(self.best.T_sensor_object)


def make_pose_cells(T: NDArray[np.float64]) -> dict[str, str]:
    """Return a pose (4, 4), metres, as cells of a table: x, y, z in mm, the rotation angle in degrees, and its axis."""
    angle_deg, axis = axis_angle(T[:3, :3])
    places = {f"{name}_mm": f"{1e3 * v:.3f}" for name, v in zip("xyz", T[:3, 3], strict=True)}
    axes = {f"axis_{name}": f"{v:.4f}" for name, v in zip("xyz", axis, strict=True)}
    return {**places, "turn_deg": f"{angle_deg:.2f}", **axes}


def is_folder(path: Path) -> bool:
    """Return whether a path stands for many touches: a folder, or a pattern such as `folder/*.png`."""
    return os.path.isdir(path) or ("*" in path.name and not os.path.exists(path))


def is_list(path: Path) -> bool:
    """Return whether a path has the suffix of a list of touches, .toml."""
    return path.suffix.lower() == ".toml"


def find_touches(folder: Path) -> list[Path]:
    """Return the touch files in a folder or matching a pattern, in order. Raises TouchError if there is none."""
    if os.path.isdir(folder):
        # `simulate` writes contact shapes and photos of the same touches: use only the contact shapes
        simulated = list_touches(folder, "*.npz") if (folder / TRUE_POSES).is_file() else []
        files = simulated or list_touches(folder)
        if any(path.with_suffix(".png").is_file() for path in simulated):
            log.warning(
                "only the contact shapes are located; to locate the photos, give `touch` '%s'", folder / "touch-*.png"
            )
    else:
        files = list_touches(folder.parent, folder.name)
    if not files:
        raise TouchError(f"{folder} holds no touch; give files of type {', '.join(sorted(TOUCH_SUFFIXES))}")
    return files


def name_folders(files: Sequence[Path]) -> dict[Path, str]:
    """Return the name of the folder for each file's result: without the suffix, if no other file has this name."""
    used = Counter(name for path in files for name in {path.stem, path.name})
    return {path: path.stem if used[path.stem] == 1 else path.name for path in files}


def localize_files(
    localizer: Localizer, files: Sequence[Path], press_depth_m: float | None = None
) -> Iterator[tuple[LocatedFile, Localization | None]]:
    """Yield the result and the localisation of each file's touch, located separately, in the files' order.

    The localisation is None if it failed. `press_depth_m`, metres, is used for files that do not state their press
    depth.
    """
    asked = localizer.config.touch
    for path in files:
        try:
            touch = localizer.read_touch(path, asked.unit, press_depth_m, asked.kind)
        except NoContactError as error:
            yield LocatedFile(path, problem=str(error), verdict=Verdict.NO_CONTACT), None
            continue
        except TactileLocError as error:
            yield LocatedFile(path, problem=str(error)), None
            continue
        one = localizer.localize(touch)
        yield LocatedFile(path, one.best, "", one.verdict, None if one.outcome is None else one.outcome.right), one


def write_table(path: Path, located: Iterable[LocatedFile]) -> Path:
    """Write one row per file as CSV, atomically, and return the path. Raises OutputError."""
    return write_csv(path, COLUMNS, (one.make_row() for one in located))


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[dict[str, str]]) -> Path:
    """Write rows as CSV, atomically, with empty cells for missing values; return the path. Raises OutputError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return write_text(path, text.getvalue())


def read_observations(localizer: Localizer, path: Path) -> list[tuple[Localizer, Touch]]:
    """Read every touch of a list, each with the localizer of its sensor. Raises TactileLocError for bad input."""
    listed = read_touch_list(path)
    localizers = match_localizers(localizer, listed)
    return [(own, read_listed_touch(own, one)) for own, one in zip(localizers, listed, strict=True)]


def match_localizers(localizer: Localizer, listed: Iterable[ListedTouch]) -> list[Localizer]:
    """Return the localizer of each touch's sensor: one for each sensor, and `localizer` for touches without one.

    `localizer` is also that of touches with its own sensor, whose options are kept.
    """
    of_sensor = {None: localizer, localizer.config.sensor.name: localizer}
    found = []
    for one in listed:
        if one.sensor not in of_sensor:
            sensor = str(one.sensor)
            is_same = _is_read_from(localizer.config.sensor, sensor)
            of_sensor[sensor] = localizer if is_same else localizer.for_sensor(sensor)
        found.append(of_sensor[one.sensor])
    return found


def name_listed_sensor(sensor: SlotConfig, folder: Path) -> str | None:
    """Return a sensor as a list of touches in `folder` names it: a name, or the path of its file or calibration folder.

    Returns None for a sensor with other options, or whose path is not Unicode, because a list cannot state them.
    """
    if not sensor.options:
        return sensor.name
    place = _find_place(sensor)
    if place is None or not is_unicode(place) or sensor.options.keys() != {"path"}:
        return None
    return os.path.relpath(place, os.path.realpath(folder))


def _is_read_from(sensor: SlotConfig, path: str) -> bool:
    """Return whether a sensor is read from the file or the calibration folder `path`."""
    return find_sensor_kind(path) is not None and os.path.realpath(path) == _find_place(sensor)


def _find_place(sensor: SlotConfig) -> str | None:
    """Return the absolute path of the file or the calibration folder of a sensor, or None if it has none."""
    place = os.path.realpath(sensor.options.get("path", ""))
    return place if find_sensor_kind(place) == sensor.name else None


def read_listed_touch(localizer: Localizer, listed: ListedTouch) -> Touch:
    """Read one touch of a list, with its sensor's pose from the list. Raises TactileLocError for bad input."""
    asked = localizer.config.touch
    unit, kind = listed.unit or asked.unit, listed.kind or asked.kind
    touch = localizer.read_touch(listed.path, unit, listed.press_depth_m, kind)
    names = ("T_base_sensor", "T_base_sensor_std_m", "T_base_sensor_std_rad", "T_sensor_object")
    given = {name: value for name in names if (value := getattr(listed, name)) is not None}
    touch = dataclasses.replace(touch, **given)
    return touch if listed.mount is None else _add_mount_error(touch, listed.mount)


def _add_mount_error(touch: Touch, mount: Mount) -> Touch:
    """Return the touch with the mount's error added to the error of the flange's pose."""
    std_m, std_rad = mount.find_std_at(np.array([0.0, 0.0, touch.geometry.standoff_m]))
    return dataclasses.replace(
        touch,
        T_base_sensor_std_m=float(np.hypot(touch.T_base_sensor_std_m, std_m)),
        T_base_sensor_std_rad=float(np.hypot(touch.T_base_sensor_std_rad, std_rad)),
    )
