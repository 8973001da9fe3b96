"""Touches that could be made, as a TOML file: where each sensor would start, how deep it would press, what it costs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.geometry.rigid import require_rigid
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

Pose = NDArray[np.float64]

TRAVEL_M = 0.1


@dataclass(frozen=True, eq=False)
class Approach:
    """A touch that could be made: the sensor starts at `T_base_sensor` (4, 4), and moves along its z until contact.

    Then it presses by `press_m`; None: as deep as the touch before. If it meets nothing within `travel_m` it stops.
    `cost`, of any unit, is above 0; infinite where it cannot be reached. Lengths in metres. Raises ConfigError for a
    start that is no rigid transform.
    """

    T_base_sensor: Pose
    press_m: float | None = None
    travel_m: float = TRAVEL_M
    cost: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        named = f"T_base_sensor of {self.name or 'an approach'}"
        object.__setattr__(self, "T_base_sensor", require_rigid(self.T_base_sensor, named))


class _ApproachTable(PoseKeys):
    name: str | None = Field(None, min_length=1, description="what to call it, in quotes")
    T_base_sensor: Matrix | None = Field(None, description=MATRIX)
    T_sensor_next: Matrix | None = Field(None, description=MATRIX)
    press_depth_mm: Positive | None = Field(None, description="a positive number (mm)")
    travel_mm: Positive | None = Field(None, description="a positive number (mm)")
    cost: Annotated[float, Field(gt=0)] = Field(1.0, description="a positive number, or inf where it cannot be reached")


def read_approaches(path: str | Path, T_base_sensor: Pose | None = None) -> tuple[Approach, ...]:
    """Read the `[[approach]]` tables of a TOML file, in their order.

    Where a sensor starts is its `T_base_sensor`, (4, 4) in metres, or `xyz_mm` with `rpy_deg` or `quaternion_wxyz`; or
    `T_sensor_next`, seen from the sensor of the touch before, whose own pose `T_base_sensor` (4, 4) the first needs
    and the second does not. Raises ConfigError, which names the file and the approach.
    """
    path = Path(path)
    approaches = []
    tables = list_tables(path, read_toml(path), "approach", "where its sensor starts")
    for number, table in enumerate(tables, start=1):
        with name_errors(f"{path}, approach {number}", _ApproachTable, table, "an approach"):
            keys = _ApproachTable(**table)
            start, travel_m = _place_start(keys, T_base_sensor), scale(keys.travel_mm) or TRAVEL_M
            name = keys.name or f"approach {number}"
            approaches.append(Approach(start, scale(keys.press_depth_mm), travel_m, keys.cost, name))
    return tuple(approaches)


def _place_start(keys: _ApproachTable, T_base_first: Pose | None) -> Pose:
    """Where the sensor starts: in the base frame, or in that of the touch's sensor, if its pose is not known."""
    T = read_pose(keys, keys.T_base_sensor, "T_base_sensor")
    if keys.T_sensor_next is not None:
        if T is not None:
            raise ValueError("T_sensor_next tells where the sensor starts; leave its pose in the base frame out")
        motion = read_pose(PoseKeys(), keys.T_sensor_next, "T_sensor_next")
        assert motion is not None
        return motion if T_base_first is None else T_base_first @ motion
    if T is None:
        raise ValueError("its start is missing; give T_base_sensor, xyz_mm with rpy_deg, or T_sensor_next")
    if T_base_first is None:
        raise ValueError(
            "T_base_sensor cannot be used: the touch before does not say where its sensor was; give T_sensor_next, as "
            "seen from that sensor"
        )
    return T
