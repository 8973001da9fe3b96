"""The observations of touches, in the form that the joint registration uses."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.compiled import njit
from tactile_loc.core.sensing.clouds import make_contact_cloud, make_interior_cloud, make_outline_cloud
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch

MILLI = 1e3
FEWEST_PATCHES = 3.0
UNSEEN = 0.1  # weight of missing contact relative to contact; low, because sensors miss contact and blur edges
Floats = NDArray[np.float64]


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

    A row of `images` (Q, 4) describes a square of four neighbouring pixels. Its first number is the least z in the
    square: nothing between the pixels' centres is nearer to the camera. The number is NaN if a pixel is not observed.
    Without contact, it is the z of the gel, negated. The other three numbers are x, y, z of the nearest contact; inf if
    nothing is in contact. Touch i has sizes[i] (height, width) squares, in the rows from offsets[i].
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
    """One touch to register, in the geometry of the pressed sensor.

    The object touches the gel at the contact of `shape`, and is nowhere nearer to the camera than the gel's `surface`.
    A rigid gel touches wherever it is pressed, so both are the same.
    """

    shape: ContactShape
    surface: ContactShape
    geometry: SensorGeometry

    @classmethod
    def of(cls, touch: Touch, pixels: int) -> Seen:
        """Return a touch with about `pixels` pixels on the longer side."""
        geometry, shape = touch.thin(pixels)
        return cls(shape, touch.thin_surface(pixels), geometry)


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
    images = np.concatenate([one.image.reshape(-1, 4) for one in each])
    offsets = np.cumsum([0, *sizes.prod(axis=1)[:-1]])
    cameras, middles = np.stack([one.camera for one in each]), np.stack([one.middle for one in each])
    return Observed(P, n, w, slack, starts, middles, cameras, images, sizes, offsets)


class _ObservedOne(NamedTuple):
    """The observation of one touch: points, normals, weights and slack, an image, a camera and the points' middle."""

    cloud: tuple[Floats, Floats, Floats, Floats]
    image: NDArray[np.float32]
    camera: Floats
    middle: Floats


@lru_cache(maxsize=32)  # a touch is observed for the search, for the refinement and for covariances
def _observe_one(
    touch: Touch, pixels: int, points: int, noise_m: float, patch_m: float, sample_area_m2: float
) -> _ObservedOne:
    """Return the observation of one touch: see `observe`."""
    seen = Seen.of(touch, pixels)
    cloud = _cloud_mm(seen, points, noise_m * MILLI, patch_m * MILLI)
    camera = _camera_mm(seen, UNSEEN * sample_area_m2 / (patch_m * noise_m * MILLI) ** 2)
    middle = cloud[0].mean(axis=0) if len(cloud[0]) else seen.geometry.gel_middle_m * MILLI  # it can have no points
    return _ObservedOne(cloud, _image_mm(seen), camera, middle)


def _cloud_mm(touch: Seen, most: int, noise_mm: float, patch_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return evenly chosen contact points (P, 3), mm, their normals (P, 3), weights (P,), 1/mm^2, and slack (P,), mm.

    Points on walls have slack, because a wall lies somewhere between two pixels. All points of a patch share their
    errors, so together they have the weight of one independent point.
    """
    if not touch.shape.depths_known:
        return _mask_cloud_mm(touch, most, noise_mm, patch_mm)
    points, normals = make_contact_cloud(touch.shape, touch.geometry)
    pitch_mm = touch.geometry.pixel_pitch_m * MILLI
    slack_mm = np.full(len(points), 0.5 * pitch_mm)
    slack_mm[: np.count_nonzero(touch.shape.contact & touch.geometry.observed_mask)] = 0.0  # walls come last
    every = max(1, round(len(points) / most))
    patches = max(FEWEST_PATCHES, len(points) * (pitch_mm / patch_mm) ** 2)
    points, normals, slack_mm = points[::every] * MILLI, normals[::every], slack_mm[::every]
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _mask_cloud_mm(touch: Seen, most: int, noise_mm: float, patch_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return what `_cloud_mm` returns, for a contact mask: up to half of the points on the outline, others inside it.

    The slack of points inside covers all depths of contact. The weights are those of a touch whose depths are known.
    """
    inside, inwards, slack_m = make_interior_cloud(touch.shape, touch.geometry)
    outline, outwards = make_outline_cloud(touch.shape, touch.geometry)
    pitch_mm = touch.geometry.pixel_pitch_m * MILLI
    patches = max(FEWEST_PATCHES, (len(inside) + len(outline)) * (pitch_mm / patch_mm) ** 2)
    some, few = (max(1, round(2 * len(cloud) / most)) for cloud in (outline, inside))
    points = np.concatenate([outline[::some], inside[::few]]) * MILLI
    normals = np.concatenate([outwards[::some], inwards[::few]])
    slack_mm = np.repeat([0.5 * pitch_mm, slack_m * MILLI], [len(outline[::some]), len(inside[::few])])
    return points, normals, np.full(len(points), patches / max(len(points), 1) / noise_mm**2), slack_mm


def _image_mm(touch: Seen) -> NDArray[np.float32]:
    """Return the rows of `Observed.images` for one touch, as an image (H - 1, W - 1, 4), mm."""
    geometry = touch.geometry
    contact = touch.surface.contact & geometry.observed_mask
    z_m = touch.surface.depth_m + geometry.full_penetration_m
    if touch.surface.press_slack_m:
        z_m = z_m - touch.surface.press_slack_m * contact
    image = np.empty((geometry.height_px - 1, geometry.width_px - 1, 4), np.float32)
    gel_mm = np.broadcast_to(_gel_mm(touch), geometry.shape)
    arrays = ((z_m, float), (z_m * MILLI, np.float32), (gel_mm, float), (contact, bool), (geometry.observed_mask, bool))
    surface = tuple(np.ascontiguousarray(array, kind) for array, kind in arrays)
    fill_image(surface, (*geometry.pixel_slopes, geometry.is_pinhole), image)
    return image


def _gel_mm(touch: Seen) -> Floats:
    """Return the z, mm, at the press depth: surface out of contact is not nearer to the camera. (H, W) if curved."""
    return np.asarray((touch.geometry.full_penetration_m + touch.surface.press_depth_m) * MILLI)


def _camera_mm(touch: Seen, weight: float) -> Floats:
    """Return the row (11,) of `Observed.cameras`."""
    geometry = touch.geometry
    scale = 1.0 if geometry.is_pinhole else 1 / MILLI
    gel_mm = np.max(_gel_mm(touch))
    rays = geometry.is_pinhole, geometry.fx * scale, geometry.fy * scale, geometry.cx, geometry.cy
    return np.array([*rays, gel_mm, *np.multiply(geometry.rectangle, MILLI), weight])


@njit
def fill_image(surface, rays, image):
    """Fill `image` (H - 1, W - 1, 4) with the rows of `Observed.images`, from the surface that one touch shows.

    `surface` has arrays (H, W): the surface's z in metres and in mm, the z of the gel at the press depth, mm, and masks
    of contact and of observed pixels. `rays` has the slopes (W,) and (H,) of `SensorGeometry.pixel_slopes`, and whether
    the camera is a pinhole.
    """
    z, heights, gel, contact, observed = surface
    x_slopes, y_slopes, pinhole = rays
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
            image[row, column, 1] = x_slopes[j] * k * MILLI
            image[row, column, 2] = y_slopes[i] * k * MILLI
            image[row, column, 3] = z[i, j] * MILLI


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
