"""Simulated images of contact shapes, and training pairs from the calibration boards.

A gel shows the object's surface in the contact, and returns smoothly to rest around it. It cannot follow a step.
Outside the contact, the gel's surface falls off, steeply at first and then with a long tail. This shape is computed by
blurs of decreasing width. After each blur, the contact is restored. Wide blurs make the tail, and narrow blurs join the
tail to the contact's edge. All widths are in metres on the sensing surface.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.noise import GelPixels
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.boards import draw_board_poses, make_board
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.shading import render_images
from tactile_loc.slots.renderer import Renderer

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]

SOFTNESS_M = 8e-4  # fitted to photos of a flat prism, pressed 0.25 to 1 mm into a GelSlim
WIDTHS = (2.0, 1.0, 0.5, 0.25)  # widths of the blurs, as multiples of the softness
ROUNDING = 0.06  # width of the last blur, as a multiple of the softness
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


def find_indentation(depth_m: NDArray[np.floating[Any]], press_depth_m: ArrayLike) -> Float32:
    """Return the object's indentation (N, H, W), metres: press depth minus depth, or 0 outside the contact.

    `depth_m` (N, H, W) are contact depths and `press_depth_m` (N,) are press depths, metres. Raises ConfigError for
    other shapes.
    """
    depth, press = np.asarray(depth_m, np.float32), np.asarray(press_depth_m, np.float32)
    if depth.ndim != 3 or press.shape != depth.shape[:1]:
        raise ConfigError(
            f"contact depths of shape {depth.shape} do not fit press depths of shape {press.shape}; "
            "give (N, H, W) depths and (N,) presses"
        )
    indentation: Float32 = np.maximum(press[:, None, None] - depth, np.float32(0))
    return indentation


def press_gel(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    softness_m: float = SOFTNESS_M,
) -> Float32:
    """Return the indentation of the gel's surface (N, H, W) float32, metres, not below 0.

    `depth_m` (N, H, W) are contact depths at press depths `press_depth_m` (N,), both in metres. Around the contact, the
    surface returns to rest over a distance of about `softness_m` metres. Edges are rounded by a small share of this
    distance. If the softness is zero, the surface is that of the object. Outside the sensing rectangle, the indentation
    is 0. Raises ConfigError for sizes that do not fit.
    """
    contact = find_indentation(depth_m, press_depth_m)
    if contact.shape[1:] != geometry.shape:
        raise ConfigError(
            f"contact depths of {contact.shape[1:]} pixels do not fit the sensor's image; give {geometry.shape}"
        )
    if not (math.isfinite(softness_m) and softness_m >= 0):
        raise ConfigError(f"the gel's softness_m is {softness_m}; it must be zero or positive")
    gel = GelPixels.of(geometry)
    surface = np.zeros_like(contact)
    pushed = contact[:, gel.rows, gel.columns]
    if softness_m > 0:
        pushed = gel.blur(relax(pushed, gel, softness_m), ROUNDING * softness_m)
    surface[:, gel.rows, gel.columns] = pushed
    return surface


def relax(contact_m: Float32, gel: GelPixels, softness_m: float) -> Float32:
    """Return the indentation (N, h, w), metres, of a gel in which an object has the indentation `contact_m` (N, h, w).

    The gel's indentation is nowhere smaller than that of the object.
    """
    surface = contact_m
    for width in WIDTHS:
        surface = np.maximum(gel.blur(surface, width * softness_m), contact_m)
    return surface


def render_touches(
    depth_m: NDArray[np.floating[Any]],
    press_depth_m: ArrayLike,
    geometry: SensorGeometry,
    optics: Optics,
    rng: np.random.Generator,
    background: Image | None = None,
) -> Image:
    """Return images (N, H, W, 3) uint8 RGB of contact depths (N, H, W) at press depths (N,), metres.

    The contact depths of an elastic gel already show the gel's surface. Otherwise, the gel has the softness SOFTNESS_M
    (see `press_gel`). `background` (H, W, 3) uint8 is a photo of the unpressed sensor (see `render_images`). Raises
    ConfigError for sizes that do not fit.
    """
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
