"""Sensor poses from a CSV file: one row for each image, or for each time. docs/files.md describes the format."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tactile_loc.core.geometry.frame_tree import Edge
from tactile_loc.core.geometry.rigid import FARTHEST_M, Floats, make_transform, quaternion_to_rotation, require_unit
from tactile_loc.core.runtime.errors import FrameError, name_source
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.io.csv_tables import Row, read_number, read_table, require_columns

FILE, TIME = "file", "time_s"
METRES_PER_COLUMN: dict[tuple[str, ...], float] = {
    ("x_m", "y_m", "z_m"): 1.0,
    ("x", "y", "z"): 1.0,
    ("x_mm", "y_mm", "z_mm"): 1e-3,
}
QUATERNION = ("qx", "qy", "qz", "qw")
USUAL_HZ = 30.0  # rate of images whose times are unknown


@dataclass(frozen=True, eq=False)
class SensorTrack:
    """The sensor's poses `T_base_sensor` (N, 4, 4), metres, at `times_s` (N,), seconds.

    `names` (N,) are the images' files, as `show_name` writes them; they are empty if the poses are given by time alone.
    `path` is the CSV file.
    """

    path: Path
    names: tuple[str, ...]
    times_s: Floats
    T_base_sensor: Floats

    def look_up(self, name: str, time_s: float = math.nan) -> Floats:
        """Return the sensor's pose (4, 4), metres, for an image.

        With file names, it is the pose in the row of the file `name`. Otherwise it is interpolated at the image's time:
        the number in its name, or else `time_s`. Raises FrameError if the pose is unknown.
        """
        if self.names:
            name = show_name(name)
            if name not in self._row_of:
                raise FrameError(f"{self.path} has no pose for {name}; add a row, or remove the image")
            return np.asarray(self.T_base_sensor[self._row_of[name]])
        found_s = read_time_s(name)
        return self._edge.look_up(_to_ns(time_s if found_s is None else found_s))

    @cached_property
    def _row_of(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}

    @cached_property
    def _edge(self) -> Edge:
        return Edge(
            "base", "sensor", stamps_ns=[_to_ns(t) for t in self.times_s], T_parent_child=list(self.T_base_sensor)
        )


def read_time_s(name: str) -> float | None:
    """Return the time in a file's name, such as 12.5 for "12.5.png", seconds; None if the name is not a number."""
    stem = name[: -len(Path(name).suffix)] if Path(name).suffix.lower() in (".png", ".jpg", ".npz", ".npy") else name
    try:
        found = float(stem)
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def _to_ns(time_s: float) -> int:
    return round(1e9 * time_s) if math.isfinite(time_s) else 0


def read_sensor_track(path: str | Path) -> SensorTrack:
    """Read sensor poses from a CSV file with a heading.

    Raises FrameError, which names the row and the column, when the file cannot be read, lacks a column, or holds a
    number that is impossible.
    """
    path = Path(path)
    table = read_table(path, "sensor pose", FrameError)
    rows, columns = table.rows, table.columns
    places = _find_place_columns(path, columns)
    if FILE not in columns and TIME not in columns:
        raise FrameError(f"{path} has neither a column {FILE} nor a column {TIME}; add one of them")
    require_columns(path, columns, QUATERNION, FrameError)
    poses, times_s = [], []
    for number, row in enumerate(rows, 1):
        with name_source(f"{path}, row {number}"):
            poses.append(_read_pose(row, places))
            times_s.append(read_number(row, TIME, FrameError) if TIME in columns else (number - 1) / USUAL_HZ)
    names = tuple(show_name(row[FILE]) for row in rows) if FILE in columns else ()
    _require_names(path, names)
    _require_order(path, times_s)
    return SensorTrack(path, names, np.array(times_s), np.stack(poses))


def _find_place_columns(path: Path, columns: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the three columns of the place. Raises FrameError unless there is one such set."""
    given = [names for names in METRES_PER_COLUMN if any(name in columns for name in names)]
    if len(given) != 1:
        found = "gives places in several units" if given else "gives no places"
        listed = ", or ".join(",".join(names) for names in METRES_PER_COLUMN)
        raise FrameError(f"{path} {found}; give the columns {listed}")
    require_columns(path, columns, given[0], FrameError)
    return given[0]


def _read_pose(row: Row, places: tuple[str, ...]) -> Floats:
    """Return the pose (4, 4), metres, of a row."""
    place_m = METRES_PER_COLUMN[places] * np.array([read_number(row, name, FrameError) for name in places])
    if np.linalg.norm(place_m) > FARTHEST_M:
        raise FrameError(
            f"the sensor is {np.linalg.norm(place_m):,.0f} m from the base; name the columns x_mm, y_mm and z_mm if "
            "the places are in mm"
        )
    q = require_unit([read_number(row, name, FrameError) for name in QUATERNION], "the quaternion", FrameError)
    return make_transform(quaternion_to_rotation(np.roll(q, 1)), place_m)


def _require_names(path: Path, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for number, name in enumerate(names, 1):
        if not name or name in seen:
            problem = f"names {name!r} a second time" if name else "names no file"
            raise FrameError(f"row {number} of {path} {problem}; give each image one row")
        seen.add(name)


def _require_order(path: Path, times_s: Sequence[float]) -> None:
    back = np.flatnonzero(np.diff(times_s) <= 0)
    if len(back):
        raise FrameError(f"{TIME} in row {back[0] + 2} of {path} is not after the row before; sort the rows by time")
