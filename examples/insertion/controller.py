"""The controller's decisions: insert, touch again at another placement of the gripper, or stop."""

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from insertion import ALONG_M
from numpy.typing import NDArray
from scene import OPEN_M
from scipy.spatial.transform import Rotation
from shapes import TIP_Z_M, Part
from touching import CAUGHT_M, CONFIDENCE, open_gels

from tactile_loc import Approach, Localization, PoseModes, Verdict, choose_next_touch
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about

Pose = NDArray[np.float64]

MOST_GRASPS = 6
PRESS_M = 4e-4  # about the press of a grasp
SPREAD = 2.0  # standard deviations, by which the first pose is moved to find a touch that measures it better
OPEN_DIRECTIONS = 2  # the directions of the covariance in which it is moved


class Action(StrEnum):
    """The next action of the controller."""

    INSERT = "insert"
    TOUCH = "touch again"
    STOP = "stop"


@dataclass(frozen=True, eq=False)
class Placement:
    """A pose of the gripper (4, 4), metres, in which it can grasp the part, with its name."""

    T_world_gripper: Pose
    name: str


def decide(verdict: Verdict, chance: float, grasps: int) -> Action:
    """Return the next action, given the verdict on the tip from all touches, and the past grasps.

    `chance`, 0 to 1, is the probability that the insertion works: see `find_chance`.
    """
    works = verdict is Verdict.AMBIGUOUS and chance >= CONFIDENCE
    if verdict is Verdict.CERTAIN or works:
        return Action.INSERT
    return Action.TOUCH if grasps < MOST_GRASPS else Action.STOP


def find_chance(found: Localization, part: Part) -> float:
    """Return the probability, 0 to 1, of the listed poses with which an insertion from the first pose works.

    Across the hole, the chamfers catch the tip. Along the hole, the arm gives way.
    """
    T = np.stack([h.T_base_object for h in found.hypotheses if h.T_base_object is not None])
    moved = invert(T[0]) @ T
    shifts_m = moved[:, :3, 2] * TIP_Z_M + moved[:, :3, 3] - [0, 0, TIP_Z_M]
    yaws_rad, period_rad = np.arctan2(moved[:, 1, 0], moved[:, 0, 0]), 2 * np.pi / part.fits
    turned_m = part.corner_m * np.abs((yaws_rad + period_rad / 2) % period_rad - period_rad / 2)
    works = (np.hypot(*shifts_m[:, :2].T) + turned_m <= CAUGHT_M) & (np.abs(shifts_m[:, 2]) <= ALONG_M)
    return float(sum(h.probability for h, fits in zip(found.hypotheses, works, strict=True) if fits))


def spread_modes(found: Localization) -> PoseModes:
    """Return the possible poses in the world: the hypotheses, and the first one moved along its open directions."""
    modes, best = PoseModes.of(found), found.best
    if best.base_covariance is None:
        return modes
    values, vectors = np.linalg.eigh(best.base_covariance)
    steps = SPREAD * np.sqrt(values[-OPEN_DIRECTIONS:]) * vectors[:, -OPEN_DIRECTIONS:]
    moved = np.stack([move(best.T_base_object, sign * step) for step in steps.T for sign in (-1, 1)])
    share = modes.probabilities[0] / (2 * len(moved))
    probabilities = np.concatenate([modes.probabilities, np.full(len(moved), share)])
    probabilities[0] /= 2
    return replace(
        modes,
        objects=modes.objects + modes.objects[:1] * len(moved),
        T_base_object=np.concatenate([modes.T_base_object, moved]),
        probabilities=probabilities,
    )


def move(T: Pose, error: NDArray[np.float64]) -> Pose:
    """Return a pose (4, 4), metres, moved by an error (6,): a shift, metres, and a rotation vector, radians."""
    turn = Rotation.from_rotvec(error[3:]).as_matrix()
    return make_transform(turn @ T[:3, :3], T[:3, 3] + error[:3])


def list_placements(T_world_part: Pose, part: Part) -> list[Placement]:
    """Return the placements in which the gripper can reach the clamped part, believed to be at (4, 4), metres."""
    placements = []
    for yaw_deg in part.yaws_deg:
        turn = make_transform(rotation_about([0, 0, 1], np.radians(yaw_deg)), np.zeros(3))
        for x_m, z_m in part.shifts_m:
            name = f"yaw {yaw_deg:.0f} deg, x {1e3 * x_m:.0f} mm, z {1e3 * z_m:.0f} mm"
            placements.append(Placement(T_world_part @ turn @ make_translation([x_m, 0, z_m]), name))
    return placements


def choose_placement(found: Localization, placements: Sequence[Placement], used: Collection[str] = ()) -> Placement:
    """Return the placement whose two touches together have the greatest expected information gain.

    The gain of a placement is the sum over its gels. Placements with a gel that cannot start are left out. Placements
    whose names are in `used` are chosen only if nothing else is left.
    """
    surface_m = found.touch.geometry.surface_m
    approaches = [
        Approach(placement.T_world_gripper @ gel, PRESS_M, OPEN_M, name=str(number))
        for number, placement in enumerate(placements)
        for gel in open_gels(surface_m)
    ]
    chosen = choose_next_touch(spread_modes(found), approaches)
    gains: dict[int, float] = defaultdict(float)
    for rated in chosen.ranked:
        gains[int(rated.approach.name)] += rated.information
    for approach, _ in chosen.out_of_reach:
        gains.pop(int(approach.name), None)
    gains = gains or dict.fromkeys(range(len(placements)), 0.0)  # no placement separates the poses
    return placements[max(gains, key=lambda number: (placements[number].name not in used, gains[number]))]
