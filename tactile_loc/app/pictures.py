"""Pictures of contact shapes as arrays, drawn fast enough to follow a moving finger."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.drawing.pictures import NO_CONTACT, UNSEEN

WIDE_PX, GAP_PX = 288, 12  # long side of one picture, and the gap between two

Picture = NDArray[np.uint8]


def paint_shape(shape: ContactShape, geometry: SensorGeometry) -> Picture:
    """Return a picture (H, W, 3) of a contact shape, with dark pixels where the object is deepest in the gel."""
    step = max(1, round(max(shape.depth_m.shape) / WIDE_PX))
    depth_m, observed = shape.depth_m[::step, ::step], geometry.observed_mask[::step, ::step]
    share = np.clip(depth_m / np.float32(shape.press_depth_m), 0, 1)
    picture = _list_colours()[(255 * share).astype(np.uint8)]
    picture[depth_m >= np.float32(shape.press_depth_m)] = _read_colour(NO_CONTACT)
    picture[~observed] = _read_colour(UNSEEN)
    grown = max(1, WIDE_PX // max(picture.shape[:2]))
    return picture.repeat(grown, axis=0).repeat(grown, axis=1)


def paint_beside(left: Picture, right: Picture) -> Picture:
    """Return two pictures (H, W, 3) of one size side by side."""
    gap = np.full((left.shape[0], GAP_PX, 3), 255, np.uint8)
    return np.concatenate([left, gap, right], axis=1)


def colour_probability(probability: float, most: float) -> tuple[int, int, int]:
    """Return the colour of a pose: yellow and orange if probable, violet if not. `most` is the largest probability."""
    from matplotlib import colormaps

    red, green, blue, _ = colormaps["plasma"](0.1 + 0.75 * probability / max(most, 1e-12), bytes=True)
    return int(red), int(green), int(blue)


@cache
def _list_colours() -> Picture:
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.arange(256), bytes=True)[:, :3], np.uint8)


@cache
def _read_colour(text: str) -> Picture:
    from matplotlib.colors import to_rgb

    return np.round(255 * np.array(to_rgb(text))).astype(np.uint8)
