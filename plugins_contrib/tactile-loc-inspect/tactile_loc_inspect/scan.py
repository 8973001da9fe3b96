"""The scan for differences: a matched filter over several sizes, on the touches pooled in the object's frame.

Each touch is filtered in its image with Gaussian blobs. The height of a blob at a place of the surface is averaged
over all touches that show the place, by their variances. Its ratio to its standard deviation is the statistic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from tactile_loc.plugin.helpers import transform_points

from tactile_loc_inspect.comparison import Bools, Comparison, Floats

SIZES_M = (1.5e-4, 3e-4, 6e-4, 1.2e-3)  # standard deviations of the blobs
WIDTH = 2.355  # full width of a blob at half its height, in standard deviations
VOXEL_M = 2.5e-4  # places are at least about this far apart
FLOOR_M = 3e-6  # error of a blob's height that no averaging reduces
COMMON = 0.7  # part of a reading's noise that is the same all over a blob
ALIKE_M = 3e-4  # a touch shows a place if its surface there is this near to the place
FACING = 0.5  # cosine of the largest angle between the normals of a place in two touches
LEAST_SEEN = 0.3  # share of a blob that must be compared
AGREE = 3.0  # standard deviations by which a touch alone supports a difference


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """The differences at N places of the model's surface that the touches show.

    `points_m` and `normals` (N, 3) are in the object's frame, and `areas_m2` (N,) are the areas that the places stand
    for. For K sizes of blobs, `heights_m` (K, N) are heights along the normal, positive for material that the model
    lacks. Their standard deviations `std_m` (K, N) are infinite where no touch shows such a blob. `support` (K, N)
    counts the touches that alone show the difference, and `against` (K, N) those that alone show the opposite.
    `touches` (N,) counts those that show the place. Of T touches, each presses the place by `pressed_m` (T, N) metres,
    or by -inf if it does not show the place.
    """

    points_m: Floats
    normals: Floats
    areas_m2: Floats
    heights_m: Floats
    std_m: Floats
    support: NDArray[np.int64]
    against: NDArray[np.int64]
    touches: NDArray[np.int64]
    bounds: Bools
    pressed_m: Floats

    @property
    def ratios(self) -> Floats:
        """The statistic (K, N): heights in standard deviations."""
        return self.heights_m / self.std_m


def map_differences(comparisons: Sequence[Comparison], agree: float = AGREE) -> SurfaceMap:
    """Return the map of the differences that several touches show together.

    A touch alone supports a difference of at least `agree` standard deviations.
    """
    places = [_list_places(one) for one in comparisons]
    points, normals, areas = (np.concatenate(parts) for parts in zip(*places, strict=True))
    voxels = np.floor(np.column_stack([points / VOXEL_M, 2 * normals + 0.5])).astype(np.int64)
    _, first, which = np.unique(voxels, axis=0, return_index=True, return_inverse=True)
    area = np.bincount(which.ravel(), areas, len(first))
    points, normals = points[first], normals[first]
    shape = (len(comparisons), len(SIZES_M), len(points))
    heights, variances, bounds = np.zeros(shape), np.full(shape, np.inf), np.zeros(len(points), bool)
    pressed_m = np.full((len(comparisons), len(points)), -np.inf)
    for k, one in enumerate(comparisons):
        rows, columns, shown = _project(one, points, normals)
        for size, sigma_m in enumerate(SIZES_M):
            height, variance = filter_differences(one, sigma_m)
            heights[k, size, shown] = height[rows, columns][shown]
            variances[k, size, shown] = variance[rows, columns][shown]
        pressed_m[k, shown] = one.pressed_m[rows, columns][shown]
        found = one.differences
        bounds[shown] |= (found.missed | found.extra)[rows, columns][shown]
    weights = 1 / variances
    total = np.maximum(weights.sum(axis=0), 1e-30)
    pooled = (heights * weights).sum(axis=0) / total
    std = np.where(np.isfinite(variances).any(axis=0), 1 / np.sqrt(total), np.inf)
    alone = heights * np.sqrt(weights) * np.sign(pooled)
    counted = np.maximum(np.isfinite(variances[:, 1]).sum(axis=0), 1)
    return SurfaceMap(
        points,
        normals,
        area / counted,
        pooled,
        std,
        (alone > agree).sum(axis=0),
        (alone < -agree).sum(axis=0),
        np.isfinite(variances[:, 1]).sum(axis=0),
        bounds,
        pressed_m,
    )


def filter_differences(one: Comparison, sigma_m: float) -> tuple[Floats, Floats]:
    """Return the mean heights (H, W) of blobs with a standard deviation, all metres, and their variances (H, W).

    The height is along the normal. A pixel whose blob is hardly compared has an infinite variance.
    """
    sigma = sigma_m / one.geometry.pixel_pitch_m
    found, cosines = one.differences, np.clip(one.cosines, 0.1, 1)
    shared = (one.edge_std_m**2 + one.pose_std_m**2) * cosines**2  # the error may be the same all over a blob
    weights = found.known / (shared + one.noise_m**2)
    heights = np.where(found.known, found.height_m * cosines, 0)

    def blur(values: Floats, width: float) -> Floats:
        return np.asarray(gaussian_filter(values, width, mode="constant", truncate=3.0))

    total = np.maximum(blur(weights, sigma), 1e-30)
    # the sum of squares of a Gaussian with the sum 1 is 1 / (4 pi sigma^2), with a narrower Gaussian as its shape
    noise = one.noise_m**2 * blur(weights**2, sigma / np.sqrt(2)) / (4 * np.pi * sigma**2) / total**2
    variance = noise + blur(weights * shared, sigma) / total + FLOOR_M**2 + (COMMON * one.noise_m) ** 2
    seen = blur(found.known.astype(float), sigma) > LEAST_SEEN
    return blur(weights * heights, sigma) / total, np.where(seen & found.known, variance, np.inf)


def _list_places(one: Comparison) -> tuple[Floats, Floats, Floats]:
    """Return the compared points (P, 3) and normals (P, 3) of a touch, and the areas (P,) of their pixels, in m^2."""
    known = one.differences.known
    areas = one.geometry.pixel_pitch_m**2 / np.clip(one.cosines, 0.1, 1)
    return one.points_m[known], one.normals[known], areas[known]


def _project(one: Comparison, points_m: Floats, normals: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Bools]:
    """Return the rows and columns (N,) at which a touch shows places (N, 3), and whether it shows them (N,)."""
    geometry, seen = one.geometry, transform_points(one.T, points_m)
    scale = seen[:, 2] if geometry.is_pinhole else np.ones(len(seen))
    columns = np.floor(geometry.fx * seen[:, 0] / scale + geometry.cx).astype(np.int64)
    rows = np.floor(geometry.fy * seen[:, 1] / scale + geometry.cy).astype(np.int64)
    height, width = geometry.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
    near = np.linalg.norm(one.points_m[rows, columns] - points_m, axis=1) < ALIKE_M
    facing = np.einsum("ni,ni->n", one.normals[rows, columns], normals) > FACING
    return rows, columns, inside & near & facing & one.differences.known[rows, columns]
