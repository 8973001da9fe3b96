"""How a camera sees the gel: stated by the user, or estimated from marker dots or from the imprints of balls.

Photos are rectified to the same scale everywhere before anything else is done with them: see `PhotoMap`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError
from tactile_loc.core.sensing.photo_map import (
    UNIT,
    Corner,
    Lens,
    PhotoMap,
    apply_homography,
    even_scales,
    frame_view,
    to_corners,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.circles import Circle, compare_colours
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.markers import Dots

Array = NDArray[np.float64]

STANDOFF_M, DEEPEST_M = 10e-3, 1.5e-3  # assumed for a sensor of which only the view is known
STRETCHED = 1.1  # ratio of scales above which photos count as stretched
LARGEST = 0.5  # largest logarithm of the ratio that is looked for
SAMPLED = 20  # approximate number of presses from which the ratio is estimated
FEWEST = 3  # presses
AWAY = np.arange(0.1, 1.9, 0.05)  # distances from a ball's centre at which colours are compared, in radii
TURNS = (np.arange(60) + 0.5) * np.pi / 60  # compared directions, radians
SMOOTHING_PX = 1.0  # of the colours, against the camera's noise
NEAR = 0.3  # largest distance of a dot from its expected place, in spacings
SQUARE_PX, OFF = 2.0, 0.12  # errors of a dot that count less, pixels, and largest median error, in spacings


@dataclass(frozen=True)
class StatedView:
    """What is known about a camera's view of the gel, besides the size of a pixel.

    `aspect` is the width of a photo's pixel on the gel divided by its height. `corners_px` (x, y) are the corners, in
    the photo, of a rectangle on the gel of the size `gel_mm` (width, height), clockwise from the upper left. `lens` is
    a camera that looks straight at the gel, if there are no corners.
    """

    aspect: float = 1.0
    corners_px: tuple[Corner, ...] = ()
    gel_mm: tuple[float, float] | None = None
    lens: Lens | None = None

    def make_camera(self, shape: tuple[int, int], mm_per_px: float | None) -> tuple[SensorGeometry, PhotoMap | None]:
        """Return the sensor with rectified images, and the map from photos of a shape (rows, columns).

        `mm_per_px` is the size of a pixel in the middle of the photo, needed without corners. With an `aspect`, it is
        the geometric mean of width and height. Raises ConfigError for a view that is incomplete.
        """
        size_px = shape[1], shape[0]
        if bool(self.corners_px) != (self.gel_mm is not None):
            raise ConfigError("`corners` and `gel_size` belong together: the corners in the photo, and their distances")
        if self.gel_mm is not None:
            if mm_per_px is not None:
                raise ConfigError("`corners` and `gel_size` give the size of a pixel; leave out `mm_per_px`")
            corners = np.array(self.corners_px)
            area_px = 0.5 * abs(np.cross(corners[2] - corners[0], corners[3] - corners[1]))
            pitch_mm = float(np.sqrt(np.prod(self.gel_mm) / area_px))
            width, height = (max(1, round(side / pitch_mm)) for side in self.gel_mm)
            photo_map = PhotoMap(size_px, (width, height), to_corners(corners), self.lens)
            scales = 1e3 * width / self.gel_mm[0], 1e3 * height / self.gel_mm[1]
            return photo_map.hide_unseen(make_camera((height, width), *scales)), photo_map
        if mm_per_px is None:
            raise ConfigError("the size of a pixel is unknown; give `mm_per_px`, or `corners` and `gel_size`")
        scale = 1e3 / mm_per_px
        if self.lens is not None:
            even = np.sqrt(self.lens.fx * self.lens.fy)
            straight = np.diag([self.lens.fx / even, self.lens.fy / even, 1.0])
            photo_map = frame_view(size_px, straight, self.lens)
            return photo_map.hide_unseen(make_camera(photo_map.image_px[::-1], scale, scale)), photo_map
        if self.aspect == 1:
            return make_camera(shape, scale, scale), None
        return even_scales(make_camera(shape, scale / self.aspect**0.5, scale * self.aspect**0.5))


def make_camera(shape: tuple[int, int], fx: float, fy: float) -> SensorGeometry:
    """Return a sensor with parallel rays, images of a shape (rows, columns), and scales in pixels per metre."""
    height, width = shape
    return SensorGeometry("orthographic", width, height, fx, fy, width / 2, height / 2, STANDOFF_M, DEEPEST_M)


@dataclass(frozen=True)
class Stretch:
    """The ratio of an imprint's width to its height that a round ball shows, and its standard deviation.

    `of` names what it was measured from.
    """

    ratio: float
    std: float
    of: str = "a ball's imprint"

    @property
    def is_clear(self) -> bool:
        """Whether the photos are stretched beyond doubt."""
        return abs(np.log(self.ratio)) > np.log(STRETCHED) + 2 * self.std / self.ratio

    def describe(self) -> str:
        """Return the ratio in words."""
        share, longer = max(self.ratio, 1 / self.ratio), "wider than high" if self.ratio > 1 else "higher than wide"
        return f"{self.of} is {100 * (share - 1):.0f} % {longer} (ratio {self.ratio:.3f} ± {self.std:.3f})"


def measure_stretch(presses: Sequence[tuple[Image, Circle]], untouched: Image) -> Stretch | None:
    """Measure how stretched photos are from the imprints of balls in images (H, W, 3) without dots.

    Under any light, the odd colour change along a line through a ball's centre has the same profile in all directions,
    except for its strength. In a stretched photo, the profiles differ in length. Return None for fewer than FEWEST
    imprints in the image.
    """
    some = presses[:: max(1, len(presses) // SAMPLED)]
    found = [_find_stretch(image, circle, untouched) for image, circle in some]
    known = np.array([one for one in found if np.isfinite(one)])
    if len(known) < FEWEST:
        return None
    middle = float(np.median(known))
    spread = 1.48 * float(np.median(np.abs(known - middle)))
    return Stretch(float(np.exp(middle)), float(np.exp(middle) * 1.25 * spread / np.sqrt(len(known))))


def _find_stretch(image: Image, circle: Circle, untouched: Image) -> float:
    """Return the logarithm of an imprint's stretch along x, or NaN if the imprint is not in the image."""
    change = gaussian_filter(compare_colours(image, untouched), (SMOOTHING_PX, SMOOTHING_PX, 0))
    best, step = 0.0, LARGEST / 4
    tried = np.arange(-4, 5) * step
    for _ in range(3):
        likeness = np.array([_compare_profiles(change, circle, best + one) for one in tried])
        if not np.isfinite(likeness).all():
            return float("nan")
        k = int(np.clip(likeness.argmax(), 1, len(tried) - 2))
        low, mid, high = likeness[k - 1 : k + 2]
        bend = min(low + high - 2 * mid, -1e-12)
        best += tried[k] + step * float(np.clip(0.5 * (low - high) / bend, -1, 1))
        step /= 4
        tried = np.arange(-1, 2) * step
    return best


def _compare_profiles(change: NDArray[np.float32], circle: Circle, log_ratio: float) -> float:
    """Return how alike the odd profiles (0 to 1) are in all directions if the imprint is stretched by a ratio."""
    cos, sin = np.cos(TURNS), np.sin(TURNS)
    reach = circle.radius_px / np.hypot(cos * np.exp(-log_ratio / 2), sin * np.exp(log_ratio / 2))
    x, y = AWAY[:, None] * reach * cos, AWAY[:, None] * reach * sin
    middle = np.array([circle.x_px - 0.5, circle.y_px - 0.5])
    odd = [
        map_coordinates(plane, [middle[1] + y, middle[0] + x], order=1, cval=np.nan)
        - map_coordinates(plane, [middle[1] - y, middle[0] - x], order=1, cval=np.nan)
        for plane in np.moveaxis(change, 2, 0)
    ]
    profiles = np.concatenate(odd, axis=1) * np.sqrt(AWAY)[:, None]
    known = np.isfinite(profiles).all(axis=0)
    if known.mean() < 0.5:
        return float("nan")
    powers = np.linalg.svd(profiles[:, known], compute_uv=False) ** 2
    return float(powers[0] / max(powers.sum(), 1e-12))


@dataclass(frozen=True)
class Lattice:
    """Marker dots as a square lattice, seen by a camera with a lens: from the dots' numbers to places in the photo.

    `homography` (3, 3) maps numbers (x, y) to the photo, pixels, of a lens without distortion. `off` is the median
    distance of the dots from their places, in spacings.
    """

    homography: Array
    lens: Lens
    off: float

    def frame(self, photo_px: tuple[int, int]) -> PhotoMap:
        """Return the map for photos of `photo_px` (width, height). In their middle, it keeps scale and rotation."""
        middle = apply_homography(np.linalg.inv(self.homography), np.array(photo_px, float)[None] / 2)
        across = (apply_homography(self.homography, middle + [[h, 0], [0, h]]) for h in (-0.01, 0.01))
        low, high = across
        jacobian = ((high - low) / 0.02).T
        u, _, v = np.linalg.svd(jacobian)
        turn = v.T @ u.T * abs(np.linalg.det(jacobian)) ** -0.5  # numbers per pixel
        origin = middle[0] - turn @ (np.array(photo_px) / 2)
        numbers = np.vstack([np.column_stack([turn, origin]), [0, 0, 1]])
        return frame_view(photo_px, self.homography @ numbers, self.lens)


def fit_lattice(dots: Dots, photo_px: tuple[int, int]) -> Lattice | None:
    """Fit a square lattice, a view and a lens to the dots of a gel in photos of `photo_px` (width, height).

    Return None if the dots are no regular lattice.
    """
    centres = dots.centres_px * (np.array(photo_px) / dots.shape[::-1])
    numbers, chosen = _number_dots(centres)
    middle, length = np.array(photo_px) / 2, max(photo_px) / 2
    places = (centres[chosen] - middle) / length
    terms = np.column_stack([numbers, np.ones(len(numbers))])
    if len(numbers) < len(centres) / 2 or np.linalg.matrix_rank(terms) < 3:
        return None
    first = np.linalg.lstsq(terms, places, rcond=None)[0].T.ravel()

    def miss(values: Array) -> Array:
        ideal = apply_homography(np.append(values[:8], 1.0).reshape(3, 3), numbers)
        radial = 1 + values[8] * (ideal**2).sum(axis=1, keepdims=True)
        return np.asarray((ideal * radial - places).ravel())

    fit = least_squares(miss, np.append(first, [0.0, 0.0, 0.0]), loss="soft_l1", f_scale=SQUARE_PX / length)
    spacing_px = dots.spacing_px * photo_px[0] / dots.shape[1]
    off = float(np.median(np.hypot(*fit.fun.reshape(-1, 2).T))) * length / spacing_px
    if off > OFF:
        return None
    to_px = np.array([[length, 0, middle[0]], [0, length, middle[1]], [0, 0, 1]])
    lens = Lens(length, length, *map(float, middle), (float(fit.x[8]),))
    return Lattice(to_px @ np.append(fit.x[:8], 1.0).reshape(3, 3), lens, off)


def _number_dots(centres: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the numbers (M, 2) along both sides of the lattice of some of the centres (N, 2), and their indices (M,).

    The numbers are counted from dot to dot, from the middle outwards. x is the side that is nearer to that of the photo.
    """
    tree = KDTree(centres)
    start = int(tree.query(np.median(centres, axis=0))[1])
    around = centres[tree.query(centres[start], k=5)[1][1:]] - centres[start]
    x, y = around[np.abs(around[:, 0]).argmax()], around[np.abs(around[:, 1]).argmax()]
    steps = {start: np.array([x * np.sign(x[0]), y * np.sign(y[1])])}
    numbers = {start: (0, 0)}
    waiting = [start]
    for dot in waiting:
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = sign * steps[dot][axis]
            away, other = tree.query(centres[dot] + step)
            if away < NEAR * np.hypot(*step) and other not in numbers:
                i, j = numbers[dot]
                numbers[other] = (i + sign, j) if axis == 0 else (i, j + sign)
                steps[other] = steps[dot].copy()
                steps[other][axis] = 0.5 * (steps[dot][axis] + sign * (centres[other] - centres[dot]))
                waiting.append(other)
    chosen = np.array(list(numbers), np.intp)
    return np.array([numbers[one] for one in numbers], float), chosen
