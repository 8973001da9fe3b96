"""Contact shapes as point clouds with normals, for registration."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

import math
from functools import cache

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Floats, Ints
from tactile_loc.core.runtime.compiled import njit
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape

Points = Floats
OUTLINE_PX = 1.5  # standard deviation, pixels, of the smoothing before an outline's direction is measured
OUTLINE_REACH_PX = 4  # pixels beyond which the smoothing ends
SIDES = ((0, 1), (0, -1), (1, 0), (-1, 0))  # row and column steps to a pixel's neighbours


def make_contact_cloud(shape: ContactShape, geometry: SensorGeometry, walls: bool = True) -> tuple[Points, Points]:
    """Return the surface in contact as points (P, 3), metres, in the sensor frame, and their unit normals (P, 3).

    The normals of the surface point into the sensor (towards -z). With `walls`, the cloud also has points on walls
    along the outline of the contact. A wall stands at each pixel on the outline whose depth is more than a pixel's size
    below the press depth. It leads from the surface to the press depth, and its normals point sideways, out of contact.
    A flat face alone does not determine the object's sideways position; its walls do. The border of the image has no
    walls, because the object continues beyond it. An elastic gel shows no walls, because it slopes down beside them.
    """
    observed, depth_m = geometry.observed_mask, np.ascontiguousarray(shape.depth_m, float)
    surface = depth_m + geometry.full_penetration_m, np.ascontiguousarray(shape.contact & observed), observed
    rays, walls = (*geometry.pixel_slopes, geometry.is_pinhole), walls and not geometry.gel.is_elastic
    drop_m, pitch_m = shape.press_depth_m - depth_m, geometry.pixel_pitch_m
    points, normals = make_cloud(surface, drop_m, rays, pitch_m, walls, _list_outline_weights())
    return points, normals


def make_outline_cloud(shape: ContactShape, geometry: SensorGeometry) -> tuple[Points, Points]:
    """Return the outline of a contact mask on the undeformed gel: points (P, 3), metres, and unit normals (P, 3).

    The object's surface crosses the gel's surface somewhere between a sideways wall and a shallow slope. So the normals
    are halfway between the mask's outward direction and -z. The border of the image is no outline, because the object
    continues beyond it.
    """
    observed, contact = geometry.observed_mask, shape.contact & geometry.observed_mask
    xyz = geometry.backproject(np.broadcast_to(geometry.full_penetration_m + shape.press_depth_m, geometry.shape))
    outwards = -_measure_slopes(np.where(observed, contact, 0.5))
    outwards /= np.maximum(np.linalg.norm(outwards, axis=-1, keepdims=True), TINY)
    points, normals = [np.empty((0, 3))], [np.empty((0, 3))]
    for rows, columns in SIDES:
        borders = contact & _shift(~contact & observed, rows, columns)
        points.append(xyz[borders] + 0.5 * geometry.pixel_pitch_m * np.array([columns, rows, 0.0]))
        normals.append(np.column_stack([outwards[borders], np.full(np.count_nonzero(borders), -1.0)]))
    directions = np.concatenate(normals)
    return np.concatenate(points), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def make_interior_cloud(shape: ContactShape, geometry: SensorGeometry) -> tuple[Points, Points, float]:
    """Return points (P, 3), metres, inside a contact mask, their normals (P, 3), and the slack of their z, metres.

    The object's surface is anywhere between the deepest press and the undeformed gel, so the points are halfway.
    """
    slack_m = 0.5 * (shape.press_depth_m + shape.press_slack_m)
    contact = shape.contact & geometry.observed_mask
    halfway = geometry.full_penetration_m + shape.press_depth_m - slack_m
    points = geometry.backproject(np.broadcast_to(halfway, geometry.shape))[contact]
    return points, np.broadcast_to([0.0, 0.0, -1.0], points.shape), slack_m


def spread_points(points: Points, count: int, first: int = 0, least: float = 0.0) -> list[int]:
    """Return the numbers of at most `count` of the points (N, 3): the `first`, and then the farthest from those chosen.

    No two of them are nearer to each other than `least`, in the unit of the points.
    """
    chosen, far = [first], np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < count and far.max() > least:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def find_nearest_contact(contact: Bools) -> tuple[Ints, Ints]:
    """Return the row and the column (H, W) of the pixel in contact nearest to each pixel, given contact (H, W).

    If two pixels are equally near, that of the lower column is taken, and then that of the lower row. Raises ValueError
    without contact.
    """
    if not contact.any():
        raise ValueError("no pixel is in contact")
    rows, columns = np.full(contact.shape, -1), np.full(contact.shape, -1)
    fill_nearest_contact(np.ascontiguousarray(contact), rows, columns)
    return rows, columns


def _measure_slopes(mask: Points) -> Points:
    """Return the slopes (H, W, 2), along x and y, of a mask (H, W), smoothed over the pixel steps of its outline."""
    from scipy.ndimage import gaussian_filter

    reach = {"mode": "nearest", "radius": OUTLINE_REACH_PX}
    return np.stack([gaussian_filter(mask, OUTLINE_PX, order, **reach) for order in ((0, 1), (1, 0))], axis=-1)


@cache
def _list_outline_weights() -> tuple[Points, Points]:
    """Return the weights (2 r + 1,) of a Gaussian with the standard deviation OUTLINE_PX, and of its derivative."""
    steps = np.arange(-OUTLINE_REACH_PX, OUTLINE_REACH_PX + 1)
    smooth = np.exp(-0.5 / OUTLINE_PX**2 * steps**2)
    smooth /= smooth.sum()
    return smooth, steps * (1 / OUTLINE_PX**2) * smooth


def _shift(mask: Bools, rows: int, columns: int) -> Bools:
    """Return each pixel's neighbour in the mask (H, W), `rows` down and `columns` right; False beyond the image."""
    padded = np.pad(mask, 1)
    return padded[1 + rows : padded.shape[0] - 1 + rows, 1 + columns : padded.shape[1] - 1 + columns]


TINY = 1e-9  # a difference of neighbours on a flat surface, along rows or columns; only its direction counts


@njit
def make_cloud(surface, drop, rays, pitch, walls, weights):
    """Return the points (P, 3) and unit normals (P, 3) of `make_contact_cloud`, first those of the surface.

    `surface` are the surface's z, metres, the observed contact and the observed pixels (H, W). `drop` (H, W), metres,
    is its height above the deepest point of walls. `rays` are the slopes (W,), (H,) of `SensorGeometry.pixel_slopes`,
    and whether the camera is a pinhole. `pitch` is the size of a pixel, metres. `weights` are as for `find_outwards`.
    """
    (z, contact, observed), (smooth, slope) = surface, weights
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
                points[out, 0], points[out, 1], points[out, 2] = find_point(row, column, z, rays)
                fill_normal(row, column, z, contact, rays, normals[out])
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
                x, y, bottom = find_point(row, column, z, rays)
                for level in range(1, math.floor(drop[row, column] / pitch) + 1):
                    points[out, 0] = x + pitch * (0.5 * right)
                    points[out, 1] = y + pitch * (0.5 * down)
                    points[out, 2] = bottom + pitch * level
                    normals[out, 0], normals[out, 1], normals[out, 2] = outwards[0], outwards[1], 0.0
                    out += 1
    return points, normals


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
def find_point(row, column, z, rays):
    """Return x, y, z, metres, of the point that a pixel sees at its z."""
    x_slopes, y_slopes, pinhole = rays
    k = z[row, column] if pinhole else 1.0
    return x_slopes[column] * k, y_slopes[row] * k, z[row, column]


@njit
def fill_normal(row, column, z, contact, rays, normal):
    """Fill `normal` (3,) with the unit normal at a pixel in contact, from differences between neighbours in contact."""
    d0, d1, d2 = find_difference(row, column, 1, 0, z, contact, rays)
    r0, r1, r2 = find_difference(row, column, 0, 1, z, contact, rays)
    n0, n1, n2 = d1 * r2 - d2 * r1, d2 * r0 - d0 * r2, d0 * r1 - d1 * r0
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    normal[0], normal[1], normal[2] = n0 / length, n1 / length, n2 / length


@njit
def find_difference(row, column, down, right, z, contact, rays):
    """Return the mean of the forward and backward differences between a pixel and its neighbours in contact.

    A pixel without neighbours in contact gets the difference of a flat surface.
    """
    x, y, height = find_point(row, column, z, rays)
    s0 = s1 = s2 = 0.0
    count = 0
    for sign in (1, -1):
        i, j = row + sign * down, column + sign * right
        if i < 0 or j < 0 or i >= contact.shape[0] or j >= contact.shape[1] or not contact[i, j]:
            continue
        other_x, other_y, other_height = find_point(i, j, z, rays)
        s0, s1, s2 = s0 + sign * (other_x - x), s1 + sign * (other_y - y), s2 + sign * (other_height - height)
        count += 1
    if count == 0:
        return TINY * right, TINY * down, 0.0
    return s0 / count, s1 / count, s2 / count


@njit
def fill_nearest_contact(contact, rows, columns):
    """Fill `rows` and `columns` (H, W), which are -1, as `find_nearest_contact` describes.

    Felzenszwalb and Huttenlocher, Distance Transforms of Sampled Functions, 2012: the squared distance along a row of
    pixels is the lower envelope of one parabola for each column.
    """
    height, width = contact.shape
    near, centres, begins = np.full(contact.shape, -1), np.empty(width, np.int64), np.empty(width + 1, np.int64)
    for c in range(width):  # first, the nearest row in the same column
        last = -1
        for r in range(height):
            last = r if contact[r, c] else last
            near[r, c] = last
        last = -1
        for r in range(height - 1, -1, -1):
            last = r if contact[r, c] else last
            if last >= 0 and (near[r, c] < 0 or last - r < r - near[r, c]):
                near[r, c] = last
    for r in range(height):
        count = 0
        for c in range(width):
            if near[r, c] < 0:
                continue
            begin, added = 0, (near[r, c] - r) ** 2 + c * c
            while count > 0:
                before = centres[count - 1]  # its parabola is the higher one from column `begin` on
                begin = (added - (near[r, before] - r) ** 2 - before * before) // (2 * (c - before)) + 1
                if begin > begins[count - 1]:
                    break
                count, begin = count - 1, 0
            if begin < width:
                centres[count], begins[count], count = c, begin, count + 1
        begins[count], k = width, 0
        for c in range(width):
            while begins[k + 1] <= c:
                k += 1
            rows[r, c], columns[r, c] = near[r, centres[k]], centres[k]
