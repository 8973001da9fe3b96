"""Reads and writes a list of touches of one object as TOML: each touch's file, sensor and sensor pose."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.runtime.errors import ConfigError, TouchError, name_source
from tactile_loc.core.sensing.depth_maps import DepthUnit, TouchKind
from tactile_loc.io.mount_files import Mount, read_mount
from tactile_loc.io.sensor_files import is_calibrated_sensor
from tactile_loc.io.toml import (
    MATRIX,
    POSITIVE_MM,
    Matrix,
    PoseKeys,
    Positive,
    format_toml,
    list_tables,
    name_errors,
    name_pose_keys,
    read_pose,
    read_toml,
    scale,
)
from tactile_loc.io.touches import read_contents
from tactile_loc.store.files import write_text

Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ListedTouch:
    """One touch of a list: its file and its other entries. Missing entries are None.

    `sensor` is a name, or the path of a .toml file or of a calibration folder. `unit` is the unit of the depths,
    and `kind` their meaning.
    `T_base_sensor` (4, 4), metres, comes from the list, or from the flange's pose `T_base_flange` (4, 4) and `mount`,
    or from the touch's file. `T_base_sensor_std_m` and `T_base_sensor_std_rad` are the standard deviations of the
    pose's error, without the error of the mount. `T_sensor_object` (4, 4), metres, is the true pose, for evaluations.
    """

    path: Path
    sensor: str | None = None
    unit: DepthUnit | None = None
    press_depth_m: float | None = None
    T_base_sensor: Pose | None = None
    T_base_sensor_std_m: float | None = None
    T_base_sensor_std_rad: float | None = None
    T_base_flange: Pose | None = None
    mount: Mount | None = None
    kind: TouchKind | None = None
    T_sensor_object: Pose | None = None


class _TouchTable(PoseKeys):
    path: str = Field(min_length=1, description="the touch's file, relative to the list, in quotes")
    sensor: str | None = Field(None, min_length=1, description="a sensor's name, folder or .toml file, in quotes")
    unit: DepthUnit | None = Field(None, description="'m', 'mm' or 'um'")
    kind: TouchKind | None = Field(None, description="'distance', 'indentation', 'height' or 'mask'")
    press_depth_mm: Positive | None = Field(None, description=POSITIVE_MM)
    T_base_sensor: Matrix | None = Field(None, description=MATRIX)
    T_sensor_object: Matrix | None = Field(None, description=MATRIX)
    T_base_flange: Matrix | None = Field(None, description=MATRIX)
    mount: str | None = Field(None, min_length=1, description="a mount's .toml file, relative to the list, in quotes")
    T_base_sensor_std_mm: Positive | None = Field(None, description=POSITIVE_MM)
    T_base_sensor_std_deg: Positive | None = Field(None, description="a positive number (degrees)")


def read_touch_list(path: str | Path, of_flange: bool = False) -> tuple[ListedTouch, ...]:
    """Read the `[[touch]]` tables of a TOML file, in their order. Paths in the file are relative to its folder.

    The sensor's pose is given in one of three ways: `T_base_sensor` (4, 4), metres; the keys of `PoseKeys`; or
    `T_base_flange` (4, 4), metres, with a `mount` file for the touch or for the list. If there are several touches,
    each touch needs a pose, in the list or in the touch's .npz file. With `of_flange`, each touch needs
    `T_base_flange`, and no mount is read.

    Raises ConfigError when the list is missing or not TOML. Raises TouchError, which names the list and the touch's
    number, when a table is wrong or a file or pose is missing.
    """
    path, values = Path(path), read_toml(path)
    tables = list_tables(path, values, "touch", "its path", "mount")
    mount = None if of_flange else _read_mount(path, values)
    touches = []
    for number, table in enumerate(tables, start=1):
        with name_errors(f"{path}, touch {number}", _TouchTable, table, "a touch", TouchError):
            touch = _read_listed(_TouchTable(**table), path.parent, mount, of_flange)
            _require_pose(touch, len(tables) > 1, of_flange)
            touches.append(touch)
    return tuple(touches)


def write_touch_list(path: str | Path, sensor_poses: Mapping[str, Pose], sensor: str | None = None) -> Path:
    """Write a list of touches as TOML, atomically, and return the path. Raises OutputError if that fails.

    `sensor_poses` has `T_base_sensor` (4, 4), metres, by the touch's file. `sensor` is the sensor of all touches, as in
    `ListedTouch`. Files are relative to the list's folder.
    """
    named = {} if sensor is None else {"sensor": sensor}
    tables = [{"path": file, **named, "T_base_sensor": T.tolist()} for file, T in sensor_poses.items()]
    text = format_toml({"touch": tables})
    return write_text(Path(path), text)


def _read_mount(path: Path, values: dict[str, Any]) -> Mount | None:
    name = values.get("mount")
    if name is None:
        return None
    if not isinstance(name, str) or not name:
        raise ConfigError(f"{path}: mount = {name!r} is wrong; it must be the path of a mount's file, in quotes")
    with name_source(path):
        return read_mount(path.parent / name)


def _read_listed(keys: _TouchTable, folder: Path, mount: Mount | None, of_flange: bool) -> ListedTouch:
    file = folder / keys.path
    if not os.path.isfile(file):
        raise ValueError(f"there is no file {file}; check the path, which is relative to the list")
    T = read_pose(keys, keys.T_base_sensor, "T_base_sensor")
    F = read_pose(PoseKeys(), keys.T_base_flange, "T_base_flange")
    used = None if of_flange else _choose_mount(keys, folder, mount)
    if used is not None and F is not None:
        if T is not None:
            raise ValueError("the sensor's pose is given twice; leave out T_base_flange, or the pose of the sensor")
        T = F @ used.T_flange_sensor
    if T is None and file.suffix.lower() == ".npz":
        T = read_contents(file).T_base_sensor
    return ListedTouch(
        file,
        _find_sensor(keys.sensor, folder),
        keys.unit,
        scale(keys.press_depth_mm),
        T,
        scale(keys.T_base_sensor_std_mm),
        scale(keys.T_base_sensor_std_deg, math.pi / 180),
        F,
        used,
        keys.kind,
        read_pose(PoseKeys(), keys.T_sensor_object, "T_sensor_object"),
    )


def _choose_mount(keys: _TouchTable, folder: Path, mount: Mount | None) -> Mount | None:
    """Return the mount of the touch, or else the mount of the list, or None if the touch has no flange pose."""
    if keys.T_base_flange is None:
        if keys.mount is not None:
            raise ValueError("mount has no effect without T_base_flange; give the flange's pose, too")
        return None
    return mount if keys.mount is None else read_mount(folder / keys.mount)


def _require_pose(touch: ListedTouch, several: bool, of_flange: bool) -> None:
    if of_flange and touch.T_base_flange is None:
        raise ValueError("the flange's pose is missing; give T_base_flange for each touch")
    if not of_flange and touch.T_base_flange is not None and touch.mount is None:
        raise ValueError('T_base_flange needs the sensor\'s mount; give its file, as mount = "mount.toml"')
    if touch.T_base_sensor is None and several and not of_flange:
        raise ValueError(f"several touches need the sensor's pose, which is missing; {name_pose_keys('T_base_sensor')}")


def _find_sensor(sensor: str | None, folder: Path) -> str | None:
    """Return the path of a sensor file or calibration folder if there is one, otherwise the sensor's name.

    Any other folder is ignored, because it may have the name of a sensor by chance.
    """
    if sensor is None:
        return None
    place = folder / sensor
    is_path = Path(sensor).suffix == ".toml" or "/" in sensor
    if (is_path and os.path.exists(place)) or is_calibrated_sensor(place):
        return str(place)
    if is_path:
        raise ValueError(f"there is no sensor {place}; check the path, which is relative to the list")
    return sensor
