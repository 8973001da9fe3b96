"""Touches of the two gels, drawn from the true pose of the part in the fingers.

The touches are drawn by rays, with an elastic gel and noise. The localizer draws with height maps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from meshes import write_mesh
from numpy.typing import NDArray
from robot import Robot
from scene import OPEN_M
from shapes import MOUTH_CHAMFER_M, TIP_CHAMFER_M, TIP_Z_M, Part

from tactile_loc import Localizer, RobotTouches, StageStore, Touch, make_noise
from tactile_loc.plugin import registry
from tactile_loc.plugin.helpers import bring_to_contact, invert, make_transform

Pose = NDArray[np.float64]

SENSOR = {"name": "gelsight-mini", "options": {"gel": "layer", "image_size_px": [160, 120]}}
CAUGHT_M = TIP_CHAMFER_M + MOUTH_CHAMFER_M  # the error of the tip that both chamfers catch without any clearance
TOLERANCE = f"tip:{1e3 * CAUGHT_M:g}mm@0,0,{1e3 * TIP_Z_M:g}"
CONFIDENCE = 0.75  # the fingers feel if the tip meets the plate; such an attempt costs as much as about four grasps
NOISE = "mild"
ENCODER_STD_M, ENCODER_STD_RAD = 1e-4, np.radians(0.2)  # errors of the gels' reported poses
LEAST_PRESS_M = 5e-5
SIDES = {"left": -1, "right": 1}


def make_localizer(part: Part, folder: Path, store: StageStore | None = None) -> Localizer:
    """Return the localizer of a part. The part's mesh is written to `folder`."""
    path = write_mesh(part, folder)
    return Localizer.create(path, units="m", sensor=SENSOR, tolerance=TOLERANCE, confidence=CONFIDENCE, store=store)


def find_gel(side: str, opening_m: float, surface_m: float) -> Pose:
    """Return T_gripper_sensor (4, 4), metres, of the finger on a side. The image's x axis points up along the gel."""
    z = np.array([0.0, -SIDES[side], 0.0])  # out of the gel, towards the other one
    x = np.array([0.0, 0.0, 1.0])
    R = np.stack([x, np.cross(z, x), z], axis=1)
    return make_transform(R, -z * (opening_m + surface_m))


@dataclass(frozen=True, eq=False)
class Gels:
    """Draws the touches of both gels for one localizer."""

    localizer: Localizer
    robot_touches: RobotTouches

    @classmethod
    def of(cls, localizer: Localizer) -> Gels:
        """Make the gels of a localizer's sensor, drawn by rays."""
        renderer = registry().create("renderer", "zbuffer", {})
        return cls(localizer, RobotTouches(
            localizer.object, localizer.sensor.geometry, renderer, noise=make_noise(NOISE),
            sensor_std_m=ENCODER_STD_M, sensor_std_rad=ENCODER_STD_RAD,
        ))  # fmt: skip

    def touch(self, robot: Robot, rng: np.random.Generator) -> list[Touch]:
        """Return the touches that the gels measure now, with the gels' poses in the world; a gel may show nothing."""
        touches = []
        geometry = self.localizer.sensor.geometry
        for side, opening_m in zip(SIDES, robot.opening_m, strict=True):
            T_world_sensor = robot.T_world_gripper @ find_gel(side, opening_m, geometry.surface_m)
            T_sensor_part = invert(T_world_sensor) @ robot.T_world_part
            contact, touching = bring_to_contact(self.localizer.object.mesh, T_sensor_part[None], geometry)
            press_m = float(contact[0, 2, 3] - T_sensor_part[2, 3])
            if not touching[0] or press_m < LEAST_PRESS_M:
                continue
            press_m = min(press_m, geometry.max_depth_m)  # a deeper press saturates
            drawn = self.robot_touches.draw_touch(T_sensor_part, press_m, f"{side}-{robot.time_s:.1f}s", rng)
            if isinstance(drawn, Touch):  # its base frame is the part's; the world is known to the robot
                touches.append(replace(drawn, T_base_sensor=robot.T_world_part @ drawn.T_base_sensor))
        return touches


def open_gels(geometry_surface_m: float) -> list[Pose]:
    """Return T_gripper_sensor (4, 4), metres, of both gels of the open gripper."""
    return [find_gel(side, OPEN_M, geometry_surface_m) for side in SIDES]
