"""What touch noise is made of: blurs, random fields and round patches on the sensing surface, in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing import SensorGeometry

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Index = NDArray[np.intp]

FAINTEST = 0.2  # of the least imprint that shows: the wandering threshold never falls below
REACH = 4.0  # standard deviations of a Gaussian that count


class Centres(NamedTuple):
    """Points (P,) of a batch: the image that each is in, and where in it, x and y in metres."""

    image: Index
    x_m: Float64
    y_m: Float64


@dataclass(frozen=True, eq=False)
class Gel:
    """The pixels on the sensing rectangle: their `rows` and `columns` in the image, and where their centres are.

    `x_m` (W,) and `y_m` (H,) on the undeformed surface, `pitch_m` from pixel to pixel, `rectangle_m` the rectangle; m.
    """

    rows: slice
    columns: slice
    x_m: Float64
    y_m: Float64
    pitch_m: tuple[float, float]
    rectangle_m: tuple[float, float, float, float]

    @classmethod
    def of(cls, geometry: SensorGeometry) -> Gel:
        """Find the pixels whose view of the undeformed surface lies on the sensing rectangle."""
        sx, sy = geometry.scale_at_surface
        x = (np.arange(geometry.width_px, dtype=np.float64) + 0.5 - geometry.cx) / sx
        y = (np.arange(geometry.height_px, dtype=np.float64) + 0.5 - geometry.cy) / sy
        x0, x1, y0, y1 = geometry.rectangle
        columns = slice(*np.searchsorted(x, [x0, np.nextafter(x1, np.inf)]).tolist())
        rows = slice(*np.searchsorted(y, [y0, np.nextafter(y1, np.inf)]).tolist())
        return cls(rows, columns, x[columns], y[rows], (1 / sx, 1 / sy), geometry.rectangle)

    def blurred(self, images: Float32, sigma_m: float) -> Float32:
        """Blur images (N, H, W) by a Gaussian of `sigma_m` metres; beyond the rectangle their border goes on.

        Pixels are squares: a step between two of them becomes the Gaussian's error function exactly, however large they
        are.
        """
        x, y = (_blur_weights(len(a), sigma_m / p) for a, p in zip((self.x_m, self.y_m), self.pitch_m, strict=True))
        return _transformed(images, y, x)

    def random_field(self, count: int, patch_m: float, rng: np.random.Generator) -> Float32:
        """Draw smooth random images (count, H, W) of zero mean and unit variance everywhere, unitless.

        White noise on a lattice of `patch_m` metres, blurred by a Gaussian of the same standard deviation: the lattice
        is the surface's, so that one seed gives one field, whatever the pixels.
        """
        x0, x1, y0, y1 = self.rectangle_m
        x, y = _field_weights(self.x_m, x0, x1, patch_m), _field_weights(self.y_m, y0, y1, patch_m)
        white = rng.standard_normal((count, y.shape[1], x.shape[1]), dtype=np.float32)
        return _transformed(white, y, x)

    def border(self, width_m: Float64, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Mark (N, H, W) a strip along one random side of each image's rectangle, of widths (N,) in metres."""
        x0, x1, y0, y1 = self.rectangle_m
        side = rng.integers(4, size=len(width_m))
        left, right, top, bottom = (np.where(side == k, width_m, -np.inf)[:, None] for k in range(4))
        columns = (self.x_m - x0 < left) | (x1 - self.x_m < right)
        rows = (self.y_m - y0 < top) | (y1 - self.y_m < bottom)
        return columns[:, None, :] | rows[:, :, None]

    def random_points(self, counts: Index, rng: np.random.Generator) -> Centres:
        """Draw so many (N,) points of each image, uniformly on the rectangle."""
        x0, x1, y0, y1 = self.rectangle_m
        image = np.repeat(np.arange(len(counts)), counts)
        return Centres(image, rng.uniform(x0, x1, len(image)), rng.uniform(y0, y1, len(image)))

    def random_pixels(self, marked: NDArray[np.bool_], counts: Index, rng: np.random.Generator) -> Centres:
        """Draw so many (N,) pixels of those marked (N, H, W) in each image, with replacement; none where none is."""
        held = np.count_nonzero(marked, axis=(1, 2))
        image = np.repeat(np.arange(len(counts)), np.where(held > 0, counts, 0))
        nth = (np.cumsum(held) - held)[image] + (rng.random(len(image)) * held[image]).astype(np.intp)
        image, row, column = np.unravel_index(np.flatnonzero(marked)[nth], marked.shape)
        return Centres(image, self.x_m[column], self.y_m[row])


def stamp(
    depth: Float32,
    gel: Gel,
    centres: Centres,
    radius_m: Float64,
    value_m: NDArray[np.floating[Any]],
    combine: Callable[..., Any],
) -> None:
    """Write discs of radii (P,) about `centres` into depths (N, H, W): `combine` (a ufunc) of old and value (P,). m."""
    left, right = _interval(gel.x_m, centres.x_m, radius_m)
    top, bottom = _interval(gel.y_m, centres.y_m, radius_m)
    for i, image in enumerate(centres.image):
        rows, columns = slice(top[i], bottom[i]), slice(left[i], right[i])
        dx, dy = gel.x_m[columns] - centres.x_m[i], gel.y_m[rows] - centres.y_m[i]
        inside = (dy * dy)[:, None] + dx * dx < radius_m[i] ** 2
        block = depth[image, rows, columns]
        combine(block, np.float32(value_m[i]), out=block, where=inside)


def _interval(pixels_m: Float64, centre_m: Float64, radius_m: Float64) -> tuple[Index, Index]:
    """First and last-but-one index of the sorted pixels (W,) within radii (P,) of centres (P,), metres."""
    return np.searchsorted(pixels_m, centre_m - radius_m), np.searchsorted(pixels_m, centre_m + radius_m)


def _transformed(images: Float32, rows: Float32, columns: Float32) -> Float32:
    """Apply matrices (H, h) to the rows and (W, w) to the columns of images (N, h, w): (N, H, W)."""
    result: Float32 = rows @ (images @ columns.T)
    return result


def _blur_weights(count: int, sigma_px: float) -> Float32:
    """Weights (count, count) of pixel j's area in the Gaussian about pixel i's centre; the outer pixels go on forever.

    Beyond `REACH` the Gaussian is cut off, so that an imprint has an end.
    """
    from scipy.special import ndtr

    centre = np.arange(count) + 0.5
    edge = np.concatenate([[-np.inf], np.arange(1.0, count), [np.inf]])
    z = (edge[None] - centre[:, None]) / sigma_px
    share = np.where(z < -REACH, 0.0, np.where(z > REACH, 1.0, ndtr(z)))
    weights: Float32 = np.diff(share, axis=1).astype(np.float32)
    return weights


def _field_weights(pixels_m: Float64, low_m: float, high_m: float, patch_m: float) -> Float32:
    """Weights (W, K) of the lattice's K points at each pixel; their squares sum to one, so that variance is one."""
    margin = int(REACH)
    lattice_m = low_m + patch_m * np.arange(-margin, np.ceil((high_m - low_m) / patch_m) + margin + 1)
    z = (pixels_m[:, None] - lattice_m) / patch_m
    weights = np.where(np.abs(z) < REACH, np.exp(-0.5 * z**2), 0.0)  # tiny numbers would be slow ones
    normalised: Float32 = (weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32)
    return normalised
