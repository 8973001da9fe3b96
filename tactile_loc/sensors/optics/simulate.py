"""Simulated images of contact shapes, and training pairs from the calibration boards."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.boards import draw_board_poses, make_board
from tactile_loc.sensors.optics.gel import SOFTNESS_M, find_indentation, press_gel
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.shading import render_images
from tactile_loc.slots.renderer import Renderer

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]

BATCH = 16
LIGHTEST = 0.3  # least press depth, share of the maximal depth
LEAST_CONTACT = 0.01  # least share of the observed pixels in contact
MOST_ROUNDS = 100  # largest number of attempts to draw presses with enough contact


class BoardPresses(NamedTuple):
    """Presses of a board: `images` (N, H, W, 3) uint8 RGB, and the true indentations and press depths in metres.

    `indentation_m` (N, H, W) float32 is 0 where the gel is not pressed in. `press_depth_m` is (N,) float64.
    """

    images: Image
    indentation_m: Float32
    press_depth_m: NDArray[np.float64]


def render_touches(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    optics: Optics,
    rng: np.random.Generator,
    softness_m: float | None = None,
    background: Image | None = None,
) -> Image:
    """Return images (N, H, W, 3) uint8 RGB of contact depths (N, H, W) at press depths (N,), metres.

    `softness_m` is the softness of the gel (see `press_gel`). By default, it is SOFTNESS_M for a rigid gel. It is 0 for
    an elastic gel, whose contact depths already show the gel's surface. `background` (H, W, 3) uint8 is a photo of the
    unpressed sensor (see `render_images`). Raises ConfigError for sizes that do not fit.
    """
    if softness_m is None:
        softness_m = 0.0 if geometry.gel.is_elastic else SOFTNESS_M
    surface = press_gel(depth_m, press_depth_m, geometry, softness_m)
    return render_images(surface, geometry, optics, rng, background)


def press_boards(
    geometry: SensorGeometry,
    count: int,
    optics: Optics,
    rng: np.random.Generator,
    renderer: Renderer,
    background: Image | None = None,
) -> Iterator[BoardPresses]:
    """Yield `count` presses of the calibration boards in batches of at most `BATCH`, alternating between the boards.

    Poses are drawn by `draw_board_poses` and brought to contact. They do not depend on the optics. Press depths are
    drawn uniformly between `LIGHTEST` of the maximal depth and the maximal depth. Raises TouchError when hardly any
    press leaves an imprint.
    """
    camera = rng.spawn(1)[0]  # a separate stream, so the camera's noise does not change the presses
    scenes = [Scene(make_board(number), geometry, renderer) for number in (1, 2)]
    for i in range(math.ceil(count / BATCH)):
        depth, press = _draw_presses(scenes[i % 2], min(BATCH, count - i * BATCH), rng)
        images = render_touches(depth, press, geometry, optics, camera, background=background)
        yield BoardPresses(images, find_indentation(depth, press), press)


def _draw_presses(scene: Scene, count: int, rng: np.random.Generator) -> tuple[Float32, NDArray[np.float64]]:
    """Draw contact depths (count, H, W) that the gel shows of a board, and their press depths (count,), metres.

    All presses have enough contact.
    """
    geometry = scene.geometry
    depths, presses = np.empty((0, *geometry.shape), np.float32), np.empty(0)
    for _ in range(MOST_ROUNDS):
        T, touching = scene.bring_to_contact(draw_board_poses(scene.object, geometry, count - len(depths), rng))
        press = geometry.max_depth_m * rng.uniform(LIGHTEST, 1.0, len(T))
        depth = np.minimum(scene.render_contact_depths(T), press.astype(np.float32)[:, None, None])
        contact = (depth < press.astype(np.float32)[:, None, None]) & geometry.observed_mask
        depth = deform_gel(depth, press, geometry)
        shows = touching & (contact.sum(axis=(1, 2)) >= max(1.0, LEAST_CONTACT * geometry.observed_mask.sum()))
        depths, presses = np.concatenate([depths, depth[shows]]), np.concatenate([presses, press[shows]])
        if len(depths) == count:
            return depths, presses
    raise TouchError(
        f"hardly any press of {scene.object.name} leaves an imprint on this sensor; check its sensing area and mask"
    )
