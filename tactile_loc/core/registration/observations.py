"""The observations of touches, in the form that the joint registration uses."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats, Ints
from tactile_loc.core.sensing.clouds import (
    find_nearest_contact,
    make_contact_cloud,
    make_interior_cloud,
    make_outline_cloud,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch

MILLI = 1e3
FEWEST_PATCHES = 3.0
UNSEEN = 0.1  # weight of missing contact relative to contact; low, because sensors miss contact and blur edges
_Cloud = tuple[Floats, Floats, Floats, Floats]


class Observed(NamedTuple):
    """The observations of N touches, all in mm, each in its own sensor's frame.

    `points` (P, 3) are on the surface in contact. Their unit `normals` (P, 3) point into the sensor. `weights` (P,) are
    in 1/mm^2. `slack` (P,) is the distance to the surface that costs nothing. The points of touch i are those from
    starts[i] to starts[i + 1], and their middle is centres[i].

    A row of `cameras` (N, 11) has these numbers:

    - 1 for a pinhole camera, else 0;
    - fx, fy, cx and cy;
    - the greatest z of the gel;
    - the four numbers of the sensing rectangle;
    - the weight, 1/mm^2, of a surface sample that reaches into the gel.

    A row of `images` (Q, 3) describes a square of four neighbouring pixels. Its first number is the least z in the
    square: nothing between the pixels' centres is nearer to the camera. The number is NaN if a pixel is not observed.
    Without contact, it is the z of the gel, negated. The other two numbers are x and y of the nearest contact; inf if
    nothing is in contact. Touch i has sizes[i] (height, width) squares, in the rows from offsets[i].
    """

    points: Floats
    normals: Floats
    weights: Floats
    slack: Floats
    starts: Ints
    centres: Floats
    cameras: Floats
    images: Float32
    sizes: Ints
    offsets: Ints


def observe(
    touches: Sequence[Touch], pixels: int, points: int, noise_m: float, patch_m: float, sample_area_m2: float
) -> Observed:
    """Return the observations of touches, in mm, with at most about `points` surface points each.

    Images have about `pixels` pixels on the longer side. `noise_m`, metres, is the least standard deviation of a
    measured surface point. Points share their errors over patches of `patch_m` metres. `sample_area_m2` is the area of
    the object's surface for each of its samples.
    """
    each = [_observe_one(touch, pixels, points, noise_m, patch_m, sample_area_m2) for touch in touches]
    P, n, w, slack = (np.concatenate([one.cloud[k] for one in each]) for k in range(4))
    sizes = np.array([one.image.shape[:2] for one in each])
    starts = np.cumsum([0, *(len(one.cloud[0]) for one in each)])
    images = np.concatenate([one.image.reshape(-1, 3) for one in each])
    offsets = np.cumsum([0, *sizes.prod(axis=1)[:-1]])
    cameras, middles = np.stack([one.camera for one in each]), np.stack([one.middle for one in each])
    return Observed(P, n, w, slack, starts, middles, cameras, images, sizes, offsets)


class _ObservedOne(NamedTuple):
    """The observation of one touch: points, normals, weights and slack, an image, a camera and the points' middle."""

    cloud: _Cloud
    image: Float32
    camera: Floats
    middle: Floats


@lru_cache(maxsize=32)  # a touch is observed for the search, for the refinement and for covariances
def _observe_one(
    touch: Touch, pixels: int, points: int, noise_m: float, patch_m: float, sample_area_m2: float
) -> _ObservedOne:
    """Return the observation of one touch: see `observe`.

    The object touches the gel at the contact of the thinned shape, and is nowhere nearer to the camera than the thinned
    surface. A rigid gel touches wherever it is pressed, so both are the same.
    """
    geometry, shape = touch.thin(pixels)
    surface = touch.thin_surface(pixels)
    make_cloud = _cloud_mm if shape.depths_known else _mask_cloud_mm
    cloud = make_cloud(shape, geometry, points, noise_m * MILLI, patch_m * MILLI)
    # out of contact, no surface is nearer to the camera than this
    gel_mm = np.asarray((geometry.full_penetration_m + surface.press_depth_m) * MILLI)
    scale = 1.0 if geometry.is_pinhole else 1 / MILLI
    rays = geometry.is_pinhole, geometry.fx * scale, geometry.fy * scale, geometry.cx, geometry.cy
    weight = UNSEEN * sample_area_m2 / (patch_m * noise_m * MILLI) ** 2
    camera = np.array([*rays, np.max(gel_mm), *np.multiply(geometry.rectangle, MILLI), weight])
    middle = cloud[0].mean(axis=0) if len(cloud[0]) else geometry.gel_middle_m * MILLI  # it can have no points
    return _ObservedOne(cloud, _image_mm(surface, geometry, gel_mm), camera, middle)


def _cloud_mm(shape: ContactShape, geometry: SensorGeometry, most: int, noise_mm: float, patch_mm: float) -> _Cloud:
    """Return evenly chosen contact points (P, 3), mm, their normals (P, 3), weights (P,), 1/mm^2, and slack (P,), mm.

    Points on walls have slack, because a wall lies somewhere between two pixels. All points of a patch share their
    errors, so together they have the weight of one independent point.
    """
    points, normals = make_contact_cloud(shape, geometry)
    pitch_mm = geometry.pixel_pitch_m * MILLI
    slack_mm = np.full(len(points), 0.5 * pitch_mm)
    slack_mm[: np.count_nonzero(shape.contact & geometry.observed_mask)] = 0.0  # walls come last
    every = max(1, round(len(points) / most))
    patches = max(FEWEST_PATCHES, len(points) * (pitch_mm / patch_mm) ** 2)
    points, normals, slack_mm = points[::every] * MILLI, normals[::every], slack_mm[::every]
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _mask_cloud_mm(
    shape: ContactShape, geometry: SensorGeometry, most: int, noise_mm: float, patch_mm: float
) -> _Cloud:
    """Return what `_cloud_mm` returns, for a contact mask: up to half of the points on the outline, others inside it.

    The slack of points inside covers all depths of contact. The weights are those of a touch whose depths are known.
    """
    inside, inwards, slack_m = make_interior_cloud(shape, geometry)
    outline, outwards = make_outline_cloud(shape, geometry)
    pitch_mm = geometry.pixel_pitch_m * MILLI
    patches = max(FEWEST_PATCHES, (len(inside) + len(outline)) * (pitch_mm / patch_mm) ** 2)
    some, few = (max(1, round(2 * len(cloud) / most)) for cloud in (outline, inside))
    points = np.concatenate([outline[::some], inside[::few]]) * MILLI
    normals = np.concatenate([outwards[::some], inwards[::few]])
    slack_mm = np.repeat([0.5 * pitch_mm, slack_m * MILLI], [len(outline[::some]), len(inside[::few])])
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _image_mm(surface: ContactShape, geometry: SensorGeometry, gel_mm: Floats) -> Float32:
    """Return the rows of `Observed.images` for one touch, as an image (H - 1, W - 1, 3), mm.

    `gel_mm` is the z, mm, of the undeformed gel, one number or (H, W).
    """
    contact = surface.contact & geometry.observed_mask
    z_m = np.asarray(surface.depth_m + geometry.full_penetration_m, float)
    if surface.press_slack_m:
        z_m = z_m - surface.press_slack_m * contact
    image = np.full((geometry.height_px - 1, geometry.width_px - 1, 3), np.inf, np.float32)
    lowest = _find_least(np.where(contact, (z_m * MILLI).astype(np.float32), np.float32(np.inf)))
    free = _find_least(np.broadcast_to(gel_mm, geometry.shape))
    known = _find_least(geometry.observed_mask)
    image[..., 0] = np.where(known, np.where(lowest < np.inf, lowest, -free), np.nan)
    if contact.any():
        rows, columns = (nearest[:-1, :-1] for nearest in find_nearest_contact(contact))
        k, (x, y) = z_m[rows, columns] if geometry.is_pinhole else 1.0, geometry.pixel_slopes
        image[..., 1:] = np.stack([x[columns] * k, y[rows] * k], axis=-1) * MILLI
    return image


def _find_least(values: NDArray[Any]) -> NDArray[Any]:
    """Return the least value (H - 1, W - 1) of each square of four neighbouring pixels of an image (H, W)."""
    rows = np.minimum(values[:-1], values[1:])
    return np.asarray(np.minimum(rows[:, :-1], rows[:, 1:]))
