"""Finds the visible circle of a ball in an image of the gel, under any light.

The search has three steps, from robust to exact:

1. A matched filter finds the position and the approximate size. The filter is a coloured ramp, because the colour
   change in a ball's imprint is roughly proportional to the offset from the centre, under any light.
2. A fit of ramps refines position and size.
3. On each of RAYS rays from the centre, the steepest drop of the colour change is found. A circle is fitted robustly to
   these points. This step needs no model of the light.

The origin of pixel coordinates is the image's upper left corner, so the first pixel's centre is (0.5, 0.5). A `change`
is an image minus the image of the untouched gel: (H, W, 3) float32, counts of 255, with median 0.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import least_squares

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.sensors.calibration.labels import Image

T = TypeVar("T")

LIKENESS, CONTRAST = 0.65, 4.0  # least likeness of a ball's imprint, and least contrast, counts
COARSE_PX, COARSER_PX = 80, 40  # longer image side for finding a ball, and for measuring concentration
SMALLEST_PX, SIZES = 2.5, 12  # smallest radius of the filters in coarse pixels, and number of radii
LARGEST = 0.5  # largest radius of the filters, share of the image's shorter side
FALL = 6  # a ramp is u / (1 + u^FALL) at the distance u from its centre, in radii
REACH = 2.0  # ramps are fitted to the pixels within this distance from the centre, in radii
FITTED = 500  # largest number of pixels in a fit
RAYS = 90
BAND, STEP = (0.75, 1.25), 0.01  # range and step of the search for the rim, radii
FINE, SKIRT = 0.04, 0.3  # smallest and largest feature that counts as a rim, in radii
TUKEY = 4.0  # distance from the circle beyond which a ray does not count, in standard deviations
ROUNDS = 15


@dataclass(frozen=True)
class Circle:
    """A circle in an image: its centre and radius, pixels."""

    x_px: float
    y_px: float
    radius_px: float

    def measure_distance_px(self, shape: tuple[int, int]) -> Floats:
        """Return the distance (H, W) of each pixel's centre from the circle's centre, pixels."""
        height, width = shape
        y, x = np.ogrid[:height, :width]
        return np.asarray(np.hypot(x + 0.5 - self.x_px, y + 0.5 - self.y_px))

    def measure_overhang_px(self, shape: tuple[int, int]) -> float:
        """Return the distance, pixels, by which the circle extends beyond an image (H, W). It is negative inside."""
        height, width = shape
        return self.radius_px - min(self.x_px, self.y_px, width - self.x_px, height - self.y_px)

    def measure_visible_arc(self, shape: tuple[int, int]) -> float:
        """Return the share of the circle that lies in an image (H, W), 0 to 1."""
        angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
        x, y = self.x_px + self.radius_px * np.cos(angles), self.y_px + self.radius_px * np.sin(angles)
        return float(np.mean((x > 0) & (x < shape[1]) & (y > 0) & (y < shape[0])))


@dataclass(frozen=True)
class Imprint:
    """A possible imprint of a ball.

    `likeness` is the share of the change's variance within REACH radii that the model of a ball's imprint explains.
    `contrast` is the root mean square of the change in the circle, counts. Both are 0 if there is no change.
    """

    circle: Circle
    likeness: float = 0.0
    contrast: float = 0.0

    @property
    def is_ball(self) -> bool:
        """Whether the imprint is that of a ball."""
        return self.likeness >= LIKENESS and self.contrast >= CONTRAST


def compare_colours(image: Image | Float32, untouched: Image | Float32, smoothing_px: float = 0.0) -> Float32:
    """Return an image minus that of the untouched gel, (H, W, 3), counts, shifted to a median of 0 in each colour.

    With `smoothing_px`, the standard deviation of a smoothing, the camera's noise is less.
    """
    change = np.asarray(image, np.float32) - np.asarray(untouched, np.float32)
    change = np.asarray(change - np.median(change[::2, ::2], axis=(0, 1)), np.float32)
    return gaussian_filter(change, (smoothing_px, smoothing_px, 0)) if smoothing_px else change


def thin(presses: Sequence[T], most: int) -> Sequence[T]:
    """Return every n-th press, from the first one, with the least n that leaves at most `most` presses."""
    return presses[:: max(1, -(-len(presses) // most))]


def find_imprint(change: Float32, hidden: Bools | None = None) -> Imprint:
    """Return the strongest imprint in a colour change (H, W, 3). It need not be that of a ball.

    The imprint's circle is approximate; `find_rim` refines it. Pixels that are marked in `hidden` (H, W) count as
    untouched.
    """
    seen = change if hidden is None else np.where(hidden[..., None], np.float32(0), change)
    coarse, step = _coarsen(seen, COARSE_PX)
    best = _match_filters(coarse)
    if best is None:
        return Imprint(Circle(0.0, 0.0, 1.0))
    start = Circle((best[1] + 0.5) * step, (best[2] + 0.5) * step, best[3] * step)
    circle, likeness = _fit_circle(seen, start)
    inside = seen[circle.measure_distance_px(seen.shape[:2]) < circle.radius_px]
    return Imprint(circle, likeness, float(np.sqrt((inside**2).mean())) if inside.size else 0.0)


def measure_concentration(change: Float32) -> float:
    """Return the share (0 to 1) of a colour change (H, W, 3) that the best single imprint explains.

    The share refers to the sum of squares. It is 0 if the change is 0 everywhere.
    """
    coarse, _ = _coarsen(change, COARSER_PX)
    energy = float((coarse**2).sum())
    best = _match_filters(coarse)
    return 0.0 if best is None or not energy else min(1.0, best[0] / energy)


def _coarsen(change: Float32, side: int) -> tuple[Float32, int]:
    """Return the change averaged over square blocks, and the side of a block in pixels."""
    step = max(1, round(max(change.shape) / side))
    rows, columns = (n // step for n in change.shape[:2])
    blocks = change[: rows * step, : columns * step].reshape(rows, step, columns, step, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), np.float32), step


def _match_filters(coarse: Float32) -> tuple[float, int, int, float] | None:
    """Return the energy that the best filter explains, and the filter's x, y and radius, all three in blocks."""
    height, width = coarse.shape[:2]
    margin = min(height, width) // 2
    padded = np.pad(coarse, [(margin, margin), (margin, margin), (0, 0)])
    spectrum = fft.rfft2(np.moveaxis(padded, 2, 0))
    middle = np.s_[margin : margin + height, margin : margin + width]
    best: tuple[float, int, int, float] | None = None
    for radius in np.geomspace(SMALLEST_PX, max(LARGEST * min(height, width), 2 * SMALLEST_PX), SIZES).tolist():
        explained = np.zeros(coarse.shape[:2])
        for kernel in _make_kernels(padded.shape[:2], radius):
            answer = fft.irfft2(spectrum * kernel, padded.shape[:2])[:, middle[0], middle[1]]
            explained += np.einsum("crk,crk->rk", answer, answer)
        y, x = divmod(int(explained.argmax()), width)
        if explained[y, x] > (best[0] if best else 0.0):
            best = float(explained[y, x]), x, y, radius
    return best


@lru_cache(maxsize=64)
def _make_kernels(shape: tuple[int, int], radius: float) -> tuple[NDArray[np.complex64], ...]:
    """Return the spectra of two ramps of unit energy, one along x and one along y."""
    y, x = (np.fft.fftfreq(n, 1 / n) for n in shape)
    u = np.hypot(*np.meshgrid(x, y)) / radius
    falls = np.where(u < REACH, 1 / (1 + u**FALL), 0)
    ramps = (x[None, :] * falls, y[:, None] * falls)
    return tuple(np.conj(fft.rfft2(ramp / np.sqrt((ramp**2).sum()))).astype(np.complex64) for ramp in ramps)


def _fit_circle(change: Float32, start: Circle) -> tuple[Circle, float]:
    """Fit a circle to the change around `start`. Return the circle and the explained share of the change's variance.

    The model consists of the circle's two ramps, their products and a plane. The amplitudes of these terms follow from
    the circle by linear least squares, separately for each colour (variable projection).
    """
    circle, share = start, 0.0
    for _ in range(2):  # the window moves with the circle
        x, y, colours = _take_around(change, circle)
        spread = float(((colours - colours.mean(axis=0)) ** 2).sum())

        def missed(values: Floats, x: Floats = x, y: Floats = y, colours: Floats = colours) -> Floats:
            q, _ = np.linalg.qr(_build_ramps(x, y, values))
            return np.asarray((colours - q @ (q.T @ colours)).ravel())

        first = np.array([circle.x_px, circle.y_px, circle.radius_px])
        lowest, highest = first - first[2] * np.array([1, 1, 0.6]), first + first[2]
        found = least_squares(missed, first, bounds=(lowest, highest), diff_step=1e-4, max_nfev=15)
        circle, share = Circle(*map(float, found.x)), 1 - 2 * float(found.cost) / max(spread, 1e-9)
    return circle, share


def _take_around(change: Float32, circle: Circle) -> tuple[Floats, Floats, Floats]:
    """Return a sample of the pixels within REACH radii: their x (P,), y (P,) and change (P, 3)."""
    rows, columns = np.nonzero(circle.measure_distance_px(change.shape[:2]) < REACH * circle.radius_px)
    chosen = np.s_[:: max(1, len(rows) // FITTED)]
    rows, columns = rows[chosen], columns[chosen]
    x, y = (np.asarray(places, np.float64) + 0.5 for places in (columns, rows))
    return x, y, change[rows, columns].astype(np.float64)


def _build_ramps(x: Floats, y: Floats, values: Floats) -> Floats:
    """Return the model's terms (P, 8) at pixels x (P,), y (P,) for a circle with `values` (x, y, radius), pixels."""
    dx, dy = (x - values[0]) / values[2], (y - values[1]) / values[2]
    falls = 1 / (1 + np.hypot(dx, dy) ** FALL)
    a, b = dx * falls, dy * falls
    return np.stack([a, b, a * a, a * b, b * b, np.ones_like(a), dx, dy], axis=1)


def find_rim(change: Float32, near: Circle) -> Circle:
    """Return the circle near `near` along which the colour change (H, W, 3) drops most steeply outwards.

    Only features narrower than SKIRT radii count. The change also fades slowly outside a contact, but this slow drop
    does not show the contact's edge.
    """
    relief = _find_relief(change, near)
    angle = np.arange(RAYS) * 2 * np.pi / RAYS
    directions = np.stack([np.cos(angle), np.sin(angle), np.ones(RAYS)], axis=1)
    circle = near
    for _ in range(ROUNDS):
        off, weight = _find_steepest(relief, circle, directions)
        factors, _ = fit_robustly(directions, off[:, None], weight, lambda m: TUKEY * max(0.3, 1.48 * m), 10)
        move = factors[:, 0]  # along x and y, and of the radius, pixels
        most = 0.15 * circle.radius_px
        dx, dy, dr = np.clip(move, -most, most).tolist()
        circle = Circle(circle.x_px + dx, circle.y_px + dy, circle.radius_px + dr)
        if np.abs(move).max() < 0.02:
            break
    return circle


def _find_relief(change: Float32, circle: Circle) -> Float32:
    """Return the strength (H, W) of the change, counts, reduced to features of the size of a rim.

    The strength is the component of the change along the local mean colour.
    """
    fine, wide = max(1.0, FINE * circle.radius_px), SKIRT * circle.radius_px
    hue = gaussian_filter(change, (2 * fine, 2 * fine, 0))
    hue /= np.maximum(np.linalg.norm(hue, axis=2, keepdims=True), 1)
    strength = (gaussian_filter(change, (fine, fine, 0)) * hue).sum(axis=2)
    return np.asarray(strength - gaussian_filter(strength, wide), np.float32)


def _find_steepest(relief: Float32, circle: Circle, directions: Floats) -> tuple[Floats, Floats]:
    """Find the steepest drop of the relief on each ray.

    Return the offsets (RAYS,) of these points from the circle, pixels, and their weights (RAYS,).
    """
    u = np.arange(BAND[0], BAND[1] + STEP / 2, STEP)
    along = circle.radius_px * u[:, None]
    x, y = circle.x_px + along * directions[:, 0], circle.y_px + along * directions[:, 1]
    heights = map_coordinates(relief, [y - 0.5, x - 0.5], order=1, cval=np.nan)
    fall = gaussian_filter(-np.gradient(heights, STEP, axis=0), (1, 1.5), mode=("nearest", "wrap"))
    fall = np.where(np.isfinite(fall), fall, -np.inf)  # points beyond the image cannot be the steepest
    place = fall.argmax(axis=0)
    steepest = np.maximum(fall[place, np.arange(len(directions))], 0)
    ends = (place < 2) | (place > len(u) - 3)
    weight = np.minimum(steepest / (np.median(steepest) + 1e-9), 1.5) * ~ends
    return circle.radius_px * (u[place] - 1), weight


def fit_robustly(
    terms: NDArray[np.floating],
    values: NDArray[np.floating],
    first: NDArray[np.floating],
    scale: Callable[[float], float],
    rounds: int,
) -> tuple[Floats, Floats]:
    """Fit factors (K, C) of the terms (P, K) to the values (P, C). Return the factors and the robust weights (P,).

    A robust weight is the weight in `first` (P,) times Tukey's function of the residual. `scale` maps the median
    residual to the least residual with weight 0.
    """
    weight = first
    for _ in range(rounds):
        root = np.sqrt(weight)[:, None]
        factors = np.linalg.lstsq(terms * root, values * root, rcond=None)[0]
        missed = np.linalg.norm(values - terms @ factors, axis=1)
        typical = float(np.median(missed[first > 0])) if (first > 0).any() else np.inf
        weight = first * np.clip(1 - (missed / scale(typical)) ** 2, 0, None) ** 2
    return factors, np.asarray(weight, np.float64)
