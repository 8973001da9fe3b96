"""Insertion into the hole: compliant, in a straight line, or after a blind search along a spiral."""

import numpy as np
from numpy.typing import NDArray
from robot import Robot
from shapes import SEAT_Z_M, TIP_Z_M, Part

from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about, rotation_angle

Pose = NDArray[np.float64]

ABOVE_M, OVERSHOOT_M = 5e-3, 2e-3  # where the tip starts above the plate; how far beyond its seat the part is moved
LOWERING_M_S, SEARCH_M_S = 0.02, 0.03
STOP_N = 40.0  # the arm stops at this force between part and plate, which counts as damage
SEATED_M = 1e-3  # a part is inserted if at most this much of its depth is missing
ALONG_M = SEATED_M + OVERSHOOT_M  # an error along the hole that costs nothing, because the arm is soft
CONTACT_N, SEARCH_N, PUSH_N = 5.0, 8.0, 25.0  # of the blind search: at first contact, while it slides, at the end
PITCH_M, SEARCH_RADIUS_M, FALL_M = 1e-3, 10e-3, 1.5e-3


def insert(robot: Robot, T_gripper_part: Pose, part: Part) -> None:
    """Insert the part, believed to be at `T_gripper_part` (4, 4), metres, in a straight line."""
    T_gripper = choose_goal(robot, T_gripper_part, part)
    robot.move(make_translation([0, 0, ABOVE_M + part.depth_m]) @ T_gripper)
    robot.wait(0.2)
    robot.move(make_translation([0, 0, -OVERSHOOT_M]) @ T_gripper, LOWERING_M_S, STOP_N)
    robot.wait(0.1)


def search_blindly(robot: Robot, T_gripper_part: Pose, part: Part) -> None:
    """Lower the part until it touches the plate, slide it along a spiral until it falls, and push it in."""
    T_gripper = choose_goal(robot, T_gripper_part, part)
    start = make_translation([0, 0, 3 * ABOVE_M + part.depth_m]) @ T_gripper
    robot.move(start)
    robot.wait(0.2)
    if robot.move(make_translation([0, 0, -6 * ABOVE_M]) @ start, LOWERING_M_S, CONTACT_N):
        return
    touched = robot.T_world_gripper
    pushed = make_translation([0, 0, -SEARCH_N / robot.stiffness_z]) @ touched
    angles_rad = np.arange(0.0, 2 * np.pi * SEARCH_RADIUS_M / PITCH_M, 0.3)

    def fell(moved: Robot) -> bool:
        return moved.T_world_gripper[2, 3] < touched[2, 3] - FALL_M

    for angle_rad in angles_rad:
        radius_m = PITCH_M * angle_rad / (2 * np.pi)
        shift_m = [radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), 0]
        if not robot.move(make_translation(shift_m) @ pushed, SEARCH_M_S, STOP_N, fell):
            break
    if fell(robot):
        seat = robot.T_world_gripper
        seat[2, 3] = touched[2, 3] - part.depth_m - ABOVE_M
        robot.move(seat, LOWERING_M_S, PUSH_N)
    robot.wait(0.1)


def choose_goal(robot: Robot, T_gripper_part: Pose, part: Part) -> Pose:
    """Return the pose (4, 4), metres, of the gripper in which the part is seated, with the smallest rotation of it."""
    yaws_rad = 2 * np.pi * np.arange(part.fits) / part.fits
    seat = make_translation([0, 0, -SEAT_Z_M])
    goals = np.array([
        seat @ make_transform(rotation_about([0, 0, 1], yaw_rad), np.zeros(3)) @ invert(T_gripper_part)
        for yaw_rad in yaws_rad
    ])  # fmt: skip
    turns_rad = rotation_angle(robot.T_world_gripper[:3, :3].T @ goals[:, :3, :3])
    return np.asarray(goals[np.argmin(turns_rad)])


def measure_depth_m(robot: Robot) -> float:
    """Return the depth of the tip below the plate's surface, metres; 0 beside the hole."""
    tip_m = robot.T_world_part @ [0, 0, TIP_Z_M, 1]
    return float(max(0.0, -tip_m[2])) if np.hypot(*tip_m[:2]) < 2e-3 else 0.0


def is_inserted(robot: Robot, part: Part) -> bool:
    """Return whether the part is as deep as it has to be, and the arm never had to stop."""
    return robot.peak_force_n < STOP_N and measure_depth_m(robot) >= part.depth_m - SEATED_M
