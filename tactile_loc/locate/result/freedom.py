"""The freedom that touches leave: how many poses explain them equally well, and how these poses differ, in words.

Motions are described in the first touch's sensor frame, at the middle of its gel, where the object touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.lie import move_covariance
from tactile_loc.core.geometry.rigid import Poses, axis_angle, invert, transform_points
from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE, Tolerance
from tactile_loc.core.sensing.touch import Touch

Float64 = NDArray[np.float64]

AS_WELL = 0.02  # a pose explains the touches as well as another if its imprint IoU is lower by at most this
# standard deviation of the true pose's imprint IoU with several touches, because the reported sensor poses have errors:
# docs/benchmarks/tasks.md
MISPLACED = 0.02
SMALL_TURN_RAD = np.radians(5.0)  # smaller turns are not mentioned
WIDE = 2.0  # standard deviations: 95 % of the errors along one direction are smaller
ALONG = np.cos(np.radians(15.0))  # directions nearer to an axis have its name
NOTHING = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Freedom:
    """What touches leave open about the first pose.

    `others` is the number of other listed poses that explain the touches equally well. `slide_m` (3,) is the largest
    possible slide of the object, metres, and `turn_rad` (3,) the largest possible turn in place, as a rotation vector,
    radians. Both are in the first touch's sensor frame, and 0 if small.
    """

    others: int
    slide_m: Float64
    turn_rad: Float64

    def __str__(self) -> str:
        """Return the freedom in words, in mm and degrees; empty if nothing is open."""
        said = []
        if self.others:
            poses = "pose explains" if self.others == 1 else "poses explain"
            said.append(f"{self.others} other listed {poses} it equally well")
        if self.slide_m.any():
            mm = 1e3 * np.linalg.norm(self.slide_m)
            said.append(f"the object may slide up to {mm:.1f} mm along {_name_direction(self.slide_m)} of the sensor")
        if self.turn_rad.any():
            deg = np.degrees(np.linalg.norm(self.turn_rad))
            said.append(f"it may turn up to {deg:.0f} degrees about {_name_direction(self.turn_rad)} of the sensor")
        return "; ".join(said)


def find_as_well(touches: Sequence[Touch]) -> float:
    """Return by how much less imprint IoU a pose can have, 0 to 1, and still explain touches as well as another.

    Several touches with errors of their reported sensor poses distinguish poses less sharply.
    """
    misplaced = any(max(touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad) > 0 for touch in touches)
    return AS_WELL + MISPLACED if len(touches) > 1 and misplaced else AS_WELL


def explain_as_well(imprint_ious: Float64, best: float, as_well: float = AS_WELL) -> NDArray[np.bool_]:
    """Return which of K poses, (K,), explain the touches as well as a pose with the imprint IoU `best`.

    All imprint IoUs, (K,) and `best`, are 0 to 1. A pose does if its imprint IoU is lower by at most `as_well`.
    """
    return imprint_ious >= best - as_well


def find_freedom(
    T_sensor_object: Poses,
    imprint_ious: Float64,
    covariance: Float64 | None,
    contact_m: Float64,
    same: NDArray[np.bool_],
    tolerance: Tolerance = ONE_MILLIMETRE,
    as_well: float = AS_WELL,
) -> Freedom:
    """Return what is open about the first of K poses (K, 4, 4), metres.

    `imprint_ious` (K,), 0 to 1, state how well the poses explain the touches. `covariance` (6, 6) is the first pose's;
    None if unknown. `contact_m` (3,), metres, is the point of contact in the sensor frame. `same` (K,) marks poses
    within the tolerance of the first pose. Smaller motions than the tolerance are not mentioned. `as_well` is as for
    `explain_as_well`.
    """
    least_m, least_rad = tolerance.distance_m or 1e-3, tolerance.rotation_rad or SMALL_TURN_RAD
    equal = explain_as_well(imprint_ious, imprint_ious[0], as_well) & ~same
    others = T_sensor_object[equal] @ invert(T_sensor_object[0])
    shifts = transform_points(others, contact_m[None])[:, 0] - contact_m
    turns = np.array([_find_rotation_vector(motion) for motion in others]).reshape(-1, 3)
    in_place, straight = np.linalg.norm(shifts, axis=1) < least_m, np.linalg.norm(turns, axis=1) < least_rad
    slides, rotations = [*shifts[straight]], [*turns[in_place]]
    if covariance is not None:
        at_contact = move_covariance(covariance, contact_m - T_sensor_object[0, :3, 3])
        slides.append(_find_widest(at_contact[:3, :3]))
        rotations.append(_find_widest(at_contact[3:, 3:]))
    return Freedom(len(others), _find_longest(slides, least_m), _find_longest(rotations, least_rad))


def _find_rotation_vector(T: Poses) -> Float64:
    angle_deg, axis = axis_angle(T[:3, :3])
    return np.radians(angle_deg) * axis


def _find_widest(covariance: Float64) -> Float64:
    """Return the direction (3,) of the largest variance of a covariance (3, 3), with the length of WIDE deviations."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(WIDE * np.sqrt(max(values[-1], 0.0)) * vectors[:, -1])


def _find_longest(vectors: list[Float64], least: float) -> Float64:
    """Return the longest vector (3,), or zeros if none is longer than `least`."""
    longest = max(vectors, key=lambda v: float(np.linalg.norm(v)), default=NOTHING)
    return longest if np.linalg.norm(longest) > least else NOTHING


def _name_direction(vector: Float64) -> str:
    """Return x, y or z for a vector (3,) near an axis, and else its direction as three numbers."""
    unit = vector / np.linalg.norm(vector)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) >= ALONG:
        return "xyz"[nearest]
    return "({:z.2f}, {:z.2f}, {:z.2f})".format(*(unit * np.sign(unit[nearest])))
