"""The image of a touch that the joint registration uses, compiled with numba: see `Observed.images`."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors


@njit
def fill_image(z, heights, gel, contact, observed, x_slopes, y_slopes, pinhole, unit, image):
    """Fill `image` (H - 1, W - 1, 4) with the rows of `Observed.images`, from the surface that one touch shows.

    `z` (H, W), metres, is the surface's z; `heights` and `gel` (H, W), mm, are the surface's z and that of the gel at
    the press depth. `contact` and `observed` (H, W) are masks. `x_slopes` (W,) and `y_slopes` (H,) are as in
    `SensorGeometry.pixel_slopes`. `unit` is the number of mm in a metre.
    """
    rows, columns = find_nearest(contact)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            lowest, free, known = np.inf, np.inf, True
            for i in (row, row + 1):
                for j in (column, column + 1):
                    known = known and observed[i, j]
                    free = min(free, gel[i, j])
                    if contact[i, j]:
                        lowest = min(lowest, heights[i, j])
            if not known:
                image[row, column, 0] = np.nan
            else:
                image[row, column, 0] = lowest if lowest < np.inf else -free
            i, j = rows[row, column], columns[row, column]
            if i < 0:
                image[row, column, 1:] = np.inf
                continue
            k = z[i, j] if pinhole else 1.0
            image[row, column, 1] = x_slopes[j] * k * unit
            image[row, column, 2] = y_slopes[i] * k * unit
            image[row, column, 3] = z[i, j] * unit


@njit
def find_nearest(mask):
    """Return the rows and the columns (H, W) of the pixel of a mask (H, W) that is nearest to each pixel.

    Of pixels at equal distances, the one in the first column, then in the first row, is chosen. All are -1 if the mask
    is empty. Each column is scanned first. Then the lower envelope of the columns' parabolas is found in each row
    (Felzenszwalb and Huttenlocher, 2012).
    """
    height, width = mask.shape
    near = find_nearest_in_columns(mask)
    rows, columns = np.full((height, width), -1), np.full((height, width), -1)
    kept = np.empty(width, np.int64)  # columns whose parabolas are in the lower envelope
    for row in range(height):
        count = 0
        for column in range(width):
            if near[row, column] < 0:
                continue
            while count > 1 and is_hidden(row, kept[count - 2], kept[count - 1], column, near):
                count -= 1
            kept[count] = column
            count += 1
        if count == 0:
            continue
        k = 0
        for column in range(width):
            while k + 1 < count and square(row, column, kept[k + 1], near) < square(row, column, kept[k], near):
                k += 1
            rows[row, column], columns[row, column] = near[row, kept[k]], kept[k]
    return rows, columns


@njit
def find_nearest_in_columns(mask):
    """Return the row (H, W) of the nearest pixel of a mask in the same column, the upper one of two; -1 if none."""
    height, width = mask.shape
    near = np.full((height, width), -1)
    for row in range(height):
        for column in range(width):
            if mask[row, column]:
                near[row, column] = row
            elif row > 0:
                near[row, column] = near[row - 1, column]
    for row in range(height - 2, -1, -1):
        for column in range(width):
            above, below = near[row, column], near[row + 1, column]
            if below >= 0 and (above < 0 or below - row < row - above):
                near[row, column] = below
    return near


@njit
def square(row, column, other, near):
    """Return the squared distance of a pixel from the pixel of the mask in another column."""
    return (column - other) ** 2 + (row - near[row, other]) ** 2


@njit
def is_hidden(row, first, middle, last, near):
    """Return whether the parabola of column `middle` is nowhere below those of the columns before and after it."""
    a, b = middle - first, last - middle
    first_square = (near[row, first] - row) ** 2
    middle_square = (near[row, middle] - row) ** 2
    last_square = (near[row, last] - row) ** 2
    return (a + b) * middle_square - b * first_square - a * last_square - a * b * (a + b) > 0
