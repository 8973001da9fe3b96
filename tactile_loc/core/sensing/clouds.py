"""Contact shapes as point clouds with normals, for registration."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape

Points = NDArray[np.float64]
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
    from tactile_loc.core.sensing.cloud_kernels import make_cloud  # numba takes a while to import

    observed, depth_m = geometry.observed_mask, np.ascontiguousarray(shape.depth_m, float)
    points, normals = make_cloud(
        depth_m + geometry.full_penetration_m, shape.press_depth_m - depth_m,
        np.ascontiguousarray(shape.contact & observed), observed, *geometry.pixel_slopes, geometry.is_pinhole,
        geometry.pixel_pitch_m, walls and not geometry.gel.is_elastic, *_list_outline_weights(),
    )  # fmt: skip
    return points, normals


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


def _estimate_outline(contact: NDArray[np.bool_], observed: NDArray[np.bool_]) -> Points:
    """Return unit vectors (H, W, 2), x and y, that point across the outline, out of contact; 0 out of contact.

    They point down the slope of the smoothed contact mask. Smoothing removes the pixel steps of an oblique edge.
    Unobserved pixels count as half in contact.
    """
    from tactile_loc.core.sensing.cloud_kernels import fill_outline  # numba takes a while to import

    directions = np.zeros((*contact.shape, 2))
    fill_outline(contact, observed, *_list_outline_weights(), directions)
    return directions


@cache
def _list_outline_weights() -> tuple[Points, Points]:
    """Return the weights (2 r + 1,) of a Gaussian with the standard deviation OUTLINE_PX, and of its derivative."""
    steps = np.arange(-OUTLINE_REACH_PX, OUTLINE_REACH_PX + 1)
    smooth = np.exp(-0.5 / OUTLINE_PX**2 * steps**2)
    smooth /= smooth.sum()
    return smooth, steps * (1 / OUTLINE_PX**2) * smooth


def _shift(mask: NDArray[np.bool_], rows: int, columns: int) -> NDArray[np.bool_]:
    """Return each pixel's neighbour in the mask (H, W), `rows` down and `columns` right; False beyond the image."""
    padded = np.pad(mask, 1)
    return padded[1 + rows : padded.shape[0] - 1 + rows, 1 + columns : padded.shape[1] - 1 + columns]
