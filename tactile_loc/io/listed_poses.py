"""Poses of an object that another system lists, with scores: BOP results, arrays, or detections of ROS."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tactile_loc.core.geometry.rigid import (
    FARTHEST_M,
    Floats,
    Poses,
    make_transform,
    quaternion_to_rotation,
    require_rigid,
    require_unit,
)
from tactile_loc.core.runtime.errors import ConfigError, name_source, quote
from tactile_loc.io.csv_tables import Row, read_number, read_table, require_columns
from tactile_loc.store.arrays import convert_damage, load_npz
from tactile_loc.store.files import read_text

Scale = Literal["proportional", "log", "equal"]
BOP = ("scene_id", "im_id", "obj_id")  # columns that must have one value in a file
NEAREST_BOP_M = 5e-3  # from a camera; a smaller distance has another unit
SUFFIXES = (".csv", ".npz", ".json")


@dataclass(frozen=True, eq=False)
class ListedPoses:
    """Poses of an object in the camera frame, `T_camera_object` (K, 4, 4), metres, with `scores` (K,) or without."""

    T_camera_object: Poses
    scores: Floats | None

    def __post_init__(self) -> None:
        count = len(self.T_camera_object)
        if not count:
            raise ConfigError("the list has no poses; add at least one")
        rigid = np.array([require_rigid(T, f"pose {k}") for k, T in enumerate(self.T_camera_object, 1)])
        object.__setattr__(self, "T_camera_object", rigid)
        _require_distance(rigid, 0.0)
        if self.scores is None:
            return
        if np.shape(self.scores) != (count,):
            raise ConfigError(f"there are {count} poses and {np.size(self.scores)} scores")
        if not np.isfinite(self.scores).all():
            raise ConfigError("a score is not a finite number")

    def weigh(self, scale: Scale) -> Floats:
        """Return the probabilities (K,) of the poses, with the sum 1.

        They are proportional to the scores, or the scores are their logs, or all are equal. Raises ConfigError without
        scores, and for scores that cannot be proportional to probabilities.
        """
        if scale == "equal":
            weights = np.ones(len(self.T_camera_object))
        elif self.scores is None:
            raise ConfigError('the list has no scores; set scores = "equal", or add them')
        elif scale == "log":
            weights = np.exp(self.scores - self.scores.max())
        elif (self.scores < 0).any() or not self.scores.any():
            raise ConfigError(
                f"scores from {self.scores.min():g} to {self.scores.max():g} are no probabilities; "
                'set scores = "log" if they are logs, or scores = "equal" to ignore them'
            )
        else:
            weights = self.scores
        return np.asarray(weights / weights.sum())


def read_listed_poses(path: Path) -> ListedPoses:
    """Read a list of poses.

    A `.csv` file has the results of BOP for one image and object (R without unit, t in mm). A `.npz` file has `poses`
    (K, 4, 4), metres, and `scores` (K,) or none. A `.json` file has a vision_msgs Detection3DArray. Raises ConfigError
    if the file is missing, has another form, or has poses that are not rigid or have another unit.
    """
    readers = {".csv": _read_bop, ".npz": _read_arrays, ".json": _read_json}
    if (read := readers.get(path.suffix.lower())) is None:
        raise ConfigError(f"{path} has none of the suffixes {', '.join(SUFFIXES)}; rename it, or convert it")
    try:
        with convert_damage():
            return read(path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror or error}); check the path") from error
    except ValueError as error:
        with name_source(path):
            raise ConfigError(str(error)) from error


def read_detections(message: Any) -> ListedPoses:
    """Return the poses of a vision_msgs Detection3DArray, which is a message, or nested mappings with its fields.

    All hypotheses of all detections count. Raises ConfigError if a field is missing, or if hypotheses have several
    values of `class_id`.
    """
    found = [result for detection in _list(message, "detections") for result in _list(detection, "results")]
    classes = {str(_get(_get(result, "hypothesis"), "class_id")) for result in found}
    if len(classes) > 1:
        raise ConfigError(f"the detections are of several objects ({', '.join(sorted(classes))}); keep those of one")
    poses = [_read_ros_pose(_get(_get(result, "pose"), "pose")) for result in found]
    scores = [_number(_get(_get(result, "hypothesis"), "score")) for result in found]
    return ListedPoses(np.reshape(poses, (-1, 4, 4)), np.array(scores))


def _read_bop(path: Path) -> ListedPoses:
    table = read_table(path, "pose", ConfigError)
    require_columns(path, table.columns, ("score", "R", "t"), ConfigError, "; the results of BOP have score, R and t")
    for name in BOP:
        if len(values := {row.get(name) for row in table.rows}) > 1:
            raise ConfigError(f"the column {name} has {len(values)} values; keep the rows of one image and one object")
    poses, scores = [], []
    for number, row in enumerate(table.rows, 1):
        with name_source(f"row {number}"):
            R, t_mm = _read_numbers(row, "R", 9).reshape(3, 3), _read_numbers(row, "t", 3)
            poses.append(make_transform(R, 1e-3 * t_mm))
            scores.append(read_number(row, "score", ConfigError))
    listed = ListedPoses(np.array(poses), np.array(scores))
    _require_distance(listed.T_camera_object, NEAREST_BOP_M)
    return listed


def _read_numbers(row: Row, name: str, count: int) -> Floats:
    try:
        numbers = np.array([float(word) for word in row[name].split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != count:
        raise ConfigError(f"{name} = {quote(row[name])} is not {count} numbers, separated by spaces")
    return numbers


def _read_arrays(path: Path) -> ListedPoses:
    arrays = load_npz(path, ("poses", "scores"))
    if "poses" not in arrays:
        raise ConfigError("there is no array 'poses'; save poses (K, 4, 4), metres, and scores (K,)")
    poses = np.asarray(arrays["poses"], float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ConfigError(f"poses has the shape {poses.shape}; it must be (K, 4, 4)")
    return ListedPoses(poses, np.asarray(arrays["scores"], float) if "scores" in arrays else None)


def _read_json(path: Path) -> ListedPoses:
    return read_detections(json.loads(read_text(path)))


def _read_ros_pose(pose: Any) -> Floats:
    """Return the pose (4, 4), metres, of a geometry_msgs Pose."""
    position, quaternion = _get(pose, "position"), _get(pose, "orientation")
    t_m = np.array([_number(_get(position, axis)) for axis in "xyz"])
    wxyz = require_unit([_number(_get(quaternion, axis)) for axis in "wxyz"], "the quaternion of an orientation")
    return make_transform(quaternion_to_rotation(wxyz), t_m)


def _get(value: Any, name: str) -> Any:
    """Return a field of a message or of a mapping."""
    if isinstance(value, Mapping) and name in value:
        return value[name]
    if not isinstance(value, Mapping | list | str | float | int | None) and hasattr(value, name):
        return getattr(value, name)
    raise ConfigError(f"there is no field {name!r}; give a vision_msgs Detection3DArray")


def _list(value: Any, name: str) -> Sequence[Any]:
    """Return a field that is a sequence."""
    if isinstance(found := _get(value, name), str | Mapping) or not isinstance(found, Sequence):
        raise ConfigError(f"{name} is no list; give a vision_msgs Detection3DArray")
    return found


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{value!r} is not a number; give a vision_msgs Detection3DArray")
    return float(value)


def _require_distance(T_camera_object: Poses, nearest_m: float) -> None:
    """Raise ConfigError unless the median distance of poses (K, 4, 4) is from `nearest_m` to FARTHEST_M."""
    distance_m = float(np.median(np.linalg.norm(T_camera_object[:, :3, 3], axis=1)))
    if not nearest_m <= distance_m <= FARTHEST_M:
        raise ConfigError(
            f"the object is {distance_m:.3g} m from the camera, so the unit of the translations is probably wrong; "
            "give mm in .csv, and metres in .npz and .json"
        )
