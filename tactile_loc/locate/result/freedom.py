"""The freedom that touches leave: how many poses explain them equally well, and how these poses differ, in words.

Motions are those of the object, along and about the axes of its own frame. A turn in place leaves the point of contact
where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_loc.core.geometry.lie import move_covariance
from tactile_loc.core.geometry.pose_words import name_line
from tactile_loc.core.geometry.rigid import Bools, Floats, Poses, axis_angle, invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE, Tolerance
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.json_keys import Key, Keys, write_keys

AS_WELL = 0.02  # a pose explains the touches as well as another if its imprint IoU is lower by at most this
# standard deviation of the true pose's imprint IoU with several touches, because the reported sensor poses have errors:
# docs/benchmarks/tasks.md
MISPLACED = 0.02
SMALL_TURN_RAD = np.radians(5.0)  # smaller turns are not mentioned
WIDE = 2.0  # standard deviations: 95 % of the errors along one direction are smaller
NOTHING = np.zeros(3)

FREEDOM: Keys = {
    "others": Key("integer", "number of other hypotheses that explain the touches equally well"),
    "slide_m": Key("numbers", "largest possible slide along the object's x, y, z, m; 0 if small"),
    "turn_rad": Key(
        "numbers", "largest possible turn in place, a rotation vector about the object's x, y, z, rad; 0 if small"
    ),
    "other_turn_rad": Key(
        "numbers", "rotation vector from the first pose to the most probable other one, in the object's frame, rad"
    ),
    "other_shift_m": Key(
        "numbers", "shift of the object's centroid from the first pose to that one, the same frame, m"
    ),
    "contact_std_m": Key(
        "number or null", "largest standard deviation of the position at the contact, m; null if unknown"
    ),
}


@dataclass(frozen=True, eq=False)
class Freedom:
    """What touches leave open about the first pose, in the object's frame. Motions are (3,), and 0 if small.

    `others` is the number of other listed poses that explain the touches equally well. The most probable of them
    follows from the first pose by the turn `other_turn_rad`, a rotation vector, and the shift `other_shift_m` of the
    object's centroid, metres. `slide_m` is the largest possible slide, metres, and `turn_rad` the largest possible turn
    in place, a rotation vector. `contact_std_m` is the largest standard deviation of the position at the contact,
    metres; None if it is unknown.
    """

    others: int
    slide_m: Floats
    turn_rad: Floats
    other_turn_rad: Floats
    other_shift_m: Floats
    contact_std_m: float | None = None

    def __str__(self) -> str:
        """Return what is known and what is open in words, in mm and degrees; empty if nothing is open."""
        said = []
        if self.others:
            more = f", and {self.others - 1} other listed poses do" if self.others > 1 else ""
            said.append(f"{self._describe_other()}, it fits as well{more}")
        if self.slide_m.any():
            along = f"{name_line(self.slide_m)} of the object"
            said.append(f"it may slide up to {_name_length(self.slide_m)} along {along}")
        if self.turn_rad.any():
            said.append(f"it may turn up to {_name_turn(self.turn_rad)}")
        if said and self.contact_std_m is not None and not self.others and not self.slide_m.any():
            said.insert(0, f"position at the contact within {format_mm(WIDE * self.contact_std_m)} mm")
        return "; ".join(said)

    def to_json(self) -> dict[str, Any]:
        """Return the values of FREEDOM, as JSON values."""
        return write_keys(FREEDOM, self)

    def _describe_other(self) -> str:
        moved = []
        if self.other_shift_m.any():
            moved.append(f"moved by {_name_length(self.other_shift_m)}")
        if self.other_turn_rad.any():
            moved.append(f"turned by {_name_turn(self.other_turn_rad)}")
        return " and ".join(moved) or "moved a little"


def find_as_well(touches: Sequence[Touch]) -> float:
    """Return by how much less imprint IoU a pose can have, 0 to 1, and still explain touches as well as another.

    Several touches with errors of their reported sensor poses distinguish poses less sharply.
    """
    misplaced = any(max(touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad) > 0 for touch in touches)
    return AS_WELL + MISPLACED if len(touches) > 1 and misplaced else AS_WELL


def explain_as_well(imprint_ious: Floats, best: float, as_well: float = AS_WELL) -> Bools:
    """Return which of K poses, (K,), explain the touches as well as a pose with the imprint IoU `best`.

    All imprint IoUs, (K,) and `best`, are 0 to 1. A pose does if its imprint IoU is lower by at most `as_well`.
    """
    return imprint_ious >= best - as_well


def find_freedom(
    T_sensor_object: Poses,
    as_well: Bools,
    covariance: Floats | None,
    contact_m: Floats,
    obj: ObjectModel,
    tolerance: Tolerance = ONE_MILLIMETRE,
    *,
    is_open: bool = True,
) -> Freedom:
    """Return what is open about the first of K poses (K, 4, 4), metres.

    `as_well` (K,) marks other poses that explain the touches as well, and that are not within the tolerance.
    `covariance` (6, 6) is the first pose's; None if it is unknown. `contact_m` (3,), metres, is the point of contact in
    the sensor frame. Smaller motions than the tolerance are not
    mentioned, nor those of the covariance unless the pose `is_open`.
    """
    least_m, least_rad = tolerance.distance_m or 1e-3, tolerance.rotation_rad or SMALL_TURN_RAD
    first, R = T_sensor_object[0], T_sensor_object[0, :3, :3]
    motions = invert(first) @ T_sensor_object[as_well]
    touched_m = transform_points(invert(first), contact_m[None])[0]
    shifts = transform_points(motions, touched_m[None])[:, 0] - touched_m
    turns = np.array([_find_rotation_vector(motion) for motion in motions]).reshape(-1, 3)
    in_place, straight = np.linalg.norm(shifts, axis=1) < least_m, np.linalg.norm(turns, axis=1) < least_rad
    slides, rotations, std_m = [*shifts[straight]], [*turns[in_place]], None
    if covariance is not None:
        at_contact = move_covariance(covariance, contact_m - first[:3, 3])
        widest = _find_widest(at_contact[:3, :3]) @ R
        std_m = float(np.linalg.norm(widest)) / WIDE
        slides += [_shorten(widest, float(np.linalg.norm(obj.mesh.extents_m)))] * is_open
        rotations += [_shorten(_find_widest(at_contact[3:, 3:]) @ R, np.pi)] * is_open
    centroid_m = obj.mesh.centroid_m
    moved = transform_points(motions, centroid_m[None])[:, 0] - centroid_m
    other = [turns[0], moved[0]] if len(motions) else [NOTHING, NOTHING]
    return Freedom(
        len(motions),
        _find_longest(slides, least_m),
        _find_longest(rotations, least_rad),
        _find_longest([other[0]], least_rad),
        _find_longest([other[1]], least_m),
        std_m,
    )


def _find_rotation_vector(T: Poses) -> Floats:
    angle_deg, axis = axis_angle(T[:3, :3])
    return np.radians(angle_deg) * axis


def _name_length(vector: Floats) -> str:
    return f"{1e3 * np.linalg.norm(vector):.1f} mm"


def _name_turn(vector: Floats) -> str:
    return f"{np.degrees(np.linalg.norm(vector)):.0f} degrees about {name_line(vector)} of the object"


def _find_widest(covariance: Floats) -> Floats:
    """Return the direction (3,) of the largest variance of a covariance (3, 3), with the length of WIDE deviations."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(WIDE * np.sqrt(max(values[-1], 0.0)) * vectors[:, -1])


def _shorten(vector: Floats, most: float) -> Floats:
    """Return a vector (3,) that is not longer than `most`."""
    return np.asarray(vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-12)))


def _find_longest(vectors: list[Floats], least: float) -> Floats:
    """Return the longest vector (3,), or zeros if none is longer than `least`."""
    longest = max(vectors, key=lambda v: float(np.linalg.norm(v)), default=NOTHING)
    return longest if np.linalg.norm(longest) > least else NOTHING
