"""Several touches of one object as a TOML file: each one's file, sensor, and where that sensor was."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.errors import ConfigError, TouchError
from tactile_loc.io.mount_files import Mount, read_mount
from tactile_loc.io.sensor_files import is_calibrated_sensor
from tactile_loc.io.toml import (
    MATRIX,
    Matrix,
    PoseKeys,
    Positive,
    list_tables,
    name_errors,
    read_pose,
    read_toml,
    scale,
)
from tactile_loc.io.touches import TouchUnit, read_contents

Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ListedTouch:
    """One touch of a list: its file, and what else the list says of it, None where it says nothing.

    `sensor` is a name, or the path of a .toml file or of a calibrated sensor's folder; `unit` is that of its depths;
    `press_depth_m` metres; `T_base_sensor` (4, 4), metres, from the list, or of the flange's pose `T_base_flange`
    (4, 4) and the list's `mount`, or else from the touch's own file, with the standard deviations of its error, metres
    and radians; what the mount adds to them is not in these.
    """

    path: Path
    sensor: str | None = None
    unit: TouchUnit | None = None
    press_depth_m: float | None = None
    T_base_sensor: Pose | None = None
    T_base_sensor_std_m: float | None = None
    T_base_sensor_std_rad: float | None = None
    T_base_flange: Pose | None = None
    mount: Mount | None = None


class _TouchTable(PoseKeys):
    path: str = Field(min_length=1, description="the touch's file, relative to the list, in quotes")
    sensor: str | None = Field(None, min_length=1, description="a sensor's name, folder or .toml file, in quotes")
    unit: TouchUnit | None = Field(None, description="'m', 'mm' or 'um'")
    press_depth_mm: Positive | None = Field(None, description="a positive number (mm)")
    T_base_sensor: Matrix | None = Field(None, description=MATRIX)
    T_base_flange: Matrix | None = Field(None, description=MATRIX)
    mount: str | None = Field(None, min_length=1, description="a mount's .toml file, relative to the list, in quotes")
    T_base_sensor_std_mm: Positive | None = Field(None, description="a positive number (mm)")
    T_base_sensor_std_deg: Positive | None = Field(None, description="a positive number (degrees)")


def read_touch_list(path: str | Path, of_flange: bool = False) -> tuple[ListedTouch, ...]:
    """Read the `[[touch]]` tables of a TOML file, in their order; paths in it are relative to it.

    The sensor's pose is `T_base_sensor`, (4, 4) in metres, or `xyz_mm` with `rpy_deg` or `quaternion_wxyz`; or it is
    `T_base_flange` together with the touch's `mount`, a file, or the list's. Several touches all need one, here or in
    their own .npz files. A list of poses `of_flange` needs T_base_flange of each, and no mount. Raises ConfigError when
    the list is missing or no TOML, and TouchError, which names the list and the touch's number, when a table is wrong
    or a file or pose is missing.
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


def _read_mount(path: Path, values: dict[str, Any]) -> Mount | None:
    """The mount in the file that a list names, if it names one."""
    name = values.get("mount")
    if name is None:
        return None
    if not isinstance(name, str) or not name:
        raise ConfigError(f"mount in {path} is {name!r}; it must be the path of a mount's file, in quotes")
    return read_mount(path.parent / name)


def _read_listed(keys: _TouchTable, folder: Path, mount: Mount | None, of_flange: bool) -> ListedTouch:
    file = folder / keys.path
    if not os.path.isfile(file):
        raise ValueError(f"there is no file {file}; path is relative to the list")
    T = read_pose(keys, keys.T_base_sensor, "T_base_sensor")
    F = read_pose(PoseKeys(), keys.T_base_flange, "T_base_flange")
    used = None if of_flange else _choose_mount(keys, folder, mount)
    if used is not None and F is not None:
        T = F @ used.T_flange_sensor
    if T is None and file.suffix.lower() == ".npz":
        T = read_contents(file).T_base_sensor
    return ListedTouch(
        file, _find_sensor(keys.sensor, folder), keys.unit, scale(keys.press_depth_mm), T,
        scale(keys.T_base_sensor_std_mm), scale(keys.T_base_sensor_std_deg, math.pi / 180), F, used,
    )  # fmt: skip


def _choose_mount(keys: _TouchTable, folder: Path, mount: Mount | None) -> Mount | None:
    """The mount by which a touch's flange tells where its sensor was: its own, or the list's; None without a flange."""
    if keys.T_base_flange is None:
        if keys.mount is not None:
            raise ValueError("mount is that of a sensor on a flange; give T_base_flange, too")
        return None
    used = mount if keys.mount is None else read_mount(folder / keys.mount)
    if used is not None and (keys.T_base_sensor is not None or keys.xyz_mm is not None):
        raise ValueError("T_base_flange and the mount tell T_base_sensor; leave the one or the other out")
    return used


def _require_pose(touch: ListedTouch, several: bool, of_flange: bool) -> None:
    """Raise ValueError where the pose is missing that is needed."""
    if of_flange and touch.T_base_flange is None:
        raise ValueError("the flange's pose is missing; each touch needs T_base_flange")
    if not of_flange and touch.T_base_flange is not None and touch.mount is None:
        raise ValueError('T_base_flange tells nothing without the sensor\'s mount; name it: mount = "mount.toml"')
    if touch.T_base_sensor is None and several and not of_flange:
        raise ValueError(
            "the sensor's pose is missing; several touches all need T_base_sensor, or xyz_mm with either rpy_deg or "
            "quaternion_wxyz"
        )


def _find_sensor(sensor: str | None, folder: Path) -> str | None:
    """A sensor's path if there is one, else its name: a folder of touches may well be called after their sensor."""
    if sensor is None:
        return None
    place = folder / sensor
    is_path = Path(sensor).suffix == ".toml" or "/" in sensor
    if (is_path and os.path.exists(place)) or is_calibrated_sensor(place):
        return str(place)
    if is_path:
        raise ValueError(f"there is no sensor {place}; it is relative to the list")
    return sensor
