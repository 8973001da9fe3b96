"""Where a sensor is mounted on a robot's flange, as a TOML file: what `tactile-loc mount` found, or a drawing says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.geometry.rigid import move_covariance
from tactile_loc.io.toml import (
    MATRIX,
    Finite,
    Matrix,
    PoseKeys,
    Positive,
    format_toml,
    name_errors,
    read_pose,
    read_toml,
)
from tactile_loc.store.files import write_atomically

Six = Annotated[list[Finite], Field(min_length=6, max_length=6)]
Covariance = Annotated[list[Six], Field(min_length=6, max_length=6)]


@dataclass(frozen=True, eq=False)
class Mount:
    """Where a sensor is mounted: `T_flange_sensor` (4, 4), metres.

    `covariance` (6, 6), if it is known, is that of the error of x, y, z of the sensor frame's origin (m) and of a
    rotation vector (rad), both along the flange's axes.
    """

    T_flange_sensor: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None

    def find_std_at(self, point_m: NDArray[np.float64]) -> tuple[float, float]:
        """Return the standard deviation (m, rad) along and about an axis at a point (3,) of the sensor, or 0."""
        if self.covariance is None:
            return 0.0, 0.0
        there = move_covariance(self.covariance, self.T_flange_sensor[:3, :3] @ point_m)
        std_m, std_rad = (float(np.sqrt(np.trace(there[part, part]) / 3)) for part in (slice(3), slice(3, 6)))
        return std_m, std_rad


class MountTouchRecord(BaseModel):
    """One touch of those that a mount was found from; its residual is that of the gel's middle."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="the touch's name")
    residual_m: float | None = Field(default=None, description="by how much it contradicts the mount, m")
    residual_rad: float | None = Field(default=None, description="the same, rad")
    first_residual_m: float | None = Field(default=None, description="by how much it contradicted the first guess, m")
    first_residual_rad: float | None = Field(default=None, description="the same, rad")
    imprint_iou: float | None = Field(default=None, description="how well the object's pose explains it, 0 to 1")
    left_out: str = Field(default="", description="why it had no say; empty if it had")


class MountRecord(PoseKeys):
    """The whole file. A nominal mount is its pose alone; a field's description completes "key must be ..."."""

    T_flange_sensor: Matrix | None = Field(default=None, description=MATRIX)
    covariance: Covariance | None = Field(
        default=None,
        description="six rows of six numbers (m before rad, along the flange's axes)",
    )
    T_base_object: Matrix | None = Field(default=None, description=MATRIX)
    object: str | None = Field(default=None, description="the object's name, in quotes")
    sensor: str | None = Field(default=None, description="the sensor's name, in quotes")
    variance_factor: Positive | None = Field(
        default=None, description="a positive number: by how much residuals enlarged the touches' variances"
    )
    touch: list[MountTouchRecord] = Field(default_factory=list, description="[[touch]] tables")


def read_mount(path: str | Path) -> Mount:
    """Read a mount: `T_flange_sensor` (4, 4), metres, or `xyz_mm` with `rpy_deg` or `quaternion_wxyz`.

    Raises ConfigError, in one sentence, when the file is missing or a key is missing, unknown or wrong.
    """
    path, values = Path(path), read_toml(path)
    with name_errors(path, MountRecord, values, "a mount"):
        keys = MountRecord(**values)
        T = read_pose(keys, keys.T_flange_sensor, "T_flange_sensor")
        covariance = None if keys.covariance is None else _check_covariance(np.array(keys.covariance))
        if T is None:
            raise ValueError(
                "the mount is missing; give T_flange_sensor, or xyz_mm with either rpy_deg or quaternion_wxyz"
            )
        return Mount(T, covariance)


def write_mount(path: Path, record: MountRecord) -> Path:
    """Write a mount as TOML, atomically, and return the path. Raises OutputError when that is impossible."""
    text = format_toml(record.model_dump(mode="json", exclude_none=True))
    return write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _check_covariance(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.allclose(covariance, covariance.T, atol=1e-12) or np.linalg.eigvalsh(covariance).min() < 0:
        raise ValueError("covariance is none: it must be symmetric, with no negative variance")
    return covariance
