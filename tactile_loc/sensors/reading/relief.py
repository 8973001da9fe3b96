"""Measures the surface of a curved gel from presses of a ball all over the gel.

In the middle of a ball's imprint, the slope equals that of the untouched gel. Elsewhere in the imprint, the ball's
shape determines how the slope differs from the slope in the middle. The imprints therefore relate differences of colour
to differences of slope. If the lamps are distant, equal colours mean equal slopes everywhere. The colours of the
untouched gel then determine the gel's slopes.

Two things are learned together: a network from colours to slopes, and the gel's surface as a polynomial in x and y.
Colours do not determine the tilt of the whole surface, so the gel is assumed to be level in the middle of the image.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from torch import nn

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.gel_fit import BallImage
from tactile_loc.sensors.calibration.labels import Float32, Image
from tactile_loc.sensors.calibration.presses import PressFolder

DEGREES = range(2, 5)  # degrees of the polynomial's terms; lower degrees are a plane
EXPONENTS = [(degree - j, j) for degree in DEGREES for j in range(degree + 1)]
HIDDEN, STEPS, PIXELS = 32, 400, 2048  # units of each hidden layer, training steps, and pixels in each step
RATE, RELIEF_RATE, DECAY = 3e-3, 2e-2, 0.992  # learning rates of network and polynomial, and their factor per step
SMOOTHING_PX = 1.0  # standard deviation of the smoothing of the colours, against noise
INNER = 0.95  # share of a visible circle's radius that is used: the rim is left out
STEEPEST = 0.15  # limit of a ball's slope: least height above the ball's equator, share of the ball's radius
OUTLIER = 0.1  # error of the slope above which the loss is linear
FEWEST = 8  # fewest presses of a ball
UNIT_M = 1e-3  # unit of the polynomial's coefficients


class _Pixels(NamedTuple):
    """Pixels in balls' imprints or of the untouched gel.

    `colours` (P, 3) are standardized. `offset_m` (P, 2) is the offset from the imprint's middle, metres. `radius_m`
    (P, 1) is the ball's radius, metres, or NaN for the untouched gel. `slopes` (P, 2, K) are the slopes of the
    polynomial's terms: at the pixel for the untouched gel, and otherwise in the imprint's middle.
    """

    colours: torch.Tensor
    offset_m: torch.Tensor
    radius_m: torch.Tensor
    slopes: torch.Tensor


def learn_relief(presses: PressFolder, seed: int = 0, progress: Progress | None = None) -> Float32:
    """Return the relief (H, W), metres, of the gel on which balls were pressed. The relief is 0 at its highest point.

    Raises CalibrationError when there are fewer than FEWEST presses of a ball.
    """
    balls = presses.read_balls()
    if len(balls) < FEWEST:
        raise CalibrationError(
            f"there are {len(balls)} presses of a ball; give at least {FEWEST}, all over the gel, to learn a curved "
            "surface"
        )
    terms, slopes = _evaluate_terms(presses.geometry)
    pixels = _collect_pixels(balls, presses, slopes, np.random.default_rng(seed))
    coefficients = _fit_polynomial(pixels, seed, progress or Progress())
    relief_m = terms @ coefficients * UNIT_M
    return (relief_m - relief_m.max()).astype(np.float32)


def _fit_polynomial(pixels: _Pixels, seed: int, progress: Progress) -> NDArray[np.float64]:
    """Fit network and polynomial to the pixels, and return the polynomial's coefficients (K,), in UNIT_M."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        layers = [nn.Linear(3, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, 2)]
        network, linear = nn.Sequential(*layers), nn.Linear(3, 2)
    generator = torch.Generator().manual_seed(seed)
    relief = torch.zeros(pixels.slopes.shape[-1], requires_grad=True)
    learned = [*network.parameters(), *linear.parameters()]
    optimizer = torch.optim.Adam([{"params": learned, "lr": RATE}, {"params": [relief], "lr": RELIEF_RATE}])
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, DECAY)
    with progress.task("learning the gel's surface", STEPS) as advance:
        for _ in range(STEPS):
            some = torch.randint(len(pixels.colours), (PIXELS,), generator=generator)
            colours, wanted = pixels.colours[some], _predict_slopes(_Pixels(*(part[some] for part in pixels)), relief)
            loss = nn.functional.huber_loss(network(colours) + linear(colours), wanted, delta=OUTLIER)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            advance(1)
    return relief.detach().numpy().astype(float)


def _predict_slopes(pixels: _Pixels, relief: torch.Tensor) -> torch.Tensor:
    """Return the slopes (P, 2) of the gel's surface at the pixels, given the relief's coefficients (K,)."""
    rest = -(pixels.slopes @ relief)
    untouched = torch.isnan(pixels.radius_m)
    radius_m = torch.where(untouched, 1.0, pixels.radius_m)
    off_m = pixels.offset_m - rest * radius_m / torch.sqrt(1 + rest.square().sum(-1, keepdim=True))
    below_m = torch.sqrt((radius_m**2 - off_m.square().sum(-1, keepdim=True)).clamp(min=1e-12))
    ball = -off_m / torch.maximum(below_m, STEEPEST * radius_m)
    return torch.where(untouched, rest, ball)


def _collect_pixels(
    balls: list[BallImage], presses: PressFolder, slopes: NDArray[np.float64], rng: np.random.Generator
) -> _Pixels:
    """Return all pixels in the balls' imprints, and half as many pixels of the untouched gel."""
    geometry, (sx, sy) = presses.geometry, presses.geometry.scale_at_surface
    x, y = np.meshgrid(*geometry.pixel_slopes)
    parts = []
    for image, circle, ball_m, pitch_m in balls:
        cx, cy = (circle.x_px - geometry.cx) / sx, (circle.y_px - geometry.cy) / sy
        inside = np.hypot(x - cx, y - cy) < INNER * circle.radius_px * pitch_m
        row, column = np.unravel_index(np.hypot(x - cx, y - cy).argmin(), x.shape)
        at = np.broadcast_to(slopes[row, column], (int(inside.sum()), *slopes.shape[2:]))
        off_m = np.stack([x[inside] - cx, y[inside] - cy], axis=-1)
        parts.append((_smooth_colours(image)[inside], off_m, np.full((len(off_m), 1), ball_m), at))
    some = rng.permutation(x.size)[: sum(len(part[0]) for part in parts) // 2]
    untouched = _smooth_colours(presses.background).reshape(-1, 3)[some]
    rest = slopes.reshape(-1, *slopes.shape[2:])[some]
    parts.append((untouched, np.zeros((len(some), 2)), np.full((len(some), 1), np.nan), rest))
    colours, *others = (np.concatenate(part) for part in zip(*parts, strict=True))
    colours = (colours - colours.mean(axis=0)) / colours.std(axis=0).clip(1e-6)
    return _Pixels(*(torch.from_numpy(part.astype(np.float32)) for part in (colours, *others)))


def _smooth_colours(image: Image) -> NDArray[np.float64]:
    return np.asarray(gaussian_filter(image.astype(float), (SMOOTHING_PX, SMOOTHING_PX, 0), mode="nearest"))


def _evaluate_terms(geometry: SensorGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the polynomial's terms (H, W, K), and their slopes along x and y (H, W, 2, K), all unitless."""
    k = geometry.surface_m if geometry.is_pinhole else 1.0
    x, y = (k * side for side in np.meshgrid(*geometry.pixel_slopes))
    half_m = float(np.hypot(x, y).max())
    x, y = x / half_m, y / half_m
    terms = np.stack([x**i * y**j for i, j in EXPONENTS], axis=-1)
    along_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in EXPONENTS], axis=-1)
    along_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in EXPONENTS], axis=-1)
    return terms, np.stack([along_x, along_y], axis=-2) * UNIT_M / half_m
