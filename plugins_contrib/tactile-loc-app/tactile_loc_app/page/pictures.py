"""Pictures of contact shapes as arrays, drawn fast enough to follow a moving finger."""

import numpy as np
from numpy.typing import NDArray
from tactile_loc import ContactShape, SensorGeometry, paint_shape

WIDE_PX, GAP_PX = 216, 12  # long side of one picture, and the gap between two
Picture = NDArray[np.uint8]

EMPTY = np.full((96, 96, 3), 236, np.uint8)


def paint_wide(shape: ContactShape, geometry: SensorGeometry) -> Picture:
    """Return a picture (H, W, 3) of a contact shape whose long side has about WIDE_PX pixels."""
    step = max(1, round(max(shape.depth_m.shape) / WIDE_PX))
    picture = paint_shape(shape.subsample(step), geometry.subsample(step))
    grown = max(1, WIDE_PX // max(picture.shape[:2]))
    return picture.repeat(grown, axis=0).repeat(grown, axis=1)


def paint_photo(photo: Picture, size_px: tuple[int, int]) -> Picture:
    """Return a photo (H, W, 3) with a number of rows and columns, by its nearest pixels."""
    rows, columns = (np.arange(n) * length // n for n, length in zip(size_px, photo.shape, strict=False))
    return photo[rows[:, None], columns[None]]


def paint_beside(left: Picture, right: Picture) -> Picture:
    """Return two pictures (H, W, 3) of one size side by side."""
    gap = np.full((left.shape[0], GAP_PX, 3), 255, np.uint8)
    return np.concatenate([left, gap, right], axis=1)
