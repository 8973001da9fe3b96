"""Dark marker dots on a gel: finds them in images, and fills them in from the pixels around them.

Many gels carry a lattice of dots, which show how the gel is sheared. They hide the colours that show the slope. The
dots are found in the image of the untouched gel. A touch moves the surface and its dots, so the dots are found again in
each image of a touch. Under the dots, the colour's difference from the untouched gel is continued from the pixels
around them, as a thin plate would be.

The origin of pixel coordinates is the image's upper left corner, so the first pixel's centre is (0.5, 0.5). The shade
of a pixel is the negative logarithm of its brightness. A dot adds about the same shade everywhere on the gel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy.ndimage import binary_dilation, gaussian_filter, gaussian_laplace, maximum_filter
from scipy.optimize import linear_sum_assignment
from scipy.sparse import diags_array, eye_array, kron
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.reading import reduce_image

OFFSET = 8.0  # counts that are added before the logarithm, against noise in black corners
DISC = np.e / 2  # shade of a disc, divided by the largest answer of the filters to the disc
FINEST_PX, COARSEST, SCALES = 0.8, 1 / 30, 14  # finest filter, coarsest filter (share of the longer side), and number
LEAST_DEPTH = 0.15  # least shade of a dot
ALIKE = 0.5  # least shade of a dot, share of the usual dot's
FAINT = 0.3  # least shade of a dot at an expected place or in a touch, share of the usual dot's
FEWEST = 12  # fewest dots of a lattice
EVEN, ASIDE = 0.3, 0.25  # largest errors of a distance between neighbours and of a neighbour's place, in spacings
REGULAR = 0.75  # least share of dots that are evenly spaced, and of dots with a neighbour on the opposite side
SPREAD = 0.3  # least share of the image that the lattice fills
OVERLAP = 0.6  # least distance of neighbours, in spacings
TAIL = 0.1  # shade at a dot's border, share of the shade in its middle
REACH = 0.6  # farthest move of a dot in a touch, in spacings
STRETCH, ROUNDS = 1.8, 2  # largest stretch of a dot, and number of times that its stretched parts are searched
DARKER, NOISE = 0.03, 0.02  # least shade of a dot's stretched parts: share of the usual dot's, and above the noise
MOST_COVERED = 0.55  # largest share of the image that dots may cover
MOST_PX = 400  # longer side of the images in which dots are found; larger images are reduced


@dataclass(frozen=True, eq=False)
class Dots:
    """The dots in an image (H, W) of the untouched gel.

    `centres_px` (N, 2) are the x and y of the dots, pixels. `radius_px` is the radius of the area that a dot darkens.
    `spacing_px` is the distance between neighbours. `depth` is the shade of a dot. `sigma_px` is the width of the
    filter that finds the dots.
    """

    shape: tuple[int, int]
    centres_px: Floats
    radius_px: float
    spacing_px: float
    depth: float
    sigma_px: float

    def __len__(self) -> int:
        return len(self.centres_px)


@dataclass(frozen=True, eq=False)
class UntouchedGel:
    """An image (H, W, 3) of the untouched gel with its `dots`, and the same image without dots (`clear`).

    `dots` is None if there are no dots. Dots are found in the image reduced to the size of `small` (h, w, 3), which
    shows the gel without dots. `hidden` (h, w) marks the pixels that dots darken.
    """

    image: Image
    clear: Image
    small: Image
    dots: Dots | None = None
    hidden: Bools | None = None

    @classmethod
    def of(cls, image: Image) -> UntouchedGel:
        """Find the dots in an image (H, W, 3) of the untouched gel, and fill them in.

        Raises CalibrationError when the dots cover more than MOST_COVERED of the image.
        """
        times = math.ceil(max(image.shape) / MOST_PX)
        reduced = reduce_image(image, (round(image.shape[0] / times), round(image.shape[1] / times)))
        dots = find_dots(reduced)
        if dots is None:
            return cls(image, image, reduced)
        hidden = mark_dots(reduced, dots, widen=times > 1)
        if (covered := float(hidden.mean())) > MOST_COVERED:
            raise CalibrationError(
                f"{len(dots)} marker dots cover {100 * covered:.0f} % of the untouched gel's image, but at most "
                f"{100 * MOST_COVERED:.0f} % can be filled in; use a gel with fewer or smaller dots"
            )
        gel = continue_values(reduced.astype(np.float32), hidden)
        clear = np.where(_enlarge(hidden, image), _convert(_enlarge(gel, image)), image)
        return cls(image, clear, _convert(gel), dots, hidden)

    @property
    def covered(self) -> float:
        """The share of the image that dots cover."""
        return 0.0 if self.hidden is None else float(self.hidden.mean())

    def clear_image(self, image: Image) -> Image:
        """Return an image (H, W, 3) of the touched gel with its dots filled in; the same image if the gel has none."""
        if self.dots is None:
            return image
        reduced = reduce_image(image, self.dots.shape)
        hidden = mark_dots(reduced, self.dots, widen=image.shape[1] >= 2 * reduced.shape[1])
        change = continue_values(reduced.astype(np.float32) - self.small, hidden)
        return np.where(_enlarge(hidden, image), _convert(_enlarge(change, image) + self.clear), image)

    def add_dots(self, image: Float32) -> Float32:
        """Return an image (H, W, 3) of the gel without dots, darkened by the untouched gel's dots."""
        if self.hidden is None:
            return image
        shares = (self.image + np.float32(1)) / (self.clear + np.float32(1))
        return np.asarray(np.where(_enlarge(self.hidden, image), image * shares, image), np.float32)

    def record(self, pitch_m: float) -> dict[str, Any]:
        """Return the dots as JSON values: number, diameter and spacing in metres, and covered share of the image.

        `pitch_m` is the size of a pixel of the image on the gel, metres.
        """
        if self.dots is None:
            return {"count": 0}
        pitch_m = pitch_m * self.image.shape[1] / self.dots.shape[1]
        lengths = {"diameter_m": 2 * self.dots.radius_px * pitch_m, "spacing_m": self.dots.spacing_px * pitch_m}
        return {"count": len(self.dots), **lengths, "covered": self.covered}


def find_dots(image: Image) -> Dots | None:
    """Find the dots in an image (H, W, 3) of the untouched gel, or return None if it shows no lattice of dots.

    Dirt is no lattice: its specks differ in size and shade, and their distances are irregular.
    """
    shade = measure_shade(image)
    height, width = shade.shape
    best: tuple[float, float, Floats] | None = None
    for sigma in np.geomspace(FINEST_PX, max(COARSEST * max(height, width), 2 * FINEST_PX), SCALES).tolist():
        places, depths = _find_blobs(shade, sigma)
        if len(places) < FEWEST or (least := float(np.sort(depths)[-FEWEST])) < LEAST_DEPTH:
            continue
        usual = float(np.median(depths[depths > ALIKE * least]))
        alike = places[depths > ALIKE * usual]
        if (best is None or usual > best[0]) and _is_lattice(alike, shade.shape):
            best = usual, sigma, alike
    if best is None:
        return None
    depth, sigma, centres = best
    places, depths = _find_blobs(shade, sigma)
    centres = _complete_lattice(centres, places[depths > FAINT * depth])
    spacing = float(np.median(_find_neighbours(centres)[0]))
    radius = _measure_radius(shade, centres, spacing)
    return Dots((height, width), _add_border(centres, radius, spacing, shade.shape), radius, spacing, depth, sigma)


def measure_shade(image: Image) -> Float32:
    """Return the shade (H, W) of an image (H, W, 3): the negative logarithm of its brightness."""
    return np.asarray(-np.log(image.mean(axis=2, dtype=np.float32) + np.float32(OFFSET)), np.float32)


def _find_blobs(shade: Float32, sigma: float) -> tuple[Floats, Floats]:
    """Return the places (N, 2) of dark blobs, pixels, and their shades (N,)."""
    answer = -DISC * sigma**2 * gaussian_laplace(shade, sigma, mode="reflect", truncate=3.5)
    highest = maximum_filter(answer, 2 * max(1, round(sigma)) + 1)
    rows, columns = np.nonzero((answer == highest) & (answer > FAINT * LEAST_DEPTH))
    depths = answer[rows, columns].astype(np.float64)
    padded = np.pad(answer, 1, mode="edge")
    places = np.stack([columns, rows], axis=1) + 0.5
    for axis, (x, y) in enumerate(((1, 0), (0, 1))):
        low, high = padded[rows + 1 - y, columns + 1 - x], padded[rows + 1 + y, columns + 1 + x]
        bend = np.minimum(low + high - 2 * depths, -1e-6)
        places[:, axis] += np.clip(0.5 * (low - high) / bend, -0.5, 0.5)  # the vertex of a parabola
    return np.asarray(places, np.float64), np.asarray(depths, np.float64)


def _find_neighbours(places: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distance (N,) of each place from its nearest neighbour, and the neighbour's number (N,)."""
    distances, numbers = KDTree(places).query(places, k=2)
    return np.asarray(distances[:, 1]), np.asarray(numbers[:, 1])


def _is_lattice(places: Floats, shape: tuple[int, ...]) -> bool:
    """Return whether places (N, 2) are evenly spaced, fill the image, and mostly have opposite neighbours."""
    if len(places) < FEWEST:
        return False
    distances, nearest = _find_neighbours(places)
    spacing = float(np.median(distances))
    even = float((np.abs(distances / spacing - 1) < EVEN).mean())
    opposite = 2 * places - places[nearest]
    opposite = opposite[((opposite > 0) & (opposite < shape[::-1])).all(axis=1)]
    if even < REGULAR or not len(opposite) or len(places) * spacing**2 < SPREAD * shape[0] * shape[1]:
        return False
    return bool((KDTree(places).query(opposite)[0] < ASIDE * spacing).mean() > REGULAR)


def _complete_lattice(centres: Floats, faint: Floats) -> Floats:
    """Return the centres (N, 2), and those of the faint blobs (M, 2) that continue the lattice."""
    spacing = float(np.median(_find_neighbours(centres)[0]))
    while len(faint := faint[KDTree(centres).query(faint)[0] > OVERLAP * spacing]):
        fits = KDTree(_extrapolate(centres)).query(faint)[0] < ASIDE * spacing
        if not fits.any():
            break
        centres = np.concatenate([centres, faint[fits][:1]])
    return centres


def _extrapolate(centres: Floats) -> Floats:
    """Return the places (M, 2) opposite to the nearest neighbours of the centres (N, 2) of a lattice."""
    near = KDTree(centres).query(centres, k=5)[1][:, 1:]
    return np.asarray((2 * centres[:, None] - centres[near]).reshape(-1, 2))


def _add_border(centres: Floats, radius: float, spacing: float, shape: tuple[int, ...]) -> Floats:
    """Return the centres (N, 2), and those of dots beyond the image's border that are partly in the image."""
    expected = _extrapolate(centres)
    outside = np.maximum(-expected, expected - shape[::-1]).max(axis=1)
    for place in expected[(outside > -1) & (outside < radius)]:
        if KDTree(centres).query(place)[0] > OVERLAP * spacing:
            centres = np.concatenate([centres, place[None]])
    return centres


def _measure_radius(shade: Float32, centres: Floats, spacing: float) -> float:
    """Return the distance from the dots' centres, pixels, at which their mean shade falls to TAIL of its middle."""
    away = _measure_distances(centres, shade.shape)
    flat = shade - _smooth_between(shade, away > 0.45 * spacing, spacing)
    steps = np.round(2 * away).astype(int)  # half pixels
    counts = np.bincount(steps.ravel())[: int(spacing) + 1]
    mean = np.bincount(steps.ravel(), flat.ravel())[: len(counts)] / np.maximum(counts, 1)
    beyond = np.flatnonzero((counts > 0) & (mean < TAIL * mean[counts > 0][:2].max()))
    return 0.5 * float(beyond[0] - 0.5 if len(beyond) else len(mean) - 1)


def _smooth_between(values: Float32, seen: Bools, sigma: float) -> Float32:
    """Return the Gaussian mean (H, W) of the values (H, W) at the pixels that are seen (H, W)."""
    weights = gaussian_filter(seen.astype(np.float32), sigma)
    return np.asarray(gaussian_filter(np.where(seen, values, np.float32(0)), sigma) / np.maximum(weights, 1e-6))


def _measure_distances(centres: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the distance (H, W) of each pixel from the nearest of the centres (N, 2), pixels."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.asarray(KDTree(centres).query(np.stack([x.ravel(), y.ravel()], axis=1))[0].reshape(shape))


def match_dots(image: Image, dots: Dots) -> Floats:
    """Return the places (N, 2) of the dots in an image (H, W, 3) of a touch, pixels.

    Each dot is matched with at most one dark blob within REACH, so that the moves are small. A dot without a blob
    counts as unmoved.
    """
    places, depths = _find_blobs(measure_shade(image), dots.sigma_px)
    dark = depths > FAINT * dots.depth
    places, depths = places[dark], depths[dark]
    centres = dots.centres_px.copy()
    moves = np.linalg.norm(centres[:, None] - places[None], axis=2) / (REACH * dots.spacing_px)
    costs = np.minimum(moves**2 + np.maximum(1 - depths / dots.depth, 0) ** 2, 1)
    rows, columns = linear_sum_assignment(costs)
    found = costs[rows, columns] < 1
    centres[rows[found]] = places[columns[found]]
    return centres


def mark_dots(image: Image, dots: Dots, widen: bool = False) -> Bools:
    """Mark the pixels (H, W) of an image (H, W, 3) of a touch that dots darken.

    Dots are stretched with the surface. Therefore pixels beside a dot count if they are darker than the gel around it.
    Pass `widen` for a reduced image, whose pixels at a dot's border are partly darkened.
    """
    away = _measure_distances(match_dots(image, dots), dots.shape)
    hidden, near = away < dots.radius_px, away < STRETCH * dots.radius_px + 1
    shade, least = measure_shade(image), max(DARKER * dots.depth, NOISE)
    for _ in range(ROUNDS):
        gel = continue_values(shade[..., None], binary_dilation(hidden), bent=False)[..., 0]
        hidden = hidden | (near & (shade - gel > least))
    return np.asarray(binary_dilation(hidden) if widen else hidden)


def continue_values(values: Float32, hidden: Bools, bent: bool = True) -> Float32:
    """Return values (H, W, C), at hidden pixels (H, W) replaced by a surface that continues the other values.

    The surface is the thin plate with the least bending. If `bent` is False, it is a membrane, which has less noise.
    The values are 0 if all pixels are hidden.
    """
    seen = np.where(hidden[..., None], np.float32(0), values)
    inside = hidden.ravel()
    if inside.all() or not inside.any():
        return np.asarray(seen, np.float32)
    rows = _make_stencils(hidden.shape, bent)[inside]
    flat = seen.reshape(inside.size, -1)
    factors = splu(rows[:, inside].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    flat[inside] = factors.solve(-(rows @ flat.astype(np.float64)))
    return np.asarray(flat.reshape(values.shape), np.float32)


@lru_cache(maxsize=8)
def _make_stencils(shape: tuple[int, int], bent: bool) -> Any:
    """Return a sparse matrix (H W, H W): the Laplacian of an image with free borders, or its square if `bent`."""

    def chain(count: int) -> Any:
        ends = np.full(count, 2.0)
        ends[[0, -1]] = 1
        return diags_array([ends, np.full(count - 1, -1.0), np.full(count - 1, -1.0)], offsets=[0, 1, -1])

    height, width = shape
    laplacian = (kron(chain(height), eye_array(width)) + kron(eye_array(height), chain(width))).tocsr()
    return (laplacian @ laplacian).tocsr() if bent else laplacian


def _enlarge(values: Float32 | Bools, image: Image | Float32) -> Any:
    """Return values (h, w, C) or a mask (h, w) at the size of an image (H, W, 3); a mask gets a third axis."""
    size = image.shape[1::-1]
    planes = np.atleast_3d(values)
    if planes.shape[1::-1] == size:
        return planes
    method = Picture.Resampling.NEAREST if values.dtype == bool else Picture.Resampling.BILINEAR
    larger = [Picture.fromarray(planes[..., i].astype(np.float32)).resize(size, method) for i in range(planes.shape[2])]
    return np.stack([np.asarray(plane, planes.dtype) for plane in larger], axis=-1)


def _convert(image: Float32) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
