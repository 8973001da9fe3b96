"""Reads and writes approaches as TOML. An approach is a touch that could be made: its start pose, press and cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from tactile_loc.core.geometry.rigid import Floats, require_rigid
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
from tactile_loc.store.files import write_text

TRAVEL_M = 0.1


@dataclass(frozen=True, eq=False)
class Approach:
    """A touch that could be made: the sensor starts at `T_base_sensor` (4, 4), and moves along its z until contact.

    The sensor then presses `press_m` deep. If `press_m` is None, it presses as deep as in the previous touch. Without
    contact, it stops after `travel_m`. `cost`, in any unit, is positive, and infinite if the pose cannot be reached.
    Lengths are in metres. Raises ConfigError if `T_base_sensor` is not a rigid transform.
    """

    T_base_sensor: Floats
    press_m: float | None = None
    travel_m: float = TRAVEL_M
    cost: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        named = f"T_base_sensor of {self.name or 'an approach'}"
        object.__setattr__(self, "T_base_sensor", require_rigid(self.T_base_sensor, named))


class _ApproachTable(PoseKeys):
    name: str | None = Field(None, min_length=1, description="the approach's name, in quotes")
    T_base_sensor: Matrix | None = Field(None, description=MATRIX)
    T_sensor_next: Matrix | None = Field(None, description=MATRIX)
    press_depth_mm: Positive | None = Field(None, description=POSITIVE_MM)
    travel_mm: Positive | None = Field(None, description=POSITIVE_MM)
    cost: Annotated[float, Field(gt=0)] = Field(1.0, description="a positive number, or inf if it cannot be reached")


def read_approaches(path: str | Path, T_base_sensor: Floats | None = None) -> tuple[Approach, ...]:
    """Read the `[[approach]]` tables of a TOML file, in their order.

    A table gives the sensor's start pose in the base frame or in the sensor frame of the previous touch. In the base
    frame, the keys are `T_base_sensor` (4, 4), metres, or those of `PoseKeys`. In the sensor frame, the key is
    `T_sensor_next` (4, 4), metres. A start pose in the base frame needs the sensor's pose in the previous touch, which
    is the argument `T_base_sensor` (4, 4). Raises ConfigError, which names the file and the approach, when a table is
    wrong.
    """
    path = Path(path)
    approaches = []
    tables = list_tables(path, read_toml(path), "approach", "its start pose")
    for number, table in enumerate(tables, start=1):
        with name_errors(f"{path}, approach {number}", _ApproachTable, table, "an approach"):
            keys = _ApproachTable(**table)
            start, travel_m = _place_start(keys, T_base_sensor), scale(keys.travel_mm) or TRAVEL_M
            name = keys.name or f"approach {number}"
            approaches.append(Approach(start, scale(keys.press_depth_mm), travel_m, keys.cost, name))
    return tuple(approaches)


def write_approaches(path: str | Path, approaches: Sequence[Approach], in_base: bool) -> Path:
    """Write approaches as TOML, atomically, and return the path. Raises OutputError if that fails.

    The start poses are in the base frame, or without `in_base` in the sensor frame of the previous touch.
    """
    key = "T_base_sensor" if in_base else "T_sensor_next"
    tables = [
        {
            "name": approach.name or None,
            key: approach.T_base_sensor.tolist(),
            "press_depth_mm": None if approach.press_m is None else 1e3 * approach.press_m,
            "travel_mm": 1e3 * approach.travel_m,
            "cost": approach.cost,
        }
        for approach in approaches
    ]
    text = format_toml({"approach": tables})
    return write_text(Path(path), text)


def _place_start(keys: _ApproachTable, T_base_first: Floats | None) -> Floats:
    """Return the start pose in the base frame, or in the previous touch's sensor frame if that touch has no pose."""
    T, motion = keys.read_pose("T_base_sensor"), to_array(keys.T_sensor_next)
    if motion is not None:
        if T is not None:
            raise ValueError("the start pose is given twice; leave out T_sensor_next, or the pose in the base frame")
        return motion if T_base_first is None else T_base_first @ motion
    if T is None:
        raise ValueError(f"the start pose is missing; {name_pose_keys('T_sensor_next, T_base_sensor')}")
    if T_base_first is None:
        raise ValueError(
            "a start pose in the base frame needs T_base_sensor of the previous touch; locate that touch again from a "
            "list with T_base_sensor, or give T_sensor_next"
        )
    return T
