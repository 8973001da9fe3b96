"""The points and normals of a contact shape's cloud, compiled with numba: see `clouds.py`.

The module is compiled with numba, which takes a while to import. Import the module only where it is needed.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_loc.core.runtime.compiled import njit

# mypy: ignore-errors

TINY = 1e-9  # a difference of neighbours on a flat surface, along rows or columns; only its direction counts


@njit
def make_cloud(z, drop, contact, observed, x_slopes, y_slopes, pinhole, pitch, walls, smooth, slope):
    """Return the points (P, 3) and unit normals (P, 3) of `clouds.make_contact_cloud`, first those of the surface.

    `z` and `drop` (H, W), metres, are the surface's z and its height above the deepest point of walls. `contact` (H, W)
    is the observed contact. `x_slopes` (W,) and `y_slopes` (H,) are `SensorGeometry.pixel_slopes`, and `pitch` is the
    size of a pixel, metres. `smooth` and `slope` (2 r + 1,) are as for `find_outwards`.
    """
    height, width = z.shape
    count = np.count_nonzero(contact)
    if walls:
        for row in range(height):
            for column in range(width):
                if contact[row, column] and drop[row, column] > pitch:
                    count += count_sides(row, column, contact, observed) * math.floor(drop[row, column] / pitch)
    points, normals, out = np.empty((count, 3)), np.empty((count, 3)), 0
    for row in range(height):
        for column in range(width):
            if contact[row, column]:
                points[out, 0], points[out, 1], points[out, 2] = find_point(row, column, z, x_slopes, y_slopes, pinhole)
                fill_normal(row, column, z, contact, x_slopes, y_slopes, pinhole, normals[out])
                out += 1
    if out == count:
        return points, normals
    outwards = np.empty(2)
    for side in range(4):
        down, right = find_side(side)
        for row in range(height):
            for column in range(width):
                if not (contact[row, column] and drop[row, column] > pitch):
                    continue
                if not is_outside(row + down, column + right, contact, observed):
                    continue
                find_outwards(row, column, contact, observed, smooth, slope, outwards)
                if not outwards[0] * right + outwards[1] * down > 0.0:
                    # a line of pixels has no outline direction, so its walls face along rows or columns
                    outwards[0], outwards[1] = right, down
                x, y, bottom = find_point(row, column, z, x_slopes, y_slopes, pinhole)
                for level in range(1, math.floor(drop[row, column] / pitch) + 1):
                    points[out, 0] = x + pitch * (0.5 * right)
                    points[out, 1] = y + pitch * (0.5 * down)
                    points[out, 2] = bottom + pitch * level
                    normals[out, 0], normals[out, 1], normals[out, 2] = outwards[0], outwards[1], 0.0
                    out += 1
    return points, normals


@njit
def fill_outline(contact, observed, smooth, slope, directions):
    """Fill `directions` (H, W, 2) with the direction of `find_outwards` at each pixel that is in contact."""
    for row in range(contact.shape[0]):
        for column in range(contact.shape[1]):
            if contact[row, column]:
                find_outwards(row, column, contact, observed, smooth, slope, directions[row, column])


@njit
def find_outwards(row, column, contact, observed, smooth, slope, direction):
    """Fill `direction` (2,), x and y, with the unit vector across the outline of contact, out of contact.

    It points down the slope of the contact mask, smoothed with the weights `smooth` (2 r + 1,); `slope` (2 r + 1,) are
    the weights of the derivative. Unobserved pixels count as half in contact. The vector is 0 where the mask is even.
    """
    r = len(smooth) // 2
    smoothed, sloping = np.empty(2 * r + 1), np.empty(2 * r + 1)
    for step in range(-r, r + 1):
        beside = min(max(column + step, 0), contact.shape[1] - 1)
        here = weigh(row, beside, contact, observed)
        smoothed[r + step], sloping[r + step] = here * smooth[r], here * slope[r]
        for k in range(-r, 0):
            above = weigh(max(row + k, 0), beside, contact, observed)
            below = weigh(min(row - k, contact.shape[0] - 1), beside, contact, observed)
            smoothed[r + step] += (above + below) * smooth[r + k]
            sloping[r + step] += (above - below) * slope[r + k]
    across, down = smoothed[r] * slope[r], sloping[r] * smooth[r]
    for k in range(-r, 0):
        across += (smoothed[r + k] - smoothed[r - k]) * slope[r + k]
        down += (sloping[r + k] + sloping[r - k]) * smooth[r + k]
    length = math.sqrt(across * across + down * down)
    if length == 0.0:
        length = 1.0
    direction[0], direction[1] = -across / length, -down / length


@njit
def weigh(row, column, contact, observed):
    """Return the value of a pixel in the mask whose slope is the outline's direction."""
    if not observed[row, column]:
        return 0.5
    return 1.0 if contact[row, column] else 0.0


@njit
def find_side(side):
    """Return the steps down and to the right to the neighbour number `side` of a pixel."""
    if side < 2:
        return 0, 1 - 2 * side
    return 5 - 2 * side, 0


@njit
def is_outside(row, column, contact, observed):
    """Return whether a pixel is observed and not in contact. The image continues beyond its border."""
    if row < 0 or column < 0 or row >= contact.shape[0] or column >= contact.shape[1]:
        return False
    return observed[row, column] and not contact[row, column]


@njit
def count_sides(row, column, contact, observed):
    """Return the number of a pixel's neighbours that are outside the contact."""
    count = 0
    for side in range(4):
        down, right = find_side(side)
        count += is_outside(row + down, column + right, contact, observed)
    return count


@njit
def find_point(row, column, z, x_slopes, y_slopes, pinhole):
    """Return x, y, z, metres, of the point that a pixel sees at its z."""
    k = z[row, column] if pinhole else 1.0
    return x_slopes[column] * k, y_slopes[row] * k, z[row, column]


@njit
def fill_normal(row, column, z, contact, x_slopes, y_slopes, pinhole, normal):
    """Fill `normal` (3,) with the unit normal at a pixel in contact, from differences between neighbours in contact."""
    d0, d1, d2 = find_difference(row, column, 1, 0, z, contact, x_slopes, y_slopes, pinhole)
    r0, r1, r2 = find_difference(row, column, 0, 1, z, contact, x_slopes, y_slopes, pinhole)
    n0, n1, n2 = d1 * r2 - d2 * r1, d2 * r0 - d0 * r2, d0 * r1 - d1 * r0
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    normal[0], normal[1], normal[2] = n0 / length, n1 / length, n2 / length


@njit
def find_difference(row, column, down, right, z, contact, x_slopes, y_slopes, pinhole):
    """Return the mean of the forward and backward differences between a pixel and its neighbours in contact.

    A pixel without neighbours in contact gets the difference of a flat surface.
    """
    x, y, height = find_point(row, column, z, x_slopes, y_slopes, pinhole)
    s0 = s1 = s2 = 0.0
    count = 0
    for sign in (1, -1):
        i, j = row + sign * down, column + sign * right
        if i < 0 or j < 0 or i >= contact.shape[0] or j >= contact.shape[1] or not contact[i, j]:
            continue
        other_x, other_y, other_height = find_point(i, j, z, x_slopes, y_slopes, pinhole)
        s0, s1, s2 = s0 + sign * (other_x - x), s1 + sign * (other_y - y), s2 + sign * (other_height - height)
        count += 1
    if count == 0:
        return TINY * right, TINY * down, 0.0
    return s0 / count, s1 / count, s2 / count
