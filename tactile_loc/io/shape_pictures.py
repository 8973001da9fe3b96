"""Contact shapes as arrays of colours, without a drawing library, for pages that show many of them."""

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape

Picture = NDArray[np.uint8]

# colours of the depth, from full penetration to the press depth
DEPTHS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
NO_CONTACT, UNSEEN, OUTLINE = "#eceff1", "#b0bec5", "#e03131"


def read_colour(text: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour such as "#eceff1"."""
    red, green, blue = bytes.fromhex(text[1:])
    return red, green, blue


def paint_shape(shape: ContactShape, geometry: SensorGeometry) -> Picture:
    """Return a picture (H, W, 3) of a contact shape, with dark pixels where the object is deepest in the gel."""
    known = np.array([read_colour(text) for text in DEPTHS], float)
    share = np.clip(shape.depth_m / shape.press_depth_m, 0, 1) * (len(known) - 1)
    picture = np.stack([np.interp(share, np.arange(len(known)), channel) for channel in known.T], -1).astype(np.uint8)
    picture[~shape.contact] = read_colour(NO_CONTACT)
    picture[~geometry.observed_mask] = read_colour(UNSEEN)
    return picture
