"""Several touches of one object as a TOML file: each one's file, sensor, and where that sensor was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from tactile_loc.core.errors import ConfigError, TouchError, did_you_mean
from tactile_loc.io.sensor_files import is_calibrated_sensor
from tactile_loc.io.toml import MATRIX, Matrix, PoseKeys, Positive, explain, pose_from_keys, read_toml
from tactile_loc.io.touches import TouchUnit, read_contents

Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ListedTouch:
    """One touch of a list: its file, and what else the list says of it, None where it says nothing.

    `sensor` is a name, or the path of a .toml file or of a calibrated sensor's folder; `unit` is that of its depths;
    `press_depth_m` metres; `T_base_sensor` (4, 4), metres, from the list or else from the touch's own file, with the
    standard deviations of its error, metres and radians.
    """

    path: Path
    sensor: str | None = None
    unit: TouchUnit | None = None
    press_depth_m: float | None = None
    T_base_sensor: Pose | None = None
    T_base_sensor_std_m: float | None = None
    T_base_sensor_std_rad: float | None = None


class _TouchTable(PoseKeys):
    path: str = Field(min_length=1, description="the touch's file, relative to the list, in quotes")
    sensor: str | None = Field(None, min_length=1, description="a sensor's name, folder or .toml file, in quotes")
    unit: TouchUnit | None = Field(None, description="'m', 'mm' or 'um'")
    press_depth_mm: Positive | None = Field(None, description="a positive number (mm)")
    T_base_sensor: Matrix | None = Field(None, description=MATRIX)
    T_base_sensor_std_mm: Positive | None = Field(None, description="a positive number (mm)")
    T_base_sensor_std_deg: Positive | None = Field(None, description="a positive number (degrees)")


def read_touch_list(path: str | Path) -> tuple[ListedTouch, ...]:
    """Read the `[[touch]]` tables of a TOML file, in their order; paths in it are relative to it.

    The sensor's pose is `T_base_sensor`, (4, 4) in metres, or `xyz_mm` with `rpy_deg` or `quaternion_wxyz`; several
    touches all need one, here or in their own .npz files. Raises ConfigError when the list is missing or no TOML, and
    TouchError, which names the list and the touch's number, when a table is wrong or a file or pose is missing.
    """
    path, values = Path(path), read_toml(path)
    tables = _tables(path, values)
    touches = []
    for number, table in enumerate(tables, start=1):
        try:
            touches.append(_listed(table, path.parent, several=len(tables) > 1))
        except ValidationError as error:
            reason = explain(error, _TouchTable, table, "a touch")
            raise TouchError(f"{path}, touch {number}: {reason}") from error
        except (ValueError, TouchError) as error:
            raise TouchError(f"{path}, touch {number}: {error}") from error
    return tuple(touches)


def _tables(path: Path, values: dict[str, Any]) -> list[dict[str, Any]]:
    unknown = sorted(set(values) - {"touch"})
    if unknown:
        near = did_you_mean(unknown[0], ["touch"])
        raise ConfigError(f"{path} has an unknown entry {unknown[0]!r}.{near} It is a list of [[touch]] tables")
    tables = values.get("touch", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"touch in {path} is no list of tables; begin each touch with [[touch]]")
    if not tables:
        raise ConfigError(f"{path} lists no touch; give each one a [[touch]] table with its path")
    return tables


def _listed(table: dict[str, Any], folder: Path, several: bool) -> ListedTouch:
    keys = _TouchTable(**table)
    file = folder / keys.path
    if not file.is_file():
        raise ValueError(f"there is no file {file}; path is relative to the list")
    T = pose_from_keys(keys, keys.T_base_sensor, "T_base_sensor")
    if T is None and file.suffix.lower() == ".npz":
        T = read_contents(file).T_base_sensor
    if T is None and several:
        raise ValueError(
            "the sensor's pose is missing; several touches all need T_base_sensor, or xyz_mm with either rpy_deg or "
            "quaternion_wxyz"
        )
    press_depth_m = None if keys.press_depth_mm is None else 1e-3 * keys.press_depth_mm
    std_m = None if keys.T_base_sensor_std_mm is None else 1e-3 * keys.T_base_sensor_std_mm
    std_rad = None if keys.T_base_sensor_std_deg is None else float(np.radians(keys.T_base_sensor_std_deg))
    return ListedTouch(file, _sensor(keys.sensor, folder), keys.unit, press_depth_m, T, std_m, std_rad)


def _sensor(sensor: str | None, folder: Path) -> str | None:
    """A sensor's path if there is one, else its name: a folder of touches may well be called after their sensor."""
    if sensor is None:
        return None
    place = folder / sensor
    is_path = Path(sensor).suffix == ".toml" or "/" in sensor
    if (is_path and place.exists()) or is_calibrated_sensor(place):
        return str(place)
    if is_path:
        raise ValueError(f"there is no sensor {place}; it is relative to the list")
    return sensor
