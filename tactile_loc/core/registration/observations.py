"""The observations of touches, in the form that the joint registration uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.clouds import make_contact_cloud
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape

MILLI = 1e3
FEWEST_PATCHES = 3.0
UNSEEN = 0.1  # weight of pixels without contact: contacts are missed in patches, and edges are inexact
Floats = NDArray[np.float64]


class Observed(NamedTuple):
    """The observations of N touches, all in mm, each in its own sensor's frame.

    `points` (P, 3) are on the surface in contact, with unit `normals` (P, 3) that point into the sensor, `weights`
    (P,), 1/mm^2, and `slack` (P,), the misfit that costs nothing. Those of touch i are from starts[i] to
    starts[i + 1], with middles `centres` (N, 3). `cameras` (N, 11) have: pinhole?, fx, fy, cx, cy, the gel's greatest
    height, its rectangle (4), the weight (1/mm^2) of a surface sample that reaches into it. `images` (Q, 4) hold, for
    every four neighbouring pixels, the least height seen, below which nothing can be between their centres (NaN: not
    observed; negative: the gel's, without contact), and x, y, z of the nearest contact. Those of touch i are rows of
    sizes[i] (height, width) from offsets[i].
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weights: NDArray[np.float64]
    slack: NDArray[np.float64]
    starts: NDArray[np.int64]
    centres: NDArray[np.float64]
    cameras: NDArray[np.float64]
    images: NDArray[np.float32]
    sizes: NDArray[np.int64]
    offsets: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Seen:
    """One touch to register: a contact shape, and the sensor's geometry while it was pressed."""

    shape: ContactShape
    geometry: SensorGeometry


def observe(touches: Sequence[Seen], points: int, noise_m: float, patch_m: float, sample_area_m2: float) -> Observed:
    """Return the observations of touches, in mm, with at most about `points` surface points each.

    `noise_m` is the least standard deviation of a measured surface point; errors are alike over patches of `patch_m`
    metres.
    """
    clouds = [_cloud_mm(touch, points, noise_m * MILLI, patch_m * MILLI) for touch in touches]
    P, n, w, slack = (np.concatenate([cloud[k] for cloud in clouds]) for k in range(4))
    weight = UNSEEN * sample_area_m2 / (patch_m * noise_m * MILLI) ** 2
    images = [_image_mm(touch) for touch in touches]
    sizes = np.array([image.shape[:2] for image in images])
    starts = np.cumsum([0, *(len(cloud[0]) for cloud in clouds)])
    middles = np.stack([
        cloud[0].mean(axis=0) if len(cloud[0]) else touch.geometry.gel_middle_m * MILLI  # may be empty
        for touch, cloud in zip(touches, clouds, strict=True)
    ])  # fmt: skip
    cameras = np.stack([_camera_mm(t, weight) for t in touches])
    pixels = np.concatenate([image.reshape(-1, 4) for image in images])
    offsets = np.cumsum([0, *sizes.prod(axis=1)[:-1]])
    return Observed(P, n, w, slack, starts, middles, cameras, pixels, sizes, offsets)


def _cloud_mm(touch: Seen, most: int, noise_mm: float, patch_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return evenly chosen contact points (P, 3), mm, their normals (P, 3), weights (P,), 1/mm^2, and slack (P,), mm.

    Walls have slack, because they lie somewhere between two pixels. The total weight is that of as many points as there
    are patches with independent errors.
    """
    points, normals = make_contact_cloud(touch.shape, touch.geometry)
    pitch_mm = touch.geometry.pixel_pitch_m * MILLI
    slack_mm = np.full(len(points), 0.5 * pitch_mm)
    slack_mm[: np.count_nonzero(touch.shape.contact & touch.geometry.observed_mask)] = 0.0  # the surface; then walls
    every = max(1, round(len(points) / most))
    patches = max(FEWEST_PATCHES, len(points) * (pitch_mm / patch_mm) ** 2)
    points, normals, slack_mm = points[::every] * MILLI, normals[::every], slack_mm[::every]
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _image_mm(touch: Seen) -> NDArray[np.float32]:
    """Return the least height and the nearest contact's place, mm, of each four neighbouring pixels: (H - 1, W - 1, 4).

    If none of the four shows contact, the height is the gel's, negated.
    """
    from scipy.ndimage import distance_transform_edt

    geometry = touch.geometry
    contact = touch.shape.contact & geometry.observed_mask
    z_m = touch.shape.depth_m + geometry.full_penetration_m
    rows, columns = distance_transform_edt(~contact, return_distances=False, return_indices=True)[:, :-1, :-1]
    gel_mm = _gel_mm(touch)
    lowest_mm = _least_of_four(gel_mm) if gel_mm.ndim else gel_mm
    touched = _least_of_four(np.where(geometry.observed_mask, np.where(contact, z_m * MILLI, np.inf), np.nan))
    image = np.empty((*rows.shape, 4), np.float32)
    image[..., 0] = np.where(np.isinf(touched), -lowest_mm, touched)
    image[..., 1:] = (geometry.backproject(z_m) * MILLI)[rows, columns]
    return image


def _least_of_four(heights: Floats) -> Floats:
    """Return the least of every four neighbouring pixels: (H - 1, W - 1) of (H, W)."""
    above, below = heights[:-1], heights[1:]
    return np.minimum(np.minimum(above[:, :-1], above[:, 1:]), np.minimum(below[:, :-1], below[:, 1:]))


def _gel_mm(touch: Seen) -> Floats:
    """Return the gel's undeformed z, mm, a lower bound of the surface without contact; per pixel for a curved gel."""
    return np.asarray((touch.geometry.full_penetration_m + touch.shape.press_depth_m) * MILLI)


def _camera_mm(touch: Seen, weight: float) -> Floats:
    """Return the row (11,) of `Observed.cameras`."""
    geometry = touch.geometry
    scale = 1.0 if geometry.is_pinhole else 1 / MILLI
    gel_mm = np.max(_gel_mm(touch))
    return np.array([
        geometry.is_pinhole, geometry.fx * scale, geometry.fy * scale, geometry.cx, geometry.cy, gel_mm,
        *np.multiply(geometry.rectangle, MILLI), weight,
    ])  # fmt: skip
