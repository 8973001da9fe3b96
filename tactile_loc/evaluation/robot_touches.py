"""Simulated touches of a robot: from any direction, including edges and corners, drawn by another renderer.

The touches are independent of the software that locates them: they use no face and no grid, and a few pixels of contact
are enough. A press that a sensor cannot distinguish from no touch is refused and counted.
"""

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import (
    Float32,
    Floats,
    Poses,
    draw_rotations,
    invert,
    make_transform,
    rotation_about,
)
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.contact import bring_to_contact
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.simulate.resting_touches import face_each_other
from tactile_loc.slots.renderer import Renderer

INSIDE = 0.8  # the object's lowest point lies in this share of the sensing rectangle, about its centre
MOST_DRAWS = 1000
LEAST_PERCENT = 0.25  # of the observed pixels are in contact
NO_NOISE = TouchNoise()


@dataclass(frozen=True, eq=False)
class RobotTouches:
    """Draws touches of an object from random directions, with a `renderer` of its own.

    Each press is drawn uniformly between the shares `press` of the maximal depth. Without `noise`, at least
    `least_percent` of the observed pixels are in contact. `sensor_std_m` and `sensor_std_rad` are the standard errors
    of the touches' sensor poses, along and about each axis.
    """

    object: ObjectModel
    geometry: SensorGeometry
    renderer: Renderer
    press: tuple[float, float] = (0.3, 0.9)
    least_percent: float = LEAST_PERCENT
    noise: TouchNoise = NO_NOISE
    sensor_std_m: float = 0.0
    sensor_std_rad: float = 0.0

    def draw_example(self, count: int, rng: np.random.Generator) -> tuple[list[Touch], int]:
        """Return `count` touches of the object at rest, and the number of refused presses.

        The base frame is the object's. Raises TouchError if hardly any press makes a touch.
        """
        touches: list[Touch] = []
        refused = 0
        for _ in range(MOST_DRAWS):
            if len(touches) == count:
                return touches, refused
            T = self.draw_pose(rng)
            drawn = None if T is None else self._press(T, f"touch-{len(touches):02d}", rng)
            if isinstance(drawn, Touch):
                touches.append(drawn)
            elif drawn is not None:
                refused += 1
        raise TouchError(f"hardly any press of {self.object.name} makes contact; press deeper")

    def approach(
        self, T_base_sensor: Poses, press_m: float, name: str, rng: np.random.Generator, travel_m: float = np.inf
    ) -> Touch | None:
        """Return the touch of a sensor that moves along its z from `T_base_sensor` (4, 4) until contact, and presses.

        The base frame is the object's; lengths are in metres. Returns None if there is no contact within `travel_m`, if
        the sensor starts inside the object, or if the press makes no usable touch.
        """
        start = invert(T_base_sensor)
        contact, touching = bring_to_contact(self.object.mesh, start[None], self.geometry)
        moved_m = start[2, 3] - contact[0, 2, 3]
        if not touching[0] or not 0 <= moved_m <= travel_m:
            return None
        T = contact[0]
        T[2, 3] -= press_m
        drawn = self.draw_touch(T, press_m, name, rng)
        return drawn if isinstance(drawn, Touch) else None

    def draw_grip(self, rng: np.random.Generator, press_m: float) -> list[Touch]:
        """Return the two touches of a gripper that closes on the object: the second sensor faces the first.

        Raises TouchError if hardly any grip makes two touches.
        """
        scene = Scene(self.object, self.geometry, self.renderer)
        for _ in range(MOST_DRAWS):
            T = self.draw_pose(rng)
            if T is None:
                continue
            poses, touching = scene.bring_to_contact(face_each_other(T))
            if not touching.all():
                continue
            poses[:, 2, 3] -= press_m
            found = [self.draw_touch(pose, press_m, f"finger-{k}", rng) for k, pose in enumerate(poses)]
            touches = [touch for touch in found if isinstance(touch, Touch)]
            if len(touches) == len(poses):
                return touches
        raise TouchError(f"hardly any grip of {self.object.name} makes contact at both fingers; press deeper")

    def draw_pose(self, rng: np.random.Generator) -> Poses | None:
        """Draw a pose (4, 4), metres, in which the object just touches the sensor; None if it misses the sensor.

        The rotation is random, and the object's lowest point is over a random point of the sensor.
        """
        R = draw_rotations(1, rng)[0]
        rotated = self.object.mesh.vertices_m @ R.T
        x0, x1, y0, y1 = self.geometry.rectangle
        place = np.array([x0 + x1, y0 + y1]) / 2 + INSIDE * (rng.random(2) - 0.5) * [x1 - x0, y1 - y0]
        lowest = rotated[rotated[:, 2].argmin()]
        T = make_transform(R, [*(place - lowest[:2]), 0.0])
        poses, touching = bring_to_contact(self.object.mesh, T[None], self.geometry)
        return poses[0] if touching[0] else None

    def _press(self, T: Poses, name: str, rng: np.random.Generator) -> Touch | TouchError | None:
        press_m = self.geometry.max_depth_m * rng.uniform(*self.press)
        T = T.copy()
        T[2, 3] -= press_m
        return self.draw_touch(T, press_m, name, rng)

    def draw_touch(self, T: Poses, press_m: float, name: str, rng: np.random.Generator) -> Touch | TouchError | None:
        """Return the touch of a pressed pose (4, 4), metres; None if its contact is too small.

        Returns the TouchError if a sensor cannot distinguish the press from no touch.
        """
        geometry = self.geometry.press(press_m, self.geometry.max_depth_m)
        clean = Scene(self.object, geometry, self.renderer).render_gel_depths(T[None])
        if not self.touches_enough(clean[0], press_m):
            return None
        depth, measured_m = measure_noisily(self.noise, clean, press_m, geometry, rng)
        try:
            shape = ContactShape(depth, measured_m)
            return Touch(
                shape,
                self.geometry,
                name,
                T_sensor_object=T,
                T_base_sensor=self.misplace(invert(T), *rng.normal(size=(2, 3))),
                T_base_sensor_std_m=self.sensor_std_m or Touch.T_base_sensor_std_m,
                T_base_sensor_std_rad=self.sensor_std_rad or Touch.T_base_sensor_std_rad,
            )
        except TouchError as error:
            return error

    def touches_enough(self, depth_m: Float32, press_m: float) -> bool:
        """Return whether enough pixels of a contact shape (H, W), metres, touch: `least_percent`, and one at least."""
        seen = self.geometry.observed_mask
        return bool(((depth_m < np.float32(press_m)) & seen).sum() >= max(1.0, self.least_percent / 100 * seen.sum()))

    def misplace(self, T_base_sensor: Poses, turn: Floats, shift: Floats) -> Poses:
        """Return a sensor's pose (4, 4), metres, with an error of `turn` and `shift` (3,), in standard deviations.

        The rotation is about axes through the middle of the gel, where the touch is. The shift is along the sensor's
        axes.
        """
        if self.sensor_std_m == self.sensor_std_rad == 0:
            return T_base_sensor
        return np.asarray(T_base_sensor @ self.move_about_gel(self.sensor_std_rad * turn, self.sensor_std_m * shift))

    def move_about_gel(self, turn_rad: Floats, shift_m: Floats) -> Poses:
        """Return the motion (4, 4) by a rotation vector (3,), radians, about the gel's middle and a shift (3,), m."""
        gel, angle_rad = np.array([0.0, 0.0, self.geometry.standoff_m]), float(np.linalg.norm(turn_rad))
        R = rotation_about(turn_rad, angle_rad) if angle_rad > 0 else np.eye(3)
        return make_transform(R, gel - R @ gel + shift_m)


def measure_noisily(
    noise: TouchNoise, clean_m: Float32, press_m: float, geometry: SensorGeometry, rng: np.random.Generator
) -> tuple[Float32, float]:
    """Return the measured contact shape (H, W) and press depth of a clean contact shape (1, H, W), all in metres."""
    press, deepest_m = np.array([press_m]), geometry.max_depth_m
    measured = noise.measure_press(press, deepest_m, rng)
    return noise.cut(noise.corrupt(clean_m, press, geometry, rng), press, measured)[0], float(measured[0])
