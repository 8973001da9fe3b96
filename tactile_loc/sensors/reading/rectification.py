"""How a camera sees the gel: stated by the user, or estimated from marker dots or from the imprints of balls.

Photos are rectified to the same scale everywhere before anything else is done with them: see `PhotoMap`.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import ConfigError, SensorError
from tactile_loc.core.sensing.photo_map import (
    Corner,
    Lens,
    PhotoMap,
    apply_homography,
    even_scales,
    frame_view,
    to_corners,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.circles import Circle, compare_colours, thin
from tactile_loc.sensors.reading.markers import Dots, UntouchedGel

STANDOFF_M, DEEPEST_M = 10e-3, 1.5e-3  # assumed for a sensor of which only the view is known
LEAST_MIDDLE = 0.2  # least distance of the optical axis from the border of the photo, share of its side
STRETCHED = 1.1  # ratio of scales above which photos count as stretched
LARGEST = 0.5  # largest logarithm of the ratio that is looked for
SAMPLED = 20  # largest number of presses from which the ratio is estimated
FEWEST = 3  # presses
SAME_RATIO = 0.01  # largest logarithm of a ratio that is not corrected again
BANDS = np.arange(0.3, 1.3, 0.05), np.arange(0.7, 1.35, 0.05)  # compared distances from a ball's centre, in radii
TURNS = (np.arange(60) + 0.5) * np.pi / 60  # compared directions, radians
SMOOTHING_PX = 1.0  # of the colours, against the camera's noise
NEAR = 0.3  # largest distance of a dot from its expected place, in spacings
MANY = 50  # fewest dots for a second factor of the lens
SQUARE_PX, OFF = 2.0, 0.12  # errors of a dot that count less, pixels, and largest median error, in spacings


@dataclass(frozen=True)
class StatedView:
    """A camera's view of the gel as a user states it, besides the size of a pixel.

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
            if not (np.isfinite(corners).all() and 0 < min(self.gel_mm) <= max(self.gel_mm) < np.inf):
                raise ConfigError("`corners` must be numbers in pixels, and `gel_size` two positive numbers in mm")
            (a, b), (c, d) = corners[2] - corners[0], corners[3] - corners[1]
            area_px = 0.5 * abs(a * d - b * c)
            pitch_mm = float(np.sqrt(np.prod(self.gel_mm) / max(area_px, 1.0)))
            width, height = (max(1, round(side / pitch_mm)) for side in self.gel_mm)
            photo_map = PhotoMap(size_px, (width, height), to_corners(corners), self.lens)
            scales = 1e3 * width / self.gel_mm[0], 1e3 * height / self.gel_mm[1]
            return photo_map.hide_unseen(make_camera((height, width), *scales)), photo_map
        if mm_per_px is None:
            raise ConfigError("the size of a pixel is unknown; give `mm_per_px`, or `corners` and `gel_size`")
        scale = 1e3 / mm_per_px
        if self.lens is not None:
            self._require_middle(size_px, self.lens)
            even = np.sqrt(self.lens.fx * self.lens.fy)
            straight = np.diag([self.lens.fx / even, self.lens.fy / even, 1.0])
            photo_map = frame_view(size_px, straight, self.lens)
            return photo_map.hide_unseen(make_camera(photo_map.image_px[::-1], scale, scale)), photo_map
        if self.aspect == 1:
            return make_camera(shape, scale, scale), None
        return even_scales(make_camera(shape, scale / self.aspect**0.5, scale * self.aspect**0.5))

    def _require_middle(self, photo_px: tuple[int, int], lens: Lens) -> None:
        """Raise ConfigError unless a camera matrix can be that of photos of a size (width, height)."""
        if not all(
            LEAST_MIDDLE < c / size < 1 - LEAST_MIDDLE for c, size in zip((lens.cx, lens.cy), photo_px, strict=True)
        ):
            raise ConfigError(
                f"the middle of the camera matrix is ({lens.cx:g}, {lens.cy:g}) px, but the photos are {photo_px[0]} x "
                f"{photo_px[1]} px; give the matrix for photos of this size"
            )


def make_camera(shape: tuple[int, int], fx: float, fy: float) -> SensorGeometry:
    """Return a sensor with parallel rays, images of a shape (rows, columns), and scales in pixels per metre."""
    height, width = shape
    return SensorGeometry("orthographic", width, height, fx, fy, width / 2, height / 2, STANDOFF_M, DEEPEST_M)


@dataclass(frozen=True)
class Stretch:
    """The ratio of the width to the height of balls' imprints, and its standard deviation."""

    ratio: float
    std: float

    @property
    def is_clear(self) -> bool:
        """Whether the photos are stretched beyond doubt."""
        return abs(np.log(self.ratio)) > np.log(STRETCHED) + self.std / self.ratio

    def list_doubts(self, camera: SensorGeometry) -> list[str]:
        """Return a sentence about the scales of a camera with square pixels, if the photos are stretched."""
        return [f"the scales of x and y differ: {self.describe()}; {self.advise(camera)}"] if self.is_clear else []

    def advise(self, camera: SensorGeometry) -> str:
        """Return the scales of x and y that even photos whose mean scale is that of `camera`."""
        pitch_mm = 1e3 * camera.pixel_pitch_m
        return f"`mm_per_px` {pitch_mm / self.ratio**0.5:.4g},{pitch_mm * self.ratio**0.5:.4g} evens them"

    def describe(self) -> str:
        """Return the ratio in words."""
        share, longer = max(self.ratio, 1 / self.ratio), "wider than high" if self.ratio > 1 else "higher than wide"
        return f"a ball's imprint is {100 * (share - 1):.0f} % {longer} (ratio {self.ratio:.3f} ± {self.std:.3f})"


def measure_stretch(presses: Sequence[tuple[Image, Circle]], untouched: Image) -> Stretch | None:
    """Measure how stretched photos are from the imprints of balls in images (H, W, 3) without dots.

    Under any light, the odd colour change along a line through a ball's centre has the same profile in all directions,
    except for its strength. In a stretched photo, the profiles differ in length. The profiles in the BANDS differ by
    the errors of this assumption. Return None for fewer than FEWEST imprints in the image.
    """
    some = thin(presses, SAMPLED)
    found = np.array([_find_stretches(image, circle, untouched) for image, circle in some]).reshape(-1, len(BANDS))
    known = found[np.isfinite(found).all(axis=1)]
    if len(known) < FEWEST:
        return None
    middles = np.median(known, axis=0)
    spread = 1.48 * float(np.median(np.abs(known - middles)))
    ratio = float(np.exp(middles.mean()))
    return Stretch(ratio, ratio * float(np.hypot(1.25 * spread / np.sqrt(len(known)), middles.std())))


def _find_stretches(image: Image, circle: Circle, untouched: Image) -> list[float]:
    """Return the logarithm of an imprint's stretch along x in each of BANDS, or NaN beyond the image."""
    change = compare_colours(image, untouched, SMOOTHING_PX)
    return [_find_stretch(change, circle, band) for band in BANDS]


def _find_stretch(change: NDArray[np.float32], circle: Circle, band: Floats) -> float:
    best, step = 0.0, LARGEST / 4
    tried = np.arange(-4, 5) * step
    for _ in range(3):
        likeness = np.array([_compare_profiles(change, circle, band, best + one) for one in tried])
        if not np.isfinite(likeness).all():
            return float("nan")
        k = int(np.clip(likeness.argmax(), 1, len(tried) - 2))
        low, mid, high = likeness[k - 1 : k + 2]
        bend = min(low + high - 2 * mid, -1e-12)
        best += tried[k] + step * float(np.clip(0.5 * (low - high) / bend, -1, 1))
        step /= 4
        tried = np.arange(-1, 2) * step
    return best


def _compare_profiles(change: NDArray[np.float32], circle: Circle, band: Floats, log_ratio: float) -> float:
    """Return how alike (0 to 1) the odd profiles in a band are in all directions if the imprint is stretched."""
    cos, sin = np.cos(TURNS), np.sin(TURNS)
    reach = circle.radius_px / np.hypot(cos * np.exp(-log_ratio / 2), sin * np.exp(log_ratio / 2))
    x, y = band[:, None] * reach * cos, band[:, None] * reach * sin
    middle = np.array([circle.x_px - 0.5, circle.y_px - 0.5])
    odd = [
        map_coordinates(plane, [middle[1] + y, middle[0] + x], order=1, cval=np.nan)
        - map_coordinates(plane, [middle[1] - y, middle[0] - x], order=1, cval=np.nan)
        for plane in np.moveaxis(change, 2, 0)
    ]
    profiles = np.concatenate(odd, axis=1) * np.sqrt(band)[:, None]
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

    homography: Floats
    lens: Lens
    off: float

    def frame(self, photo_px: tuple[int, int]) -> PhotoMap:
        """Return the map for photos of `photo_px` (width, height). In their middle, it keeps scale and rotation."""
        middle = apply_homography(np.linalg.inv(self.homography), np.array([photo_px]) / 2)
        across = (apply_homography(self.homography, middle + np.array([[h, 0], [0, h]])) for h in (-0.01, 0.01))
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

    def miss(values: Floats) -> Floats:
        ideal = apply_homography(np.append(values[:8], 1.0).reshape(3, 3), numbers)
        seen = Lens(1.0, 1.0, 0.0, 0.0, tuple(values[8:])).distort(ideal)
        return np.asarray((seen - places).ravel())

    more = [0.0] * (4 if len(numbers) > MANY else 3)  # perspective in x and y, k1, k2
    fit = least_squares(miss, np.append(first, more), loss="soft_l1", f_scale=SQUARE_PX / length)
    spacing_px = dots.spacing_px * photo_px[0] / dots.shape[1]
    off = float(np.median(np.hypot(*fit.fun.reshape(-1, 2).T))) * length / spacing_px
    if off > OFF:
        return None
    to_px = np.array([[length, 0, middle[0]], [0, length, middle[1]], [0, 0, 1]])
    lens = Lens(length, length, float(middle[0]), float(middle[1]), tuple(fit.x[8:].tolist()))
    return Lattice(to_px @ np.append(fit.x[:8], 1.0).reshape(3, 3), lens, off)


def _number_dots(centres: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return the numbers (M, 2) along both sides of the lattice of some of the centres (N, 2), and their indices (M,).

    The numbers are counted from dot to dot, from the middle outwards. x is the side nearer to that of the photo.
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


@dataclass(frozen=True, eq=False)
class SeenView:
    """How a camera sees the gel by its photos: the sensor, the map of its photos, and a sentence about both."""

    camera: SensorGeometry
    photo_map: PhotoMap
    says: str
    aspect: float | None = None


def see_view(
    gel: UntouchedGel, presses: Sequence[tuple[Image, Circle]], straight: SensorGeometry, before: SeenView | None = None
) -> SeenView | None:
    """Return how a camera sees the gel in photos of presses, or None if it sees it straight, or as in `before`.

    `presses` are images (H, W, 3) with balls and their circles. They were rectified as in `before`. `straight` is the
    sensor for photos that are not rectified. Marker dots show the whole view, if they are a square lattice in which
    balls are round. Otherwise, balls show the ratio of the scales of x and y.
    """
    some = [(gel.clear_image(image), circle) for image, circle in thin(presses, SAMPLED)]
    stretch = measure_stretch(some, gel.clear)
    photo_px = straight.width_px, straight.height_px
    if before is not None:
        if before.aspect is None or stretch is None or abs(np.log(stretch.ratio)) < 2 * stretch.std + SAME_RATIO:
            return None
        ratio = stretch.ratio * before.aspect
        return _even_view(replace(stretch, ratio=ratio, std=stretch.std * before.aspect), straight)
    photo_map = None if gel.dots is None else _frame_dots(gel.dots, photo_px)
    if photo_map is not None:
        ratio, range_ = measure_scales(photo_map)
        round_ = stretch is None or abs(np.log(ratio / stretch.ratio)) < np.log(STRETCHED)
        if round_ and max(ratio, 1 / ratio, range_) > STRETCHED:
            camera = make_camera(photo_map.image_px[::-1], *straight.scale_at_surface)
            says = (
                f"the lattice of {len(gel.dots or ())} marker dots shows that the scale differs by "
                f"{100 * (range_ - 1):.0f} % over the photo, and by {100 * abs(ratio - 1):.0f} % between x and y in "
                "its middle: photos are rectified"
            )
            return SeenView(photo_map.hide_unseen(camera), photo_map, says)
    return _even_view(stretch, straight) if stretch is not None and stretch.is_clear else None


def _frame_dots(dots: Dots, photo_px: tuple[int, int]) -> PhotoMap | None:
    """Return the map that the lattice of the dots shows, or None if its lens does not show the photo's borders."""
    lattice = fit_lattice(dots, photo_px)
    with suppress(SensorError):
        return None if lattice is None else lattice.frame(photo_px)
    return None


def _even_view(stretch: Stretch, straight: SensorGeometry) -> SeenView:
    sx, sy = straight.scale_at_surface
    uneven = replace(straight, fx=sx * stretch.ratio**0.5, fy=sy / stretch.ratio**0.5)
    camera, photo_map = even_scales(uneven)
    says = f"the photos are stretched: {stretch.describe()}. They are evened; {stretch.advise(straight)}, too"
    return SeenView(camera, photo_map, says, stretch.ratio)


def measure_scales(photo_map: PhotoMap) -> tuple[float, float]:
    """Return the ratio of a photo's scales of x and y in its middle, and of its largest and smallest scale.

    The scale at a place is the square root of the area in the photo of a unit area of the image.
    """
    width, height = photo_map.image_px
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0.05, 0.95, 9), np.linspace(0.05, 0.95, 9)))
    places = np.stack([x * width, y * height], axis=1)
    right, down = (photo_map.locate(places + step) - photo_map.locate(places - step) for step in ([0.5, 0], [0, 0.5]))
    scales = np.sqrt(np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]))
    middle = len(places) // 2
    ratio = float(np.linalg.norm(right[middle]) / np.linalg.norm(down[middle]))
    return ratio, float(scales.max() / scales.min())
