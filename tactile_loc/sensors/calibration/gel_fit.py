"""The gel's thickness and coating, and the depths of balls, fitted to the colours around presses of balls.

The colour change at a point and that at the opposite point of a ball's imprint differ because the gel slopes the
opposite ways. Half of this difference, the odd change, is proportional to the sine of the slope, under any light. So
it shows how the slope rises in the contact and falls around it, before anything is learned about the light. An elastic
layer with a coating predicts the same profile (see `core.sensing.gel`). The contact's edge is where the slope falls
most steeply, not where it is largest.

The thickness and the coating are effective ones: they also absorb everything in which the gel is not a linear layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates
from scipy.special import j1

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.gel import Gel, compute_compliance, compute_smoothing
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Image, PressLabel
from tactile_loc.sensors.reading.circles import TUKEY, Circle, compare_colours, fit_robustly

DEPTHS = np.linspace(0.12, 1.22, 171) ** 2  # in radii of the ball; the contacts' radii are about evenly spaced
RINGS, WIDTH = 72, 2.6  # rings of equal width around a ball's axis, and the radius of them all, in radii of the ball
WAVES = np.concatenate([[0.0], np.geomspace(1e-3, 0.1, 9), np.arange(0.13, 40.0, 0.13)])  # borders, radians per ring
NODES = 8  # of the integration between two of these wave numbers
EDGE = 0.11  # part of the outermost pressed ring that does not touch: so the contact on a half-space is right
THICKNESSES_M = 1e-3 * np.geomspace(1.5, 24.0, 9)  # tried; errors of gels between them are interpolated
COATINGS_M = 1e-3 * np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
SURE = 0.02  # standard deviation of the contact's share of the circle, at least
DETERMINED = 0.85  # largest radius of a contact that shows the press depth, in radii of the ball
NEVER = 1e3  # height beside a ball, in its radii, that no press reaches
VALUES = 3  # independent values in a profile: its rise, its peak and its fall; neighbouring distances are alike
FINE = 65, 49  # interpolated thicknesses and coatings
FEWEST = 3  # presses
REACH = np.arange(0.15, 3.01, 0.05)  # distances from a circle's centre at which colours are compared, in radii
ANGLES = 120  # compared directions, an even number
SEEN = 0.5  # share of the directions that must be in the image
SMOOTHING_PX = 0.7  # of the colours, against the camera's noise
UNSURE = 0.1  # standard deviation of the brightness between presses, as a share
ROUNDS = 5  # estimates of the brightness

AnyFloats = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class PressedBalls:
    """A ball of radius `ball_m` pressed by DEPTHS into a gel, at distances `away_m` (K,), metres, from its axis.

    `surface_m` (D, K) is the displacement of the gel's surface, and `slope` (D, K) the downward slope that the camera
    sees. `contact_m` (D,) are the radii of the contacts.
    """

    ball_m: float
    away_m: Floats
    surface_m: Floats
    slope: Floats
    contact_m: Floats

    def measure_change(self, away_m: Floats) -> Floats:
        """Return the odd change of colour (D, N), up to a factor, at distances (N,), metres."""
        at = np.clip(away_m / self.away_m[1], 0, len(self.away_m) - 1.001)
        low = at.astype(int)
        lean = self.slope[:, low] + (at - low) * (self.slope[:, low + 1] - self.slope[:, low])
        return np.asarray(lean / np.sqrt(1 + lean**2))

    def interpolate_slope(self, away_m: Floats, contact_m: float) -> Floats:
        """Return the slope (N,) at distances (N,), metres, when the contact's radius is `contact_m`, metres."""
        growing = np.maximum.accumulate(self.contact_m) + 1e-9 * np.arange(len(self.contact_m))
        at = float(np.interp(contact_m, growing, np.arange(len(growing))))
        low = min(int(at), len(growing) - 2)
        profile = self.slope[low] + (at - low) * (self.slope[low + 1] - self.slope[low])
        return np.interp(away_m, self.away_m, profile, right=0.0)

    def find_depth(self, contact_m: float) -> int:
        """Return the index of the depth whose contact has the radius `contact_m`, metres."""
        return int(np.abs(self.contact_m - contact_m).argmin())


@lru_cache(maxsize=256)
def press_balls(gel: Gel, ball_m: float) -> PressedBalls:
    """Press a ball of `ball_m` metres into a gel. The pressure is constant in each of the RINGS."""
    pitch_m = WIDTH * ball_m / RINGS
    away_m = np.asarray(pitch_m * np.arange(RINGS), float)
    if not gel.is_elastic:
        below_m = ball_m - np.sqrt(np.maximum(ball_m**2 - away_m**2, 0))
        below_m[away_m >= ball_m] = NEVER * ball_m
        surface = np.maximum((DEPTHS * ball_m)[:, None] - below_m, 0)
        slope = np.asarray(-np.gradient(surface, pitch_m, axis=1), float)
        return PressedBalls(ball_m, away_m, surface, slope, ball_m * np.sqrt(1 - (1 - np.minimum(DEPTHS, 1)) ** 2))
    bare = Gel(gel.thickness_m, gel.poisson)
    depths_m, pressures, contacts_m = _press_rings(bare, ball_m)
    at = np.interp(DEPTHS * ball_m, depths_m, np.arange(len(depths_m)))
    low = np.minimum(at.astype(int), len(depths_m) - 2)
    pressure = pressures[low] + (at - low)[:, None] * (pressures[low + 1] - pressures[low])
    slope = np.asarray(-np.gradient(pressure @ _respond(gel, pitch_m).T, pitch_m, axis=1), float)
    contact_m = np.interp(DEPTHS * ball_m, depths_m, contacts_m)
    return PressedBalls(ball_m, away_m, pressure @ _respond(bare, pitch_m).T, slope, contact_m)


def _press_rings(gel: Gel, ball_m: float) -> tuple[Floats, Floats, Floats]:
    """Return depths (N,), metres, the pressures (N, RINGS) in a gel under a ball, and the contacts' radii (N,), metres.

    At each depth but the last, one more ring begins to touch. The last depth is larger than any in DEPTHS. Between two
    depths, all pressures are linear functions of the depth.
    """
    pitch_m = WIDTH * ball_m / RINGS
    rims_m = pitch_m * (np.arange(RINGS + 1) - 0.5).clip(0)
    inside = np.diff(-(np.maximum(ball_m**2 - rims_m**2, 0) ** 1.5)) / 3  # the integral of the ball's height
    below_m = ball_m - inside / (np.diff(rims_m**2) / 2)
    response, most = _respond(gel, pitch_m), int((rims_m[1:] <= ball_m).sum())
    depths, pressures = [0.0], [np.zeros(RINGS)]
    for touching in [*range(2, most + 1), most]:
        some = np.s_[:touching]
        flat, ball = np.linalg.solve(response[some, some], np.stack([np.ones(touching), below_m[some]], axis=1)).T
        last = len(depths) == most
        depths.append(2 * DEPTHS[-1] * ball_m if last else ball[-1] / flat[-1])  # or no pressure in the outermost ring
        pressures.append(np.pad(depths[-1] * flat - ball, (0, RINGS - touching)))
    contacts_m = pitch_m * (np.array([EDGE, *range(1, most), most]) - EDGE)
    return np.array(depths), np.array(pressures), contacts_m


def _respond(gel: Gel, pitch_m: float) -> Floats:
    """Return the mean displacements (RINGS, RINGS), metres, below the coating in a ring under pressure in another ring.

    Each is an integral over all wave numbers, by Gauss and Legendre.
    """
    k, weights, waves, areas = _list_waves()
    q, thickest_m = k / pitch_m, 1e4 * RINGS * pitch_m  # as good as a half-space
    seen = compute_compliance(q, Gel(min(gel.thickness_m or 0, thickest_m), gel.poisson)) * compute_smoothing(q, gel)
    return np.asarray((waves * (weights * seen / k)) @ waves.T / areas[:, None])


@lru_cache(maxsize=1)
def _list_waves() -> tuple[Floats, Floats, Floats, Floats]:
    """Return wave numbers (Q,), their weights (Q,), the rings' transforms (RINGS, Q), and areas (RINGS,) over 2 pi.

    The unit of length is the width of a ring.
    """
    nodes, shares = np.polynomial.legendre.leggauss(NODES)
    middle, half = (WAVES[1:] + WAVES[:-1]) / 2, np.diff(WAVES) / 2
    k = (middle[:, None] + half[:, None] * nodes).ravel()
    rims = np.arange(RINGS) + 0.5
    discs = rims[:, None] * j1(rims[:, None] * k)
    weights = (half[:, None] * shares).ravel()
    return k, weights, np.diff(discs, axis=0, prepend=0), np.diff(rims**2, prepend=0) / 2


def label_elastic_ball(
    geometry: SensorGeometry, centre_px: tuple[float, float], contact_m: float, ball: PressedBalls
) -> PressLabel:
    """Return the label of a ball on an elastic gel, which touches the gel within `contact_m` metres from its axis.

    The indentation is that of the gel's surface, and the slope is what the camera sees through the coating. The label
    is known everywhere. It is absolute only up to DETERMINED radii, because a deeper press hardly widens the contact.
    `centre_px` (x, y) is the axis in the image, pixels.
    """
    height, width = geometry.shape
    sx, sy = geometry.scale_at_surface
    x = ((np.arange(width) + 0.5 - centre_px[0]) / sx)[None, :]
    y = ((np.arange(height) + 0.5 - centre_px[1]) / sy)[:, None]
    away, pressed = np.hypot(x, y), ball.find_depth(contact_m)
    indentation = np.interp(away, ball.away_m, ball.surface_m[pressed], right=0.0)
    lean = np.interp(away, ball.away_m, ball.slope[pressed], right=0.0)
    slope = -np.stack([x * lean, y * lean], axis=-1) / np.maximum(away, 1e-9)[..., None]
    contact = away < ball.contact_m[pressed]
    known, absolute = np.ones(geometry.shape, bool), contact_m < DETERMINED * ball.ball_m
    return PressLabel(indentation.astype(np.float32), slope.astype(np.float32), contact, known, absolute)


class BallImage(NamedTuple):
    """An image (H, W, 3) of a pressed ball, its visible circle, pixels, the ball's radius, and a pixel's width, m."""

    image: Image
    circle: Circle
    ball_m: float
    pitch_m: float


@dataclass(frozen=True)
class GelFit:
    """A gel's effective thickness with its standard deviation, and its coating, metres.

    The standard deviation has two parts: other thicknesses that explain the same presses, and other presses.
    `contact` is the contact's radius as a share of the visible circle's radius (median over the presses), and
    `contacts` has this share for each press. `rms` is the difference between seen and modelled profiles, as a share of
    the profiles; `rigid_rms` is that of a rigid gel.
    """

    thickness_m: float
    std_m: float
    coating_m: float
    contact: float
    rms: float
    rigid_rms: float
    contacts: tuple[float, ...] = ()

    @property
    def is_elastic(self) -> bool:
        """Whether an elastic gel explains the profiles better than a rigid one."""
        return self.rms < self.rigid_rms

    @property
    def gel(self) -> Gel:
        """The gel."""
        return Gel(self.thickness_m, coating_m=self.coating_m)

    def explain(self) -> str:
        """Return the elasticity and the errors of the fit in words."""
        shares = f"{100 * self.rms:.0f} % of the colour profiles unexplained, a rigid gel {100 * self.rigid_rms:.0f} %"
        if not self.is_elastic:
            return f"the gel is taken for rigid: an elastic gel leaves {shares}"
        return (
            f"the gel is elastic: effective thickness {1e3 * self.thickness_m:.1f} mm (standard deviation "
            f"{1e3 * self.std_m:.1f} mm), coating {1e3 * self.coating_m:.2f} mm; it leaves {shares}"
        )

    def record(self) -> dict[str, Any]:
        """Return the fit as JSON values, without the single presses."""
        values = asdict(self)
        del values["contacts"]
        return values


def fit_gel(images: Sequence[BallImage], untouched: Image, progress: Progress | None = None) -> GelFit | None:
    """Fit a gel to images of pressed balls and an image of the untouched gel (H, W, 3).

    Return None if fewer than FEWEST presses are in the image.
    """
    every = [(one, measure_profile(one, untouched)) for one in images]
    usable = [np.isfinite(profile).sum() > len(REACH) // 2 and np.nanmax(profile) > 0 for _, profile in every]
    profiles = [press for press, use in zip(every, usable, strict=True) if use]
    if len(profiles) < FEWEST:
        return None
    errors = np.empty((len(THICKNESSES_M), len(COATINGS_M), len(profiles)))
    with (progress or Progress()).task("measuring the gel", len(THICKNESSES_M)) as advance:
        for row, one_m in enumerate(THICKNESSES_M):
            for column, coating_m in enumerate(COATINGS_M):
                errors[row, column], _ = _compare(profiles, Gel(float(one_m), coating_m=float(coating_m)))
            advance(1)
    log_m, coating_m, unknown = _weigh_gels(errors)
    count = len(profiles)
    without = np.array([_weigh_gels(np.delete(errors, press, axis=2))[0] for press in range(count)])
    varied = float(np.sqrt((count - 1) * without.var()))  # the jackknife's standard deviation
    best_m = float(np.exp(log_m))
    std_m = best_m * float(np.hypot(unknown, varied))
    final, shares = _compare(profiles, Gel(best_m, coating_m=coating_m))
    rigid, _ = _compare(profiles, Gel())
    contacts = _smooth_shares(images, np.array(usable), shares)
    contact = float(np.median(shares))
    rms, rigid_rms = float(np.sqrt(final.mean())), float(np.sqrt(rigid.mean()))
    return GelFit(best_m, std_m, coating_m, contact, rms, rigid_rms, contacts)


def _smooth_shares(images: Sequence[BallImage], usable: NDArray[np.bool_], shares: Floats) -> tuple[float, ...]:
    """Return the contact's share of the circle for each press, given that of `usable` presses.

    The share falls with the circle's radius, because a contact is at most as wide as the ball.
    """
    radii = np.array([one.circle.radius_px * one.pitch_m / one.ball_m for one in images])
    terms = np.column_stack([np.ones(len(radii)), radii])
    least, first = 2 * SURE, np.ones(usable.sum())
    trend, _ = fit_robustly(terms[usable], shares[:, None], first, lambda m: max(least, TUKEY * 1.48 * m), 10)
    return tuple(np.clip((terms @ trend)[:, 0], shares.min(), shares.max()).tolist())


def measure_profile(press: BallImage, untouched: Image, reach: Floats = REACH) -> Floats:
    """Return the root mean square of the odd colour change (K,), counts, at `reach` radii; NaN beyond the image."""
    change = compare_colours(press.image, untouched, SMOOTHING_PX)
    angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
    away = press.circle.radius_px * reach[:, None]
    places = [press.circle.y_px + away * np.sin(angle) - 0.5, press.circle.x_px + away * np.cos(angle) - 0.5]
    seen = np.stack([map_coordinates(change[..., c], places, order=1, cval=np.nan) for c in range(3)])
    odd = 0.5 * (seen - np.roll(seen, ANGLES // 2, axis=2))
    known = np.isfinite(odd).all(axis=0)
    total = np.where(known, (odd**2).sum(axis=0), 0).sum(axis=1)
    count = known.sum(axis=1)
    return np.asarray(np.where(count > SEEN * ANGLES, np.sqrt(total / np.maximum(3 * count, 1)), np.nan))


def _compare(profiles: Sequence[tuple[BallImage, Floats]], gel: Gel) -> tuple[Floats, Floats]:
    """Return the squared errors (N,) of profiles, as shares, and the contact's radii (N,) in radii of the circles."""
    balls = [press_balls(gel, press.ball_m) for press, _ in profiles]
    along, norm = np.empty((2, len(DEPTHS), len(profiles)))
    power = np.empty(len(profiles))
    for n, ((press, profile), ball) in enumerate(zip(profiles, balls, strict=True)):
        known = np.isfinite(profile)
        model = ball.measure_change(REACH[known] * press.circle.radius_px * press.pitch_m)
        along[:, n], norm[:, n] = model @ profile[known], (model**2).sum(axis=1)
        power[n] = profile[known] @ profile[known]
    errors, chosen = choose_depths(along, norm, power)
    widths_m = [press.circle.radius_px * press.pitch_m for press, _ in profiles]
    contacts = [ball.contact_m[k] / width_m for ball, k, width_m in zip(balls, chosen, widths_m, strict=True)]
    return np.asarray(errors, float), np.array(contacts)


def choose_depths(along: AnyFloats, norm: AnyFloats, power: AnyFloats) -> tuple[AnyFloats, NDArray[np.intp]]:
    """Return the least squared errors (..., N) of profiles, as shares, and the numbers (..., N) of the modelled depths.

    `along` (..., D, N) are the products of the models and the profiles, `norm` (..., D, N) the squares of the models,
    and `power` (N,) those of the profiles. A model's factor, the brightness, is nearly the same in all presses.
    """
    free = near = along / np.maximum(norm, 1e-12)
    for _ in range(ROUNDS):
        errors = 1 + near * (near * norm - 2 * along) / power
        chosen = errors.argmin(axis=-2)[..., None, :]
        usual = np.median(np.take_along_axis(free, chosen, axis=-2), axis=-1, keepdims=True)
        near = np.where(usual > 0, np.clip(free, usual * np.exp(-UNSURE), usual * np.exp(UNSURE)), free)
    return np.take_along_axis(errors, chosen, axis=-2)[..., 0, :], chosen[..., 0, :]


def _weigh_gels(errors: Floats) -> tuple[float, float, float]:
    """Return a gel from the errors (T, C, N) of profiles by THICKNESSES_M and COATINGS_M.

    The result is the mean logarithm of the thickness, metres, the mean coating, metres, and the standard deviation of
    that logarithm. A profile counts as VALUES values with normal errors of unknown size, so the likelihood of a gel is
    its mean error to the power of -VALUES N / 2. Thick gels explain the profiles almost equally well.
    """
    logs = np.log(THICKNESSES_M)
    spline = RectBivariateSpline(logs, COATINGS_M, np.log(errors.mean(axis=2)), kx=2, ky=2)
    log_m, coating_m = np.linspace(logs[0], logs[-1], FINE[0]), np.linspace(0, COATINGS_M[-1], FINE[1])
    missed = spline(log_m, coating_m)
    weights = np.exp(-0.5 * VALUES * errors.shape[2] * (missed - missed.min()))
    weights /= weights.sum()
    by_thickness = weights.sum(axis=1)
    mean = float(by_thickness @ log_m)
    return mean, float(weights.sum(axis=0) @ coating_m), float(np.sqrt(by_thickness @ (log_m - mean) ** 2))
