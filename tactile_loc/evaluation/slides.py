"""A slide, recorded with known true poses: a sensor is pressed on an object, slides over it and lifts off."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats, Ints, Poses, invert, make_transform, rotation_about
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.evaluation.robot_touches import NO_NOISE, measure_noisily
from tactile_loc.evaluation.simulated_touches import require_true_pose
from tactile_loc.io.streams.recordings import RecordingWriter, write_recording
from tactile_loc.io.streams.ros_messages import (
    IMAGE,
    NS,
    POSE_STAMPED,
    TF,
    make_image,
    make_plain_pose,
    make_transforms,
)
from tactile_loc.locate.localizer import Localizer
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.simulate import render_touches
from tactile_loc.simulate.touch_simulation import lower
from tactile_loc.slots.renderer import Renderer

IMAGE_TOPIC, TRUTH_TOPIC = "/gel/image", "/object/truth"
BASE, FLANGE, GEL = "base", "flange", "gel"
START_NS = 1_700_000_000 * NS
RATE_HZ = 30.0
REACH_M, TURN_RAD = 3e-3, 0.35  # amplitudes of the slide along x and y, and of the rotation
PRESS = (0.5, 0.9)  # shares of the maximal depth
LIFTED = 0.04  # share of images without contact at the beginning, and as many at the end
LIFT_M = 2e-3
STARTS = 12
T_BASE_OBJECT = make_transform(rotation_about([1, 2, 3], 0.7), [0.4, -0.1, 0.2])
T_FLANGE_GEL = make_transform(rotation_about([0, 0, 1], 0.4) @ rotation_about([0, 1, 0], 0.1), [0.01, 0.0, 0.12])

Show = Callable[[Float32, float], tuple[NDArray[Any], str]]


@dataclass(frozen=True, eq=False)
class Slide:
    """The true poses of an object at 2 N - 1 evenly spaced times; every second time, from the first, has an image.

    `stamps_ns` (2 N - 1,) are the times. `T_sensor_object` (2 N - 1, 4, 4), metres, are the poses. `press_m` (2 N -
    1,), metres, are the presses; they are negative without contact. The images have `noise`, drawn with `seed`.
    """

    scene: Scene
    stamps_ns: Ints
    T_sensor_object: Poses
    press_m: Floats
    noise: TouchNoise = NO_NOISE
    seed: int = 0

    @property
    def frames(self) -> range:
        """The numbers of the times with an image."""
        return range(0, len(self.stamps_ns), 2)

    @property
    def T_base_flange(self) -> Poses:  # noqa: N802 - the field's name
        """The poses of the robot's flange (2 N - 1, 4, 4), metres; the object is at rest."""
        return T_BASE_OBJECT @ invert(self.T_sensor_object) @ invert(T_FLANGE_GEL)

    def draw_depths_m(self, number: int) -> Float32:
        """Return the contact shape (H, W) at a time, metres; without contact, it is the maximal depth everywhere."""
        geometry, press_m = self.scene.geometry, float(self.press_m[number])
        untouched = np.full(geometry.shape, geometry.max_depth_m, np.float32)
        if press_m <= 0:
            return untouched
        seen = self.scene.press(press_m, geometry.max_depth_m)
        clean = seen.render_gel_depths(self.T_sensor_object[number][None])
        rng = np.random.default_rng([self.seed, number])
        depth, measured_m = measure_noisily(self.noise, clean, press_m, seen.geometry, rng)
        return depth if (depth < np.float32(measured_m)).any() else untouched


def draw_slide(scene: Scene, T_start: Floats, frames: int, noise: TouchNoise = NO_NOISE, seed: int = 0) -> Slide:
    """Return a slide of an object from a pose (4, 4), metres, along a figure of eight, with a varying press.

    `scene` draws the touches; its renderer should differ from the localizer's. Raises TouchError if the object slides
    off the sensor.
    """
    count = 2 * frames - 1
    phase = np.linspace(0, 2 * np.pi, count)
    moved = _rotate_about_gel(scene, T_start, TURN_RAD * np.sin(phase))
    moved[:, :2, 3] += REACH_M * np.stack([np.sin(phase), np.sin(2 * phase)], axis=1)
    poses, touching = scene.bring_to_contact(moved)
    if not touching.all():
        raise TouchError(f"{scene.object.name} slides off the sensor; start where more of the sensor is in contact")
    low, high = PRESS
    press_m = scene.geometry.max_depth_m * (low + (high - low) * 0.5 * (1 - np.cos(5 * phase)))
    lifted = 2 * round(LIFTED * frames)
    press_m[:lifted] = press_m[count - lifted :] = -LIFT_M
    stamps = START_NS + np.round(np.arange(count) * NS / (2 * RATE_HZ)).astype(np.int64)
    return Slide(scene, stamps, lower(poses, press_m), press_m, noise, seed)


def _rotate_about_gel(scene: Scene, T: Floats, angles_rad: Floats) -> Poses:
    """Return a pose (4, 4), metres, rotated by each of N angles about the middle of the gel: (N, 4, 4)."""
    x0, x1, y0, y1 = scene.geometry.rectangle
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    R = rotation_about([0, 0, 1], angles_rad)
    return make_transform(R, middle - R @ middle) @ T


def draw_random_slide(
    localizer: Localizer, frames: int, seed: int, noise: TouchNoise = NO_NOISE, renderer: Renderer | None = None
) -> Slide:
    """Return a slide from a simulated touch, drawn with a `renderer`, by default the localizer's.

    Raises TouchError if the object slides off the sensor from all of STARTS touches.
    """
    scene = dataclasses.replace(localizer.scene, renderer=renderer or localizer.scene.renderer)
    for touch in localizer.simulate(STARTS, seed):
        try:
            return draw_slide(scene, require_true_pose(touch), frames, noise, seed)
        except TouchError as error:
            refused = error
    raise refused


class Photos:
    """Draws the camera images of a sensor with `sensors.optics`; the images' noise is drawn with a `seed`."""

    def __init__(self, geometry: SensorGeometry, optics: Optics, seed: int) -> None:
        self._geometry, self._optics, self._rng = geometry, optics, np.random.default_rng(seed)

    def __call__(self, depth_m: Float32, press_m: float) -> tuple[NDArray[Any], str]:
        """Return the photo (H, W, 3) of a contact shape (H, W), metres."""
        press = press_m if press_m > 0 else self._geometry.max_depth_m
        return render_touches(depth_m[None], [press], self._geometry, self._optics, self._rng)[0], "rgb8"


def show_depths(depth_m: Float32, press_m: float) -> tuple[NDArray[Any], str]:
    """Return a contact shape (H, W), metres, unchanged."""
    return depth_m, "32FC1"


def write_slide(path: Path, slide: Slide, show: Show = show_depths) -> Path:
    """Write a slide as a recording, and return its path. `show` makes an image from a contact shape and a press.

    `/gel/image` has the images, in the frame `gel`. `/tf` has the flange's poses, at twice the rate of the images.
    `/tf_static` has the gel's pose on the flange. `/object/truth` has the object's true poses. Raises OutputError, and
    MissingLibraryError without mcap and rosbags.
    """

    def write(writer: RecordingWriter) -> None:
        first = int(slide.stamps_ns[0])
        mounted = make_transforms({(FLANGE, GEL): T_FLANGE_GEL}, first)
        writer.write("/tf_static", TF, mounted, first)
        for number, T_base_flange in enumerate(slide.T_base_flange):
            stamp = int(slide.stamps_ns[number])
            writer.write("/tf", TF, make_transforms({(BASE, FLANGE): T_base_flange}, stamp), stamp)
            if number in slide.frames:
                values, encoding = show(slide.draw_depths_m(number), float(slide.press_m[number]))
                writer.write(IMAGE_TOPIC, IMAGE, make_image(values, encoding, stamp, GEL), stamp)
                truth = make_plain_pose(slide.T_sensor_object[number], stamp, GEL)
                writer.write(TRUTH_TOPIC, POSE_STAMPED, truth, stamp)

    return write_recording(path, write)
