"""What touches show, as the joint registration takes it."""

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
UNSEEN = 0.1  # what weight it has that nothing is seen: contacts are missed in patches, and edges wander
Floats = NDArray[np.float64]


class Observed(NamedTuple):
    """What N touches show, all in mm and each in its own sensor's frame.

    `points` (P, 3) on the surface in contact with unit `normals` (P, 3), which point into the sensor, and `weights`
    (P,), 1/mm^2, which may be `slack` (P,) off for nothing; those of touch i from starts[i] to starts[i + 1], and
    `centres` (N, 3) their middles. `cameras` (N, 11): pinhole?, fx, fy, cx, cy, the gel's greatest height, its
    rectangle (4), the weight (1/mm^2) of a surface sample that reaches into it. `images` (Q, 4) hold, for every four
    neighbouring pixels, the least height of the surface that is seen (NaN: not observed; negative: it is the gel's,
    nothing touches), below which nothing between their centres can be, and the place x, y, z of the nearest contact;
    those of touch i are rows of sizes[i] (height, width) from offsets[i].
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
    """One touch as it is registered: a contact shape, and the sensor's geometry while it was pressed."""

    shape: ContactShape
    geometry: SensorGeometry


def observe(touches: Sequence[Seen], points: int, noise_m: float, patch_m: float, sample_area_m2: float) -> Observed:
    """Return what touches show, in mm: at most about `points` of each on the surface.

    `noise_m` is the least standard deviation of a measured surface point; noise is alike over patches of `patch_m`
    metres.
    """
    clouds = [_cloud_mm(touch, points, noise_m * MILLI, patch_m * MILLI) for touch in touches]
    P, n, w, slack = (np.concatenate([cloud[k] for cloud in clouds]) for k in range(4))
    weight = UNSEEN * sample_area_m2 / (patch_m * noise_m * MILLI) ** 2
    images = [_image_mm(touch) for touch in touches]
    sizes = np.array([image.shape[:2] for image in images])
    starts = np.cumsum([0, *(len(cloud[0]) for cloud in clouds)])
    middles = np.stack([_middle_mm(t, cloud[0]) for t, cloud in zip(touches, clouds, strict=True)])
    cameras = np.stack([_camera_mm(t, weight) for t in touches])
    pixels = np.concatenate([image.reshape(-1, 4) for image in images])
    offsets = np.cumsum([0, *sizes.prod(axis=1)[:-1]])
    return Observed(P, n, w, slack, starts, middles, cameras, pixels, sizes, offsets)


def _cloud_mm(touch: Seen, most: int, noise_mm: float, patch_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Points (P, 3) in mm and normals (P, 3) of what is in contact, thinned evenly, their weights (P,), 1/mm^2, and by
    how much they may be off for nothing (P,), mm: a wall is somewhere between two pixels.

    They weigh as much together as there are patches that err each for itself.
    """
    points, normals = make_contact_cloud(touch.shape, touch.geometry)
    pitch_mm = touch.geometry.pixel_pitch_m * MILLI
    slack_mm = np.full(len(points), 0.5 * pitch_mm)
    slack_mm[: np.count_nonzero(touch.shape.contact & touch.geometry.observed_mask)] = 0.0  # the surface; then walls
    every = max(1, round(len(points) / most))
    patches = max(FEWEST_PATCHES, len(points) * (pitch_mm / patch_mm) ** 2)
    points, normals, slack_mm = points[::every] * MILLI, normals[::every], slack_mm[::every]
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _middle_mm(touch: Seen, points_mm: Floats) -> Floats:
    """The middle (3,) of the contact, mm; of the gel where thinning left none of it."""
    if len(points_mm):
        return np.asarray(points_mm.mean(axis=0))
    return touch.geometry.gel_middle_m * MILLI


def _image_mm(touch: Seen) -> NDArray[np.float32]:
    """What four neighbouring pixels (H - 1, W - 1, 4) show: the least height, and the nearest contact's place; mm.

    Where none of them shows contact the height is the gel's, and negative.
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
    """The least of every four neighbouring pixels: (H - 1, W - 1) of (H, W)."""
    above, below = heights[:-1], heights[1:]
    return np.minimum(np.minimum(above[:, :-1], above[:, 1:]), np.minimum(below[:, :-1], below[:, 1:]))


def _gel_mm(touch: Seen) -> Floats:
    """How far the surface is at least where nothing touches: z, mm; at each pixel if the gel is curved."""
    return np.asarray((touch.geometry.full_penetration_m + touch.shape.press_depth_m) * MILLI)


def _camera_mm(touch: Seen, weight: float) -> Floats:
    """The row (11,) of `Observed.cameras`."""
    geometry = touch.geometry
    scale = 1.0 if geometry.is_pinhole else 1 / MILLI
    gel_mm = np.max(_gel_mm(touch))
    return np.array([
        geometry.is_pinhole, geometry.fx * scale, geometry.fy * scale, geometry.cx, geometry.cy, gel_mm,
        *np.multiply(geometry.rectangle, MILLI), weight,
    ])  # fmt: skip
