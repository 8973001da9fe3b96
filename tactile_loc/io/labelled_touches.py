"""Reads touches with known poses: a CSV table, the poses.json of `simulate`, or a list of touches (.toml).

docs/files.md describes the formats.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import (
    invert,
    make_transform,
    quaternion_to_rotation,
    require_rigid,
    require_unit,
    rotation_about,
)
from tactile_loc.core.runtime.errors import TouchError, name_source
from tactile_loc.io.csv_tables import Row, read_number, read_table, require_columns
from tactile_loc.io.touch_lists import ListedTouch, read_touch_list
from tactile_loc.io.touches import read_contents
from tactile_loc.store.files import read_json

Pose = NDArray[np.float64]

NAMES = ("poses.csv", "touches.toml", "poses.json")  # looked for in a folder, in this order
PLACE = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
TURN = ("turn_deg", "axis_x", "axis_y", "axis_z")
REST_M = 2e-3  # poses of one object at rest that differ by more are contradictory


@dataclass(frozen=True, eq=False)
class LabelledTouch:
    """A touch's file and settings, and its known pose `T_sensor_object` (4, 4), metres.

    If its `listed.T_base_sensor` is None, the pose of the sensor is known only from the file, if at all.
    """

    listed: ListedTouch
    T_sensor_object: Pose


Example = tuple[LabelledTouch, ...]


def read_labelled_touches(path: str | Path) -> tuple[Example, ...]:
    """Read touches with known poses, as examples: an example has one or several touches of one object at rest.

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
    examples: dict[str, list[LabelledTouch]] = {}
    for number, row in enumerate(table.rows, start=1):
        with name_source(f"{path}, row {number}"):
            name = row.get("example") or f"row {number}"
            examples.setdefault(name, []).append(_read_row(path.parent, row, rotation))
    return [tuple(touches) for touches in examples.values()]


def _read_row(folder: Path, row: Row, rotation: Sequence[str]) -> LabelledTouch:
    file = _require_touch(folder, row["touch"])
    place_m = 1e-3 * np.array([read_number(row, name, TouchError) for name in PLACE])
    numbers = np.array([read_number(row, name, TouchError) for name in rotation])
    if rotation == QUATERNION:
        R = quaternion_to_rotation(require_unit(numbers, "the quaternion", TouchError))
    else:
        R = rotation_about(require_unit(numbers[1:], "the axis", TouchError), np.radians(numbers[0]))
    return LabelledTouch(ListedTouch(file), make_transform(R, place_m))


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
            yield (LabelledTouch(ListedTouch(file), require_rigid(T, "T_sensor_object", TouchError)),)


def _read_list(path: Path) -> list[Example]:
    """Read a list of touches as one example. Touches whose pose is missing get it from the sensors' poses."""
    listed = read_touch_list(path)
    known = [_find_pose(one) for one in listed]
    bases = [
        T_base_sensor @ T
        for one, T in zip(listed, known, strict=True)
        if T is not None and (T_base_sensor := one.T_base_sensor) is not None
    ]
    touches = []
    for number, (one, T) in enumerate(zip(listed, known, strict=True), start=1):
        if T is None and bases and one.T_base_sensor is not None:
            T = invert(one.T_base_sensor) @ bases[0]
        if T is None:
            raise TouchError(
                f"{path}, touch {number}: the true pose is missing; give T_sensor_object (four rows, metres)"
            )
        touches.append(LabelledTouch(one, T))
    _require_rest(path, bases)
    return [tuple(touches)]


def _find_pose(listed: ListedTouch) -> Pose | None:
    """Return the true pose (4, 4), metres, that a list or the touch's file gives; None if there is none."""
    if listed.T_sensor_object is not None or listed.path.suffix.lower() != ".npz":
        return listed.T_sensor_object
    return read_contents(listed.path).T_sensor_object


def _require_rest(path: Path, bases: Sequence[Pose]) -> None:
    """Raise TouchError if the poses and the sensors' poses put the object at different places."""
    apart_m = max((float(np.linalg.norm(T[:3, 3] - bases[0][:3, 3])) for T in bases), default=0.0)
    if apart_m > REST_M:
        raise TouchError(
            f"{path}: T_base_sensor and T_sensor_object put the object at places {1e3 * apart_m:.1f} mm apart; "
            "it must be at rest; check both poses of each touch"
        )
