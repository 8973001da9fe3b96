"""Poses of an object that another system lists, with scores: BOP results, arrays, or detections of ROS."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, make_transform, quaternion_to_rotation, require_rigid
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.store.arrays import convert_damage, load_npz
from tactile_loc.store.files import read_text

Scale = Literal["proportional", "log", "equal"]
BOP = ("scene_id", "im_id", "obj_id")  # columns that must have one value in a file
LEAST_QUATERNION = 1e-6  # length of a quaternion that has no direction
SUFFIXES = (".csv", ".npz", ".json")


@dataclass(frozen=True, eq=False)
class ListedPoses:
    """Poses of an object in the camera frame, `T_camera_object` (K, 4, 4), metres, with their `scores` (K,)."""

    T_camera_object: Poses
    scores: Floats

    def __post_init__(self) -> None:
        if not len(self.T_camera_object):
            raise ConfigError("the list has no poses; add at least one")
        if np.shape(self.scores) != (len(self.T_camera_object),):
            raise ConfigError(f"there are {len(self.T_camera_object)} poses and {np.size(self.scores)} scores")
        rigid = [require_rigid(T, f"pose {k}") for k, T in enumerate(self.T_camera_object, 1)]
        object.__setattr__(self, "T_camera_object", np.array(rigid))
        if not np.isfinite(self.scores).all():
            raise ConfigError("a score is not a finite number")

    def weigh(self, scale: Scale) -> Floats:
        """Return the probabilities (K,) of the poses, with the sum 1.

        They are proportional to the scores, or the scores are their logs, or all are equal. Raises ConfigError for
        scores that cannot be proportional to probabilities.
        """
        if scale == "equal":
            weights = np.ones(len(self.scores))
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
    (K, 4, 4), metres, and `scores` (K,). A `.json` file has a vision_msgs Detection3DArray. Raises ConfigError if the
    file is missing, has another form, or has poses that are not rigid.
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
        raise ConfigError(f"{path}: {error}") from error


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
    rows = list(csv.DictReader(io.StringIO(read_text(path))))
    for name in ("score", "R", "t"):
        if rows and name not in rows[0]:
            raise ConfigError(f"there is no column {name!r}; the results of BOP have score, R and t")
    for name in BOP:
        if len(values := {row.get(name) for row in rows}) > 1:
            raise ConfigError(f"the column {name} has {len(values)} values; keep the rows of one image and one object")
    poses = [
        make_transform(_read_numbers(row["R"], 9, "R", k).reshape(3, 3), 1e-3 * _read_numbers(row["t"], 3, "t", k))
        for k, row in enumerate(rows, 1)
    ]
    scores = [_read_numbers(row["score"], 1, "score", k)[0] for k, row in enumerate(rows, 1)]
    return ListedPoses(np.reshape(poses, (-1, 4, 4)), np.array(scores))


def _read_numbers(text: str | None, count: int, name: str, row: int) -> Floats:
    try:
        numbers = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != count:
        raise ConfigError(f"row {row}: {name} = {text!r} is not {count} numbers, separated by spaces")
    return numbers


def _read_arrays(path: Path) -> ListedPoses:
    arrays = load_npz(path, ("poses", "scores"))
    if missing := {"poses", "scores"} - set(arrays):
        raise ConfigError(f"there is no array {min(missing)!r}; save poses (K, 4, 4), metres, and scores (K,)")
    poses, scores = (np.asarray(arrays[name], float) for name in ("poses", "scores"))
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ConfigError(f"poses has the shape {poses.shape}; it must be (K, 4, 4)")
    return ListedPoses(poses, scores)


def _read_json(path: Path) -> ListedPoses:
    return read_detections(json.loads(read_text(path)))


def _read_ros_pose(pose: Any) -> Floats:
    """Return the pose (4, 4), metres, of a geometry_msgs Pose."""
    position, quaternion = _get(pose, "position"), _get(pose, "orientation")
    t_m = np.array([_number(_get(position, axis)) for axis in "xyz"])
    wxyz = np.array([_number(_get(quaternion, axis)) for axis in "wxyz"])
    if not (length := np.linalg.norm(wxyz)) > LEAST_QUATERNION:
        raise ConfigError("an orientation is zero or no number; give a quaternion")
    return make_transform(quaternion_to_rotation(wxyz / length), t_m)


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
