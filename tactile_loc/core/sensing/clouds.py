"""Contact shapes as point clouds with normals, for registration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape

Points = NDArray[np.float64]
OUTLINE_PX = 1.5  # standard deviation, pixels, of the smoothing before an outline's direction is measured
SIDES = ((0, 1), (0, -1), (1, 0), (-1, 0))  # row and column steps to a pixel's neighbours


def make_contact_cloud(shape: ContactShape, geometry: SensorGeometry, walls: bool = True) -> tuple[Points, Points]:
    """Return the surface in contact as points (P, 3), metres, in the sensor frame, and their unit normals (P, 3).

    The normals of the surface point into the sensor (towards -z). With `walls`, the cloud also has points on walls
    along the outline of the contact. A wall stands at each pixel on the outline whose depth is more than a pixel's size
    below the press depth. It leads from the surface to the press depth, and its normals point sideways, out of contact.
    A flat face alone does not determine the object's sideways position; its walls do. The border of the image has no
    walls, because the object continues beyond it. An elastic gel shows no walls, because it slopes down beside them.
    """
    rows, columns = _crop(shape.contact & geometry.observed_mask)
    observed = geometry.observed_mask[rows, columns]
    contact = shape.contact[rows, columns] & observed
    depth = shape.depth_m[rows, columns].astype(float)
    deepest_m = np.broadcast_to(geometry.full_penetration_m, geometry.shape)[rows, columns]
    xyz = _backproject(depth + deepest_m, geometry, rows, columns)
    points, normals = xyz[contact], _estimate_normals(xyz, contact)
    if not walls or geometry.gel.is_elastic:
        return points, normals
    wall_points, wall_normals = _sample_walls(
        xyz, shape.press_depth_m - depth, contact, observed, geometry.pixel_pitch_m
    )
    return np.concatenate([points, wall_points]), np.concatenate([normals, wall_normals])


def make_outline_cloud(shape: ContactShape, geometry: SensorGeometry) -> tuple[Points, Points]:
    """Return the outline of a contact mask on the undeformed gel: points (P, 3), metres, and unit normals (P, 3).

    The object's surface crosses the gel's surface somewhere between a sideways wall and a shallow slope. So the normals
    are halfway between the mask's outward direction and -z. The border of the image is no outline, because the object
    continues beyond it.
    """
    observed, contact = geometry.observed_mask, shape.contact & geometry.observed_mask
    xyz = geometry.backproject(np.broadcast_to(geometry.full_penetration_m + shape.press_depth_m, geometry.shape))
    outwards = _estimate_outline(contact, observed)
    points, normals = [np.empty((0, 3))], [np.empty((0, 3))]
    for rows, columns in SIDES:
        borders = contact & _shift(~contact & observed, rows, columns)
        points.append(xyz[borders] + 0.5 * geometry.pixel_pitch_m * np.array([columns, rows, 0.0]))
        normals.append(outwards[borders] * [1, 1, 0] + [0.0, 0.0, -1.0])
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


def _crop(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns around a mask (H, W), with a margin of three pixels."""
    spans = []
    for axis in (1, 0):
        where = np.flatnonzero(mask.any(axis=axis))
        spans.append(slice(max(0, where[0] - 3), where[-1] + 4) if len(where) else slice(0, 1))
    return spans[0], spans[1]


def _backproject(z_m: Points, geometry: SensorGeometry, rows: slice, columns: slice) -> Points:
    """Return points (h, w, 3), metres, for the z (h, w), metres, of some rows and columns of the image."""
    x, y = geometry.pixel_slopes[0][columns], geometry.pixel_slopes[1][rows]
    k = z_m if geometry.is_pinhole else np.ones_like(z_m)
    return np.stack([x * k, y[:, None] * k, z_m], axis=-1)


def _estimate_normals(xyz: Points, contact: NDArray[np.bool_]) -> Points:
    """Return unit normals (P, 3) of the pixels in contact, from differences between neighbours in contact."""
    down, right = (_differentiate(xyz, contact, axis)[contact] for axis in (0, 1))
    normals = np.cross(down, right)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _differentiate(xyz: Points, contact: NDArray[np.bool_], axis: int) -> Points:
    """Return the mean of the forward and backward differences (H, W, 3) between pixels in contact.

    A pixel without neighbours in contact gets the difference of a flat surface.
    """
    step = np.diff(xyz, axis=axis)
    first, second = [np.take(contact, r, axis) for r in (range(contact.shape[axis] - 1), range(1, contact.shape[axis]))]
    both = (first & second)[..., None]
    total, count = np.zeros_like(xyz), np.zeros((*contact.shape, 1))
    for shift in (slice(None, -1), slice(1, None)):
        where = (shift, slice(None)) if axis == 0 else (slice(None), shift)
        total[where] += np.where(both, step, 0.0)
        count[where] += both
    flat = np.array([0.0, 1e-9, 0.0]) if axis == 0 else np.array([1e-9, 0.0, 0.0])
    return np.where(count > 0, total / np.maximum(count, 1), flat)


def _sample_walls(
    xyz: Points, drop: Points, contact: NDArray[np.bool_], observed: NDArray[np.bool_], pitch: float
) -> tuple[Points, Points]:
    """Return points (P, 3) of walls of height `drop` (h, w), one pixel pitch apart, and outward normals (P, 3)."""
    outside = ~contact & observed
    outwards = _estimate_outline(contact, observed)
    points, normals = [np.empty((0, 3))], [np.empty((0, 3))]
    for rows, columns in SIDES:
        borders = contact & _shift(outside, rows, columns) & (drop > pitch)
        levels = np.floor(drop[borders] / pitch).astype(int)
        which = np.repeat(np.arange(len(levels)), levels)
        level = np.arange(len(which)) - np.repeat(np.cumsum(levels) - levels, levels) + 1
        step = np.column_stack([np.full(len(level), 0.5 * columns), np.full(len(level), 0.5 * rows), level])
        points.append(xyz[borders][which] + pitch * step)
        side = np.array([columns, rows, 0.0])
        directions = outwards[borders]
        # a line of pixels has no outline direction, so its walls face along rows or columns
        leaving = directions @ side[:, None] > 0
        normals.append(np.where(leaving, directions, side)[which])
    return np.concatenate(points), np.concatenate(normals)


def _estimate_outline(contact: NDArray[np.bool_], observed: NDArray[np.bool_]) -> Points:
    """Return unit vectors (H, W, 3) that point across the outline, out of contact.

    They point down the slope of the smoothed contact mask. Smoothing removes the pixel steps of an oblique edge.
    Unobserved pixels count as half in contact.
    """
    from scipy.ndimage import gaussian_filter

    mask = np.where(observed, contact, 0.5)
    across, down = (-gaussian_filter(mask, OUTLINE_PX, order=o, mode="nearest", truncate=2.5) for o in ((0, 1), (1, 0)))
    slope = np.stack([across, down, np.zeros_like(mask)], axis=-1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    return slope / np.where(length > 0, length, 1.0)


def _shift(mask: NDArray[np.bool_], rows: int, columns: int) -> NDArray[np.bool_]:
    """Return each pixel's neighbour in the mask (H, W), `rows` down and `columns` right; False beyond the image."""
    padded = np.pad(mask, 1)
    return padded[1 + rows : padded.shape[0] - 1 + rows, 1 + columns : padded.shape[1] - 1 + columns]
