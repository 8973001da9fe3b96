"""Reads priors from TOML files, in mm and degrees: a Gaussian about a pose, a list of poses, a box or a half-space."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.priors import GaussianPrior, HypothesesPrior, PosePrior, RegionPrior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.listed_poses import SUFFIXES, Scale, read_listed_poses
from tactile_loc.io.toml import (
    MATRIX,
    POSITIVE_MM,
    Matrix,
    PoseKeys,
    Positive,
    Three,
    name_errors,
    name_pose_keys,
    read_toml,
)

Frame = Literal["sensor", "base"]
Bounds = Annotated[list[Annotated[float, Field(allow_inf_nan=True)]], Field(min_length=3, max_length=3)]
FRAME = "'sensor' or 'base', the frame of the other numbers"
KIND = "'gaussian', 'hypotheses', 'region' or 'half-space'"
STD_DEG = "a positive number (degrees), left out if the rotation is unknown"


@dataclass(frozen=True, eq=False)
class FramedPrior:
    """A prior, and the frame that its file states: "sensor" or "base". `source` names the file."""

    prior: PosePrior
    frame: Frame
    source: str

    def view_from(self, T_base_sensor: Floats | None) -> PosePrior:
        """Return the prior of T_sensor_object for a sensor at `T_base_sensor` (4, 4), metres.

        Raises ConfigError when the prior is in the base frame and the sensor's pose is unknown.
        """
        if self.frame == "sensor":
            return self.prior
        if T_base_sensor is None:
            raise ConfigError(
                f"{self.source} is in the base frame, but the touch has no sensor pose; write the touch with its "
                'T_base_sensor into a list (.toml) and give that as `touch`, or set frame = "sensor"'
            )
        return self.prior.view_from(T_base_sensor)


class _Gaussian(PoseKeys):
    kind: Literal["gaussian"] = Field(description=KIND)
    frame: Frame = Field(description=FRAME)
    T: Matrix | None = Field(None, description=MATRIX)
    translation_std_mm: Positive = Field(description=POSITIVE_MM)
    rotation_std_deg: Positive | None = Field(None, description=STD_DEG)

    def make(self, obj: ObjectModel) -> PosePrior:
        T = self.read_pose("T")
        if T is None:
            raise ValueError(f"the pose is missing; {name_pose_keys('T')}")
        return _make_gaussian(self, T, obj)


class _Hypotheses(PoseKeys):
    kind: Literal["hypotheses"] = Field(description=KIND)
    frame: Frame = Field(description=FRAME)
    poses: str = Field(description="the path of a .csv, .npz or .json file with poses, from this file")
    scores: Scale = Field("proportional", description="'proportional', 'log' or 'equal'")
    T: Matrix | None = Field(None, description=f"the camera's pose, {MATRIX}")
    translation_std_mm: Positive = Field(description=POSITIVE_MM)
    rotation_std_deg: Positive | None = Field(None, description=STD_DEG)

    def make(self, obj: ObjectModel) -> PosePrior:
        T, listed = self.read_pose("T"), read_listed_poses(Path(self.poses))
        poses = listed.T_camera_object if T is None else T @ listed.T_camera_object
        return HypothesesPrior(tuple(_make_gaussian(self, one, obj) for one in poses), listed.weigh(self.scores))


class _Placed(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    frame: Frame = Field(description=FRAME)
    object_point_mm: Three | None = Field(
        None, description="[x, y, z] (mm), a point of the object in its own frame, by default its centroid"
    )

    def find_point_m(self, obj: ObjectModel) -> Floats:
        return obj.mesh.centroid_m if self.object_point_mm is None else 1e-3 * np.array(self.object_point_mm)


class _Region(_Placed):
    kind: Literal["region"] = Field(description=KIND)
    low_mm: Bounds = Field([-math.inf] * 3, description="[x, y, z] (mm), -inf without a bound")
    high_mm: Bounds = Field([math.inf] * 3, description="[x, y, z] (mm), inf without a bound")

    def make(self, obj: ObjectModel) -> PosePrior:
        if not all(low < high for low, high in zip(self.low_mm, self.high_mm, strict=True)):
            raise ValueError(
                f"the region is empty: low_mm = {self.low_mm} and high_mm = {self.high_mm}; each number of low_mm must "
                "be below that of high_mm"
            )
        return RegionPrior(1e-3 * np.array(self.low_mm), 1e-3 * np.array(self.high_mm), self.find_point_m(obj))


class _HalfSpace(_Placed):
    kind: Literal["half-space"] = Field(description=KIND)
    normal: Three = Field(description="[x, y, z], pointing from the plane to the object's side")
    plane_point_mm: Three = Field(description="[x, y, z] (mm), a point of the plane")

    def make(self, obj: ObjectModel) -> PosePrior:
        return RegionPrior.half_space(self.normal, 1e-3 * np.array(self.plane_point_mm), self.find_point_m(obj))


_KINDS: dict[str, type[_Gaussian | _Hypotheses | _Region | _HalfSpace]] = {
    "gaussian": _Gaussian,
    "hypotheses": _Hypotheses,
    "region": _Region,
    "half-space": _HalfSpace,
}


def _make_gaussian(keys: _Gaussian | _Hypotheses, T: Floats, obj: ObjectModel) -> GaussianPrior:
    """Return the Gaussian prior about the pose T (4, 4), metres, with the deviations of a table."""
    rotation_std_deg = math.inf if keys.rotation_std_deg is None else keys.rotation_std_deg
    return GaussianPrior(T, 1e-3 * keys.translation_std_mm, math.radians(rotation_std_deg), obj.symmetry)


def read_prior(path: str | Path, obj: ObjectModel) -> FramedPrior:
    """Read a prior about an object's pose from a TOML file (mm and degrees).

    The key `kind` is "gaussian", "hypotheses", "region" or "half-space". A Gaussian prior, and that of each hypothesis,
    respects the object's symmetry. A region or half-space contains the object's centroid, or the point of the object
    that the file gives. Raises ConfigError when the file is missing, or a key is missing, unknown or ill-typed.
    """
    path = Path(path)
    if path.suffix.lower() in SUFFIXES:
        raise ConfigError(
            f"{path} is no prior; a prior is a TOML file, which names such a list of poses: "
            f'kind = "hypotheses", poses = "{path.name}"'
        )
    values = read_toml(path)
    if isinstance(values.get("poses"), str):
        values["poses"] = str(path.parent / values["poses"])
    model = _KINDS.get(str(values.get("kind")), _Gaussian)
    with name_errors(path, model, values, f"a prior of kind {values.get('kind')!r}", decisive="kind"):
        keys = model(**values)
        return FramedPrior(keys.make(obj), keys.frame, str(path))
