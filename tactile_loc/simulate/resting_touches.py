"""Simulated touches of one object at rest: a hand that touches it from random directions, or opposed fingers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, draw_rotations, invert, make_transform, rotation_about
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.simulate.contact_poses import draw_contact_poses
from tactile_loc.simulate.touch_simulation import PressNoise, make_touch, simulate_touches
from tactile_loc.slots.grid import GridSampler

IN_FRONT_M, REACH_M = 0.4, 0.1  # the object's frame is this far from the base along x, and this far beside that point
FINGERS = 2
FACING = make_transform(rotation_about([1, 0, 0], np.pi), np.zeros(3))  # from one finger's frame to the opposite one's
MOST_GRIPS = 1000  # largest number of attempts to draw a grip


def draw_resting_touches(
    sampler: GridSampler,
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    press_depth_m: float | None = None,
    noise: TouchNoise | None = None,
    opposed: bool = False,
) -> list[Touch]:
    """Make `count` touches of one object at rest, each with its sensor's pose `T_base_sensor` (4, 4), metres.

    The object's pose in the base frame is drawn first, then the touches (see `draw_touches`). With `opposed`, the
    touches are pairs: the second sensor of a pair faces the first. With `noise` that misplaces the sensor,
    `T_base_sensor` is the pose that the robot reports, not the real one.

    Raises TouchError if hardly any press makes a touch, and GridError if hardly any pose touches. With `opposed`, also
    raises TouchError for an odd `count`.
    """
    beside_m = np.array([IN_FRONT_M, 0.0, 0.0]) + rng.uniform(-REACH_M, REACH_M, 3)
    T_base_object = make_transform(draw_rotations(1, rng)[0], beside_m)
    if not opposed:
        return rest(simulate_touches(sampler, scene, count, rng, press_depth_m, noise), T_base_object)
    if count % FINGERS:
        raise TouchError(f"opposed fingers touch in pairs, so {count} touches are impossible; choose an even number")
    touches = [touch for _ in range(count // FINGERS) for touch in draw_grip(sampler, scene, rng, press_depth_m, noise)]
    named = [replace(touch, name=f"touch-{number:04d}") for number, touch in enumerate(touches)]
    return rest(named, T_base_object)


def rest(touches: Sequence[Touch], T_base_object: Floats) -> list[Touch]:
    """Return touches with known true poses, with the sensor poses at which the object rests at `T_base_object` (4, 4).

    Raises TouchError if a true pose is unknown.
    """
    placed = []
    for touch in touches:
        if touch.T_sensor_object is None:
            raise TouchError(f"{touch.name} has no true pose, so its sensor cannot be placed; give a simulated touch")
        placed.append(replace(touch, T_base_sensor=T_base_object @ invert(touch.T_sensor_object)))
    return placed


def draw_grip(
    sampler: GridSampler,
    scene: Scene,
    rng: np.random.Generator,
    press_depth_m: float | None = None,
    noise: TouchNoise | None = None,
) -> list[Touch]:
    """Return the two touches of a gripper that closes on the object: the second sensor faces the first.

    The first touch is drawn like those of `draw_touches`. Raises TouchError if hardly any grip makes two touches.
    """
    presses, percent = PressNoise.of(scene, rng, press_depth_m, noise), sampler.options.min_contact_percent
    for _ in range(MOST_GRIPS):
        poses, touching = scene.bring_to_contact(face_each_other(draw_contact_poses(sampler, scene, 1, rng)[0]))
        if touching.all():
            pressed = zip(*presses.press(poses, percent), strict=True)
            made = [make_touch(shape, scene, T, f"finger-{k}") for k, (T, shape) in enumerate(pressed)]
            touches = [touch for touch in made if touch is not None]
            if len(touches) == FINGERS:
                return touches
    raise TouchError(f"hardly any grip of {scene.object.name} makes contact at both fingers; press deeper")


def face_each_other(T_sensor_object: Floats) -> Poses:
    """Return the poses (2, 4, 4) of an object in the frames of two opposed sensors, given its pose (4, 4) in one.

    Lengths are in metres. z of the second pose is arbitrary: bring the pose to contact.
    """
    return np.stack([T_sensor_object, FACING @ T_sensor_object])
