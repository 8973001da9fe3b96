"""Poses in TOML files: a (4, 4) matrix in metres, or millimetres with angles or a quaternion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.geometry import is_rigid, make_transform, quaternion_to_rotation, rotation_about
from tactile_loc.core.toml_keys import Finite

Three = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Four = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Four], Field(min_length=4, max_length=4)]

MATRIX = "four rows of four numbers (rotation without unit, translation in metres, last row 0 0 0 1)"
UNIT_TOLERANCE = 1e-3  # of a quaternion's length: rounded to four digits it is still meant as one


class PoseKeys(BaseModel):
    """The keys of a pose but for the matrix, whose name tells the frames. Unknown ones are refused.

    A field's description completes "key must be ...".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    xyz_mm: Three | None = Field(None, description="[x, y, z] (mm)")
    rpy_deg: Three | None = Field(
        None, description="[roll, pitch, yaw] (degrees), about the fixed axes x, y, z in this order"
    )
    quaternion_wxyz: Four | None = Field(None, description="[w, x, y, z], a unit quaternion, scalar first")


def pose_from_keys(keys: PoseKeys, matrix: Sequence[Sequence[float]] | None, name: str) -> NDArray[np.float64] | None:
    """Return the pose (4, 4), metres, of `matrix`, the key called `name`, or of the other keys; None if there is none.

    R = Rz(yaw) Ry(pitch) Rx(roll), as in URDF. Raises ValueError that says what is wrong.
    """
    given = [key for key in ("xyz_mm", "rpy_deg", "quaternion_wxyz") if getattr(keys, key) is not None]
    if matrix is not None:
        if given:
            raise ValueError(f"{name} is the whole pose; leave {given[0]} out")
        T = np.array(matrix, float)
        if not is_rigid(T):
            raise ValueError(f"{name} is no rigid transform; it must be {MATRIX}")
        return T
    if not given:
        return None
    if "xyz_mm" not in given or len(given) != 2:
        raise ValueError(f"a pose is {name}, or xyz_mm with either rpy_deg or quaternion_wxyz, not {', '.join(given)}")
    return make_transform(_rotation(keys), 1e-3 * np.array(keys.xyz_mm))


def _rotation(keys: PoseKeys) -> NDArray[np.float64]:
    if keys.rpy_deg is not None:
        roll, pitch, yaw = (
            rotation_about(axis, angle) for axis, angle in zip(np.eye(3), np.radians(keys.rpy_deg), strict=True)
        )
        return yaw @ pitch @ roll
    q = np.array(keys.quaternion_wxyz, float)
    length = float(np.linalg.norm(q))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"quaternion_wxyz has the length {length:.4g}; it must be a unit quaternion, scalar first")
    return quaternion_to_rotation(q / length)
