"""The controller's decisions: insert, touch again at another placement of the gripper, or stop."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from scene import OPEN_M
from shapes import TIP_Z_M, Part
from tactile_loc import Approach, Localization, Verdict, choose_next_touch
from tactile_loc.plugin import cross_matrix, make_transform, make_translation, rotation_about
from touching import open_gels

Pose = NDArray[np.float64]

MOST_GRASPS = 6
MOST_STD_M = 4e-4  # of the tip, in the worst direction, for which the chamfers still catch it
PRESS_M = 4e-4  # about the press of a grasp


class Action(StrEnum):
    """What the controller does next."""

    INSERT = "insert"
    TOUCH = "touch again"
    STOP = "stop"


@dataclass(frozen=True, eq=False)
class Placement:
    """A pose of the gripper (4, 4), metres, in which it can grasp the part, with its name."""

    T_world_gripper: Pose
    name: str


def decide(verdict: Verdict, tip_std_m: float, grasps: int) -> Action:
    """Return the next action, given the verdict on all touches, the tip's standard deviation and the past grasps."""
    if verdict is Verdict.CERTAIN and tip_std_m <= MOST_STD_M:
        return Action.INSERT
    return Action.TOUCH if grasps < MOST_GRASPS else Action.STOP


def measure_tip_std_m(found: Localization) -> float:
    """Return the standard deviation, metres, of the tip's position in the worst direction, for the first pose."""
    covariance, T = found.best.covariance, found.best.T_sensor_object
    if covariance is None:
        return np.inf
    lever = np.hstack([np.eye(3), -cross_matrix(T[:3, :3] @ [0, 0, TIP_Z_M])])
    return float(np.sqrt(np.linalg.eigvalsh(lever @ covariance @ lever.T).max()))


def list_placements(T_world_part: Pose, part: Part) -> list[Placement]:
    """Return the placements in which the gripper can reach the clamped part, believed to be at (4, 4), metres."""
    placements = []
    for yaw_deg in part.yaws_deg:
        turn = make_transform(rotation_about([0, 0, 1], np.radians(yaw_deg)), np.zeros(3))
        for x_m, z_m in part.shifts_m:
            name = f"yaw {yaw_deg:.0f} deg, x {1e3 * x_m:.0f} mm, z {1e3 * z_m:.0f} mm"
            placements.append(Placement(T_world_part @ turn @ make_translation([x_m, 0, z_m]), name))
    return placements


def choose_placement(found: Localization, placements: Sequence[Placement]) -> Placement:
    """Return the placement whose two touches together have the greatest expected information gain.

    The gain of a placement is the sum over its gels. Placements with a gel that cannot start are left out.
    """
    surface_m = found.touch.geometry.surface_m
    approaches = [
        Approach(placement.T_world_gripper @ gel, PRESS_M, OPEN_M, name=str(number))
        for number, placement in enumerate(placements)
        for gel in open_gels(surface_m)
    ]
    chosen = choose_next_touch(found, approaches)
    gains: dict[int, float] = defaultdict(float)
    for rated in chosen.ranked:
        gains[int(rated.approach.name)] += rated.information
    for approach, _ in chosen.out_of_reach:
        gains.pop(int(approach.name), None)
    return placements[max(gains, key=lambda number: gains[number])]
