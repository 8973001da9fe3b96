"""Texts for directions, and for a pose and its standard deviations in millimetres and degrees."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, axis_angle, format_pose

ALONG = np.cos(np.radians(15.0))  # directions nearer to an axis have its name


@dataclass(frozen=True)
class PoseWords:
    """Texts for a pose and its standard deviations: positions in mm, without the unit, and rotations in degrees.

    Unknown standard deviations are "".
    """

    place: str
    turn: str
    axis: str
    place_std: str = ""
    turn_std: str = ""


def format_pose_words(T: Floats, std: Floats | None = None) -> PoseWords:
    """Return texts for a pose (4, 4), metres, and its standard deviations (6,), metres, then radians, if known."""
    angle_deg, axis = axis_angle(T[:3, :3])
    known = join_numbers(1e3 * T[:3, 3], 1), f"{angle_deg:.1f}°", f"({join_numbers(axis, 2)})"
    if std is None:
        return PoseWords(*known)
    return PoseWords(*known, join_numbers(1e3 * std[:3], 2), f"{join_numbers(np.degrees(std[3:]), 1)}°")


def name_direction(vector: Floats) -> str:
    """Return the direction of a vector (3,) as text: x, y, z, -x, -y or -z if it is near that axis, else as numbers."""
    unit = vector / max(float(np.linalg.norm(vector)), 1e-30)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) < ALONG:
        return f"({join_numbers(unit, 2)})"
    return f"{'-' if unit[nearest] < 0 else ''}{'xyz'[nearest]}"


def name_line(vector: Floats) -> str:
    """Return the name of the line along a vector (3,): that of the direction whose largest coordinate is positive."""
    return name_direction(vector * np.sign(vector[np.abs(vector).argmax()]))


def join_numbers(values: Iterable[float], digits: int) -> str:
    """Return numbers as text, with `digits` digits after the point: 1.20, -0.31, 4.00."""
    return ", ".join(f"{value:z.{digits}f}" for value in values)


def describe_first(T: Floats, poses: int, frame: str) -> str:
    """Return in words the first pose (4, 4), metres, of a number of `poses`, in the frame of this name."""
    x, y, z, angle_deg, axis = format_pose(T)
    count = f"{poses} {'pose' if poses == 1 else 'poses'}"
    return f"first of {count}: x {x}, y {y}, z {z} mm, rotated {angle_deg} degrees about {axis}, in the {frame} frame"
