"""Reads and writes mounts as TOML files. A mount is a sensor's pose on a robot's flange.

`tactile-loc mount` finds a mount from touches. A nominal mount is taken from a drawing.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.geometry.lie import move_covariance
from tactile_loc.core.geometry.rigid import Floats, require_covariance
from tactile_loc.io.toml import (
    MATRIX,
    Finite,
    Matrix,
    PoseKeys,
    Positive,
    format_toml,
    name_errors,
    name_pose_keys,
    read_toml,
)
from tactile_loc.store.files import write_text

Six = Annotated[list[Finite], Field(min_length=6, max_length=6)]
Covariance = Annotated[list[Six], Field(min_length=6, max_length=6)]


@dataclass(frozen=True, eq=False)
class Mount:
    """A sensor's pose on the flange: `T_flange_sensor` (4, 4), metres.

    `covariance` (6, 6) is the covariance of the sensor frame's origin x, y, z (m) and of a rotation vector (rad), both
    along the flange's axes. It is None if unknown.
    """

    T_flange_sensor: Floats
    covariance: Floats | None = None

    def find_std_at(self, point_m: Floats) -> tuple[float, float]:
        """Return the standard deviations of position (m) and rotation (rad) at a point (3,), m, in the sensor frame.

        Each is the root mean square over the three axes. Both are 0 if the covariance is unknown.
        """
        if self.covariance is None:
            return 0.0, 0.0
        there = move_covariance(self.covariance, self.T_flange_sensor[:3, :3] @ point_m)
        std_m, std_rad = (float(np.sqrt(np.trace(there[part, part]) / 3)) for part in (slice(3), slice(3, 6)))
        return std_m, std_rad


class HandEyeTouchRecord(BaseModel):
    """One of the touches from which a mount was computed. Residuals refer to the middle of the gel."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="the touch's name")
    residual_m: float | None = Field(default=None, description="distance from where the mount puts the gel, m")
    residual_rad: float | None = Field(default=None, description="the same, rad")
    first_residual_m: float | None = Field(default=None, description="residual of the first guess, m")
    first_residual_rad: float | None = Field(default=None, description="the same, rad")
    imprint_iou: float | None = Field(default=None, description="how well the object's pose explains it, 0 to 1")
    left_out: str = Field(default="", description="why it was left out; empty if it was used")


class HandEyeRecord(PoseKeys):
    """The content of a mount's file. A nominal mount has only a pose.

    A field's description completes "key must be ...".
    """

    T_flange_sensor: Matrix | None = Field(default=None, description=MATRIX)
    covariance: Covariance | None = Field(
        default=None,
        description="six rows of six numbers: the covariance of the sensor frame's origin x, y, z (m) and of a "
        "rotation vector (rad), both along the flange's axes",
    )
    T_base_object: Matrix | None = Field(default=None, description=MATRIX)
    object: str | None = Field(default=None, description="the object's name, in quotes")
    sensor: str | None = Field(default=None, description="the sensor's name, in quotes")
    variance_factor: Positive | None = Field(
        default=None, description="a positive number, the factor by which residuals enlarged the touches' variances"
    )
    touch: list[HandEyeTouchRecord] = Field(default_factory=list, description="[[touch]] tables")


def read_mount(path: str | Path) -> Mount:
    """Read a mount from a TOML file.

    The pose is `T_flange_sensor` (4, 4), metres, or is given by the keys of `PoseKeys`. Raises ConfigError
    when the file is missing, or a key is missing, unknown or wrong.
    """
    path, values = Path(path), read_toml(path)
    with name_errors(path, HandEyeRecord, values, "a mount"):
        keys = HandEyeRecord(**values)
        T = keys.read_pose("T_flange_sensor")
        covariance = None if keys.covariance is None else require_covariance(keys.covariance, "covariance")
        if T is None:
            raise ValueError(f"the mount is missing; {name_pose_keys('T_flange_sensor')}")
        return Mount(T, covariance)


def write_mount(path: Path, record: HandEyeRecord) -> Path:
    """Write a mount as TOML, atomically, and return the path. Raises OutputError if that fails."""
    text = format_toml(record.model_dump(mode="json", exclude_none=True))
    return write_text(path, text)
