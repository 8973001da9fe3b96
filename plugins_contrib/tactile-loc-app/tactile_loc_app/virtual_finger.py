"""A virtual finger: a sensor that is pressed on an object at rest, whose frame is the base frame."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc import ContactShape, SensorGeometry, Touch, make_noise, press_touch
from tactile_loc.plugin import Scene, registry
from tactile_loc.plugin.helpers import invert

INDEPENDENT = "zbuffer"  # the renderer of touches; it is not the one that locates them
PREVIEW_PX = 72  # pixels along the long side of the contact shape that is shown while the finger moves

Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Press:
    """A virtual finger at `T_base_sensor` (4, 4), metres, and the contact shape that it shows.

    `geometry` is the pressed sensor with the pixels of `shape`. If the finger misses the object, nothing is in contact.
    """

    T_base_sensor: Pose
    shape: ContactShape
    geometry: SensorGeometry

    @property
    def touches(self) -> bool:
        """Whether an observed pixel is in contact."""
        return bool((self.shape.contact & self.geometry.observed_mask).any())

    def build_gel_surface(self) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return the gel's surface as vertices (V, 3), metres, in the sensor frame, and triangles (F, 3)."""
        z = self.geometry.full_penetration_m + self.shape.depth_m
        points = self.geometry.backproject(z).reshape(-1, 3).astype(np.float32)
        return points, _list_triangles(self.geometry.observed_mask)


def _list_triangles(shown: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Return triangles (F, 3) between neighbouring pixels (H, W) whose four corners are `shown`."""
    height, width = shown.shape
    number = np.arange(height * width, dtype=np.uint32).reshape(height, width)
    whole = shown[:-1, :-1] & shown[:-1, 1:] & shown[1:, :-1] & shown[1:, 1:]
    a, b, c, d = (part[whole] for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    return np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])


def press_finger(scene: Scene, T_base_sensor: Pose, depth_m: float) -> Press:
    """Move a finger at `T_base_sensor` (4, 4), metres, along its z axis to the object, and press it `depth_m` deep.

    The object rests with its frame at the base. The contact shape has few pixels, so that it can follow a moving hand.
    Raises SensorError if the sensor cannot be pressed that deep.
    """
    few = dataclasses.replace(scene, geometry=scene.geometry.resize_long_side(PREVIEW_PX)).press(depth_m)
    T, touching = few.bring_to_contact(invert(T_base_sensor)[None])
    depth = np.full(few.geometry.shape, depth_m, np.float32)
    if touching[0]:
        depth = few.render_gel_depths(T, depth_m)[0]
    return Press(invert(T[0]), ContactShape(depth, depth_m), few.geometry)


def make_touch(
    scene: Scene, T_base_sensor: Pose, depth_m: float, name: str, noise: str, rng: np.random.Generator
) -> Touch:
    """Return the touch, with all pixels, of a finger that is pressed as by `press_finger`.

    It is drawn independently of the renderer that locates touches. `noise` is none, mild or strong. Raises
    NoContactError if the finger misses the object, TouchError if it shows only a flat face, and ConfigError for another
    noise.
    """
    scene = dataclasses.replace(scene, renderer=registry().create("renderer", INDEPENDENT, {}))
    return press_touch(scene, T_base_sensor, depth_m, name, make_noise(noise), rng)
