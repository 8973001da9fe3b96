"""Touches listed in a file, with sensor poses or known object poses. docs/files.md describes the formats.

A list of touches of one object is TOML. Touches with known poses are such a list, a CSV table, or the poses.json of
`simulate`.
"""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import (
    Floats,
    invert,
    make_transform,
    quaternion_to_rotation,
    require_near,
    require_rigid,
    require_unit,
    rotation_about,
)
from tactile_loc.core.runtime.errors import ConfigError, TouchError, name_source
from tactile_loc.core.sensing.depth_maps import DepthUnit, TouchKind
from tactile_loc.io.csv_tables import Row, read_number, read_table, require_columns
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
    read_toml,
    scale,
    to_array,
)
from tactile_loc.io.touches import read_contents
from tactile_loc.store.files import read_json, write_text

NAMES = ("poses.csv", "touches.toml", "poses.json")  # looked for in a folder, in this order
PLACE = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
TURN = ("turn_deg", "axis_x", "axis_y", "axis_z")
REST_M = 2e-3  # poses of one object at rest that differ by more are contradictory


@dataclass(frozen=True, eq=False)
class ListedTouch:
    """One touch of a list: its file and its other entries. Missing entries are None.

    `sensor` is a name, or the path of a .toml file or of a calibration folder. `unit` is the unit of the depths,
    and `kind` their meaning.
    `T_base_sensor` (4, 4), metres, comes from the list, or from the flange's pose `T_base_flange` (4, 4) and `mount`,
    or from the touch's file. `T_base_sensor_std_m` and `T_base_sensor_std_rad` are the standard deviations of the
    pose's error, without the error of the mount. `T_sensor_object` (4, 4), metres, is the known pose, for evaluations.
    """

    path: Path
    sensor: str | None = None
    unit: DepthUnit | None = None
    press_depth_m: float | None = None
    T_base_sensor: Floats | None = None
    T_base_sensor_std_m: float | None = None
    T_base_sensor_std_rad: float | None = None
    T_base_flange: Floats | None = None
    mount: Mount | None = None
    kind: TouchKind | None = None
    T_sensor_object: Floats | None = None


Example = tuple[ListedTouch, ...]  # touches of one object at rest


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
            touches.append(_read_listed(_TouchTable(**table), path.parent, mount, of_flange))
            if touches[-1].T_base_sensor is None and len(tables) > 1 and not of_flange:
                advice = name_pose_keys("T_base_sensor")
                raise ValueError(f"several touches need the sensor's pose, which is missing; {advice}")
    return tuple(touches)


def write_touch_list(path: str | Path, sensor_poses: Mapping[str, Floats], sensor: str | None = None) -> Path:
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
    T, F = keys.read_pose("T_base_sensor"), to_array(keys.T_base_flange)
    used = None
    if F is None and keys.mount is not None:
        raise ValueError("mount has no effect without T_base_flange; give the flange's pose, too")
    if F is None and of_flange:
        raise ValueError("the flange's pose is missing; give T_base_flange for each touch")
    if F is not None and not of_flange:
        used = mount if keys.mount is None else read_mount(folder / keys.mount)
        if used is None:
            raise ValueError('T_base_flange needs the sensor\'s mount; give its file, as mount = "mount.toml"')
        if T is not None:
            raise ValueError("the sensor's pose is given twice; leave out T_base_flange, or the pose of the sensor")
        T = F @ used.T_flange_sensor
    if T is None and file.suffix.lower() == ".npz":
        T = to_array(read_contents(file).T_base_sensor)
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
        to_array(keys.T_sensor_object),
    )


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


def read_labelled_touches(path: str | Path) -> tuple[Example, ...]:
    """Read touches with known poses `T_sensor_object`, as examples of one or several touches of one object at rest.

    `path` is a .csv table, a poses.json, a list of touches (.toml, one example), or a folder with poses.csv,
    touches.toml or poses.json. Raises TouchError when a file, a column or a pose is missing or wrong.
    """
    path = _find_table(Path(path))
    readers = {".csv": _read_csv, ".json": _read_poses, ".toml": _read_list}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise TouchError(f"{path} does not give touches with poses; give a .csv table, a poses.json, or a list (.toml)")
    return tuple(read(path))


def _find_table(path: Path) -> Path:
    if os.path.isdir(path):
        found = [path / name for name in NAMES if (path / name).is_file()]
        if not found:
            raise TouchError(
                f"{path} has no {', '.join(NAMES[:-1])} or {NAMES[-1]}; give its touches' poses in such a file"
            )
        return found[0]
    if not os.path.isfile(path):
        raise TouchError(f"there is no file {path}; check the path")
    return path


def _read_csv(path: Path) -> list[Example]:
    table = read_table(path, "touch", TouchError)
    columns = table.columns
    rotation = QUATERNION if set(QUATERNION) & set(columns) or not set(TURN) & set(columns) else TURN
    advice = f"; needed are touch, {', '.join(PLACE)}, and {', '.join(QUATERNION)} or {', '.join(TURN)}"
    require_columns(path, columns, ("touch", *PLACE, *rotation), TouchError, advice)
    examples: dict[str, list[ListedTouch]] = {}
    for number, row in enumerate(table.rows, start=1):
        with name_source(f"{path}, row {number}"):
            name = row.get("example") or f"row {number}"
            examples.setdefault(name, []).append(_read_row(path.parent, row, rotation))
    return [tuple(touches) for touches in examples.values()]


def _read_row(folder: Path, row: Row, rotation: Sequence[str]) -> ListedTouch:
    file = _require_touch(folder, row["touch"])
    place_m = 1e-3 * np.array([read_number(row, name, TouchError) for name in PLACE])
    numbers = np.array([read_number(row, name, TouchError) for name in rotation])
    if rotation == QUATERNION:
        R = quaternion_to_rotation(require_unit(numbers, "the quaternion", TouchError))
    else:
        R = rotation_about(require_unit(numbers[1:], "the axis", TouchError), np.radians(numbers[0]))
    T = require_near(make_transform(R, place_m), "the place", TouchError)
    return ListedTouch(file, T_sensor_object=T)


def _require_touch(folder: Path, name: str) -> Path:
    if not name.strip():
        raise TouchError("the touch's file is missing; give it in the column 'touch'")
    file = folder / name.strip()
    if not os.path.isfile(file):
        raise TouchError(f"there is no file {file}; check the path, which is relative to the table")
    return file


def _read_poses(path: Path) -> Iterator[Example]:
    """Read the poses.json of `simulate`. Each touch is an example of its own."""
    try:
        values = read_json(path)
    except (OSError, ValueError) as error:
        raise TouchError(f"{path} is not JSON ({error}); give the poses.json that simulate wrote") from error
    poses = values.get("T_sensor_object") if isinstance(values, dict) else None
    if not isinstance(poses, dict) or not poses:
        raise TouchError(f"{path} has no T_sensor_object for each touch; give the poses.json that simulate wrote")
    for name, T in poses.items():
        with name_source(f"{path}, {name}"):
            file = _require_touch(path.parent, f"{name}.npz")
            T_sensor_object = require_rigid(T, "T_sensor_object", TouchError)
            yield (ListedTouch(file, T_sensor_object=require_near(T_sensor_object, "T_sensor_object", TouchError)),)


def _read_list(path: Path) -> list[Example]:
    """Read a list of touches as one example. Touches whose pose is missing get it from the sensors' poses."""
    touches = [_find_pose(one) for one in read_touch_list(path)]
    bases = [
        T_base_sensor @ T
        for one in touches
        if (T := one.T_sensor_object) is not None and (T_base_sensor := one.T_base_sensor) is not None
    ]
    for index, one in enumerate(touches):
        if one.T_sensor_object is None:
            if not bases or one.T_base_sensor is None:
                raise TouchError(
                    f"{path}, touch {index + 1}: the true pose is missing; give T_sensor_object (four rows, metres)"
                )
            touches[index] = replace(one, T_sensor_object=invert(one.T_base_sensor) @ bases[0])
    _require_rest(path, bases)
    return [tuple(touches)]


def _find_pose(listed: ListedTouch) -> ListedTouch:
    """Return a touch with the known pose that its file gives, if the list does not give it."""
    if listed.T_sensor_object is not None or listed.path.suffix.lower() != ".npz":
        return listed
    return replace(listed, T_sensor_object=to_array(read_contents(listed.path).T_sensor_object))


def _require_rest(path: Path, bases: Sequence[Floats]) -> None:
    """Raise TouchError if the poses and the sensors' poses put the object at different places."""
    apart_m = max((float(np.linalg.norm(T[:3, 3] - bases[0][:3, 3])) for T in bases), default=0.0)
    if apart_m > REST_M:
        raise TouchError(
            f"{path}: T_base_sensor and T_sensor_object put the object at places {1e3 * apart_m:.1f} mm apart; "
            "it must be at rest; check both poses of each touch"
        )
