"""Sequences of touches: a sensor that slides and rotates over an object at rest, at its camera's rate.

The first pose is random, as in `RobotTouches`. From there, the sensor moves with smoothly changing speeds and a
smoothly changing press. It reverses before it loses contact or hits a wall.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc import RobotTouches
from tactile_loc.plugin import Poses, Scene, Touch, TouchError
from tactile_loc.plugin.helpers import invert

WAVES = 3  # sine waves whose sum is a smoothly changing number
SLOWEST_HZ, FASTEST_HZ = 0.1, 0.5  # frequencies of the waves
MOST_RISE_M = 2e-4  # the object rises at most by this between two frames; a higher step is a wall
INSIDE = 0.8  # the contact's middle stays in this share of the sensing rectangle, about its centre
MOST_STARTS = 100
# parts of a step: the whole step, its rotation, its sliding, its rotation about the sensor's z axis
PARTS = np.array([[1, 1, 1, 1, 1], [0, 0, 1, 1, 1], [1, 1, 0, 0, 0], [0, 0, 0, 0, 1]])

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame, `time_s` after the first frame: its `touch`, None without a touch, and its poses (4, 4), metres.

    `T_base_sensor` is the reported pose of the sensor, as in the touch. `T_sensor_object` is the true pose of the
    object.
    """

    time_s: float
    touch: Touch | None
    T_base_sensor: Floats
    T_sensor_object: Floats


class Slip(NamedTuple):
    """A sudden slide of an object along the gel, metres, and rotation about the gel's middle, radians."""

    shift_m: float
    turn_rad: float


@dataclass(frozen=True, eq=False)
class SlidingTouches:
    """Draws sequences of touches of an object over which a sensor slides and rotates.

    `source` sets the object, sensor, press, renderer, noise and error of the reported sensor poses. `speed_m_s` is the
    root mean square speed along each of the gel's two axes. `turn_rad_s` is the root mean square rate of rotation about
    each of the sensor's three axes. The gel's noise stays the same for `noise_s` seconds. The error of the sensor's
    pose changes smoothly in the same time.
    """

    source: RobotTouches
    rate_hz: float = 100.0
    speed_m_s: float = 8e-3
    turn_rad_s: float = 0.25
    noise_s: float = 0.25

    def draw_example(
        self, count: int, rng: np.random.Generator, jump_at: int | None = None, slip: Slip | None = None
    ) -> list[Frame]:
        """Return `count` frames; at frame `jump_at`, the object jumps, unreported, to a random pose or by a `slip`.

        The base frame is the object's before it jumps. Raises TouchError if hardly any start, or slip, makes a touch.
        """
        errors = draw_correlated(count, 1 / (self.rate_hz * self.noise_s), 6, rng)
        frames: list[Frame] = []
        T_base_object = T_base_sensor = np.eye(4)
        for k, (T_sensor_object, touch) in enumerate(self._draw_path(count, rng, jump_at, slip)):
            if k == jump_at:
                T_base_object = T_base_sensor @ T_sensor_object  # the sensor has not moved
            T_base_sensor = T_base_object @ invert(T_sensor_object)
            reported = self.source.misplace(T_base_sensor, *errors[k].reshape(2, 3))
            named = None if touch is None else replace(touch, name=f"frame-{k:04d}", T_base_sensor=reported)
            frames.append(Frame(k / self.rate_hz, named, reported, T_sensor_object))
        return frames

    def _draw_path(
        self, count: int, rng: np.random.Generator, jump_at: int | None, slip: Slip | None
    ) -> Iterator[tuple[Poses, Touch | None]]:
        """Yield the poses T_sensor_object (4, 4), metres, of a slide, each with its touch, None without a touch."""
        dt_s = 1 / self.rate_hz
        speeds = draw_smooth(count, dt_s, 5, rng) * ([self.speed_m_s] * 2 + [self.turn_rad_s] * 3)
        presses_m = self._draw_presses(draw_smooth(count, dt_s, 1, rng)[:, 0])
        gels = rng.integers(2**32, size=1 + int(count * dt_s / self.noise_s))
        T, direction = np.eye(4), 1.0
        for k, (speed, press_m) in enumerate(zip(speeds, presses_m, strict=True)):
            gel = int(gels[int(k * dt_s / self.noise_s)])
            if k in (0, jump_at):
                near = partial(self._slip, T, slip, rng) if k and slip else partial(self.source.draw_pose, rng)
                T, touch = self._start(near, press_m, gel)
            else:
                T, touch, direction = self._move(T, direction, dt_s * speed, press_m, gel)
            yield _press(T, press_m), touch

    def _draw_presses(self, wandering: Floats) -> Floats:
        """Return presses (N,), metres, in the source's range, from smoothly changing numbers (N,)."""
        low, high = self.source.press
        share = low + (high - low) * (0.5 + 0.5 * np.tanh(wandering))
        return np.asarray(self.source.geometry.max_depth_m * share)

    def _start(self, random_pose: Callable[[], Poses | None], press_m: float, gel: int) -> tuple[Poses, Touch | None]:
        """Return a random pose in which the object just touches the sensor, and the touch."""
        for _ in range(MOST_STARTS):
            T = random_pose()
            touch = None if T is None else self._draw_touch(T, press_m, gel)
            if T is not None and isinstance(touch, Touch):
                return T, touch
        raise TouchError(f"hardly any press of {self.source.object.name} makes contact; press deeper")

    def _slip(self, T: Poses, slip: Slip, rng: np.random.Generator) -> Poses | None:
        """Return the pose (4, 4) after a slip from T (4, 4) in a random direction; None without contact."""
        step = np.concatenate([slip.shift_m * _draw_direction(2, rng), slip.turn_rad * _draw_direction(3, rng)])
        moved, touching = self._follow(T, step)
        return moved if touching else None

    def _move(
        self, T: Poses, direction: float, step: Floats, press_m: float, gel: int
    ) -> tuple[Poses, Touch | None, float]:
        """Return the pose after a step (5,), its touch, and the direction, which reverses if the step is impossible.

        If both directions are impossible, parts of the step are tried. A contact must stay near the middle of the
        sensor (INSIDE), unless it was already farther out before the step, because the press became lighter. A pose
        without a valid touch, such as on a flat face, is possible.
        """
        here = partial(self._draw_touch, T, press_m, gel)
        outside = INSIDE
        for part, way in itertools.product(PARTS, (direction, -direction)):
            moved, touching = self._follow(T, way * part * step)
            if not touching or abs(moved[2, 3] - T[2, 3]) > MOST_RISE_M + np.abs(step[:2]).sum():
                continue
            touch = self._draw_touch(moved, press_m, gel)
            far = self._measure_outside(touch)
            if far > outside:
                outside = max(INSIDE, self._measure_outside(here()))
            if far <= outside:
                return moved, touch if isinstance(touch, Touch) else None, way
        stayed = here()
        return T, stayed if isinstance(stayed, Touch) else None, -direction

    def _follow(self, T: Poses, step: Floats) -> tuple[Poses, bool]:
        """Return the pose after a step from T (4, 4), brought to contact, and whether there is contact.

        The object slides by step[:2], metres, and rotates by step[2:], radians, about the gel's middle.
        """
        moved = self.source.move_about_gel(step[2:], np.array([*step[:2], 0.0])) @ T
        scene = Scene(self.source.object, self.source.geometry, self.source.renderer)
        poses, touching = scene.bring_to_contact(moved[None])
        return poses[0], bool(touching[0])

    def _draw_touch(self, T: Poses, press_m: float, gel: int) -> Touch | TouchError | None:
        return self.source.draw_touch(_press(T, press_m), press_m, "frame", np.random.default_rng(gel))

    def _measure_outside(self, touch: Touch | TouchError | None) -> float:
        """Return the distance of the contact's middle from the centre of the sensing rectangle.

        The distance is relative: 0 at the centre, 1 at the border, inf without contact.
        """
        if not isinstance(touch, Touch):
            return np.inf if touch is None else 0.0
        geometry = touch.geometry
        rows, columns = np.nonzero(touch.contact_shape.contact & geometry.observed_mask)
        k = geometry.surface_m if geometry.is_pinhole else 1.0
        middle = [k * slopes[i].mean() for slopes, i in zip(geometry.pixel_slopes, (columns, rows), strict=True)]
        x0, x1, y0, y1 = geometry.rectangle
        return float((2 * np.abs(np.subtract(middle, [(x0 + x1) / 2, (y0 + y1) / 2])) / [x1 - x0, y1 - y0]).max())


def _draw_direction(dimensions: int, rng: np.random.Generator) -> Floats:
    found = rng.normal(size=dimensions)
    return np.asarray(found / np.linalg.norm(found))


def _press(T: Poses, press_m: float) -> Poses:
    pressed = T.copy()
    pressed[2, 3] -= press_m
    return pressed


def draw_smooth(count: int, dt_s: float, columns: int, rng: np.random.Generator) -> Floats:
    """Return smoothly changing numbers (count, columns), one row every `dt_s` seconds, with a root mean square of 1.

    Each column is a sum of WAVES sine waves with random frequencies and phases.
    """
    t_s = dt_s * np.arange(count)[:, None, None]
    frequency = rng.uniform(SLOWEST_HZ, FASTEST_HZ, (columns, WAVES))
    phase = rng.uniform(0, 2 * np.pi, (columns, WAVES))
    return np.asarray(np.sqrt(2 / WAVES) * np.sin(2 * np.pi * frequency * t_s + phase).sum(axis=-1))


def draw_correlated(count: int, share: float, columns: int, rng: np.random.Generator) -> Floats:
    """Return standard normal numbers (count, columns), each column from a first-order autoregressive process.

    The correlation of rows k apart is (1 - share)^k.
    """
    kept = max(0.0, 1 - share)
    found = rng.normal(size=(count, columns))
    for k in range(1, count):
        found[k] = kept * found[k - 1] + np.sqrt(1 - kept**2) * found[k]
    return found
