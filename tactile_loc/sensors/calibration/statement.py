"""Checks what was stated about the ball and the scale against the photos: the ball's radius in pixels.

The gel's model predicts the colour profile of a press for any assumed radius of the ball (see `gel_fit`). The gel's
thickness and coating, the depths and the brightness are free. The share of the profiles that no such gel explains is
the misfit of this radius. A radius is possible if its misfit is at most LIMIT times the least one. Light presses hardly
show the radius, because in them the slope's sine is proportional to the distance from the centre for every radius.

Photos of two balls: the slopes per radius are fitted to the colours of all presses but one. The factor between the
labelled slopes of this press and the fitted ones is the same for all presses of one ball, but differs between balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.sensors.calibration import gel_fit
from tactile_loc.sensors.calibration.gel_fit import FEWEST, SEEN, BallImage, choose_depths, measure_profile, press_balls
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.circles import compare_colours, thin

LIMIT = 1.2  # largest misfit of a possible radius, in least misfits; right statements have at most 1.12
PRECISION = 0.02  # of the modelled profiles, as a share: few gels are tried
STEPS = 16  # distances per octave; assumed radii differ by two steps
OCTAVES = 1.5  # largest ratio of an assumed radius to the stated one
NEAREST, FARTHEST = 0.15, 3.0  # distances from a circle's centre at which colours are compared, in radii
SATURATIONS = np.array([0.0, 0.25, 0.5, 0.75])  # the odd change is s - k s^3 for the slope's sine s and one of these k
MOST_PROFILES, EVERY_DEPTH, EVERY_COATING = 20, 2, 2

INSIDE = 0.7  # part of a circle or of the ball in which slopes are compared, share of the radius
SAMPLES = 300  # pixels of a press
SMOOTHING_PX = 1.0  # of the colours, against the camera's noise
RIDGE = 1e-3
SPREAD = 0.13  # least standard deviation of the logarithms of the factors of two balls
FEWEST_FOR_TWO = 16  # presses


@dataclass(frozen=True)
class Statement:
    """What photos of presses show about the stated radius of the ball in pixels.

    The radius `ratio` fits best, and the radii from `least` to `most` are possible, all as multiples of the stated one.
    They are None if too few presses show it. `misfit` is that of the stated radius as a multiple of the least misfit.
    If the photos show two balls, `others` are the numbers of the presses of the rarer ball, and `larger` is its radius
    as a multiple of the other ball's.
    """

    ratio: float | None = None
    least: float | None = None
    most: float | None = None
    misfit: float | None = None
    others: tuple[int, ...] = ()
    larger: float = 1.0

    @property
    def is_possible(self) -> bool:
        """Whether the stated radius and scale can be right."""
        return self.misfit is None or self.misfit <= LIMIT

    @property
    def range(self) -> str:
        """The possible ratios in words."""
        if self.least is None or self.most is None:
            return "any"
        ratios = _list_ratios()
        low = f"{self.least:.2g}" + (" or less" if self.least <= ratios[0] else "")
        return f"{low} to {self.most:.2g}" + (" or more" if self.most >= ratios[-1] else "")

    def list_doubts(self, names: Sequence[str], ball_mm: float, mm_per_px: float) -> list[str]:
        """Return sentences about statements that cannot be right. `names` are those of the presses."""
        if self.others:
            listed = ", ".join(names[number] for number in self.others)
            return [
                f"the photos show two balls: in {len(self.others)} of {len(names)} photos, the ball is about "
                f"{self.larger:.2g} times as large as in the others ({listed}). Calibrate with photos of one ball, or "
                "state the radius of each press in presses.csv"
            ]
        if self.is_possible:
            return []
        fitting_mm = (self.ratio or 1) * ball_mm
        return [
            f"`ball_radius` or `mm_per_px` cannot be right: in the photos, the ball is about {self.ratio:.2g} times as "
            f"large as stated ({self.range} would fit). With {mm_per_px:.4g} mm per pixel, a radius of "
            f"{fitting_mm:.2g} mm fits best, instead of {ball_mm:.4g} mm. Check that the radius is not a diameter, and "
            "measure the size of a pixel again"
        ]

    def list_facts(self) -> list[str]:
        """Return a sentence about the radii that are possible, if the stated radius is one of them."""
        if self.misfit is None or not self.is_possible:
            return []
        return [
            f"the photos fit a ball of {self.range} times the stated radius; they do not show smaller errors of "
            "`ball_radius` and `mm_per_px`"
        ]

    def record(self) -> dict[str, Any]:
        """Return the ratios as JSON values, without the single presses."""
        return {name: getattr(self, name) for name in ("ratio", "least", "most", "misfit")}


UNCHECKED = Statement()


class _Profiles(NamedTuple):
    """Profiles (N, K) at distances of whole `steps` (K,) from the stated radius; weights are 0 where it is unknown."""

    seen: Float32
    weights: Float32
    steps: NDArray[np.int64]


def check_statement(images: Sequence[BallImage], untouched: Image) -> Statement:
    """Check the stated radii of balls against images of presses and an image of the untouched gel (H, W, 3)."""
    misfits = _measure_misfits(images, untouched)
    others, larger = find_other_ball(images, untouched)
    if misfits is None:
        return Statement(others=others, larger=larger)
    ratios = _list_ratios()
    best, stated = int(misfits.argmin()), float(misfits[len(ratios) // 2] / misfits.min())
    fits = misfits <= LIMIT * misfits.min()
    if stated > LIMIT:
        fits &= (ratios < 1) == (ratios[best] < 1)
    possible = ratios[fits]
    return Statement(float(ratios[best]), float(possible.min()), float(possible.max()), stated, others, larger)


def _list_ratios() -> Floats:
    half = int(OCTAVES * STEPS / 2)
    return np.asarray(2.0 ** (2 * np.arange(-half, half + 1) / STEPS))


def _measure_misfits(images: Sequence[BallImage], untouched: Image) -> Floats | None:
    """Return the misfit of each ratio, or None if there are too few profiles."""
    chosen = thin(sorted(images, key=lambda one: one.circle.radius_px), MOST_PROFILES)
    profiles = _collect_profiles(chosen, untouched)
    if profiles is None:
        return None
    half = int(OCTAVES * STEPS / 2)
    low, high = profiles.steps[0] - 2 * half, profiles.steps[-1] + 2 * half
    ball_m = images[0].ball_m
    places_m = ball_m * 2.0 ** (np.arange(low, high + 1) / STEPS)
    coatings_m = gel_fit.COATINGS_M[::EVERY_COATING].tolist()
    thicknesses_m = [*gel_fit.THICKNESSES_M.tolist(), np.inf]
    gels = [Gel(), *(Gel(t, coating_m=c) for t in thicknesses_m for c in coatings_m)]
    models = np.stack([press_balls(gel, ball_m).measure_change(places_m)[::EVERY_DEPTH] for gel in gels])
    models = models.astype(np.float32)
    count = len(profiles.steps)
    starts = [2 * (half - k) for k in range(-half, half + 1)]
    return np.array([_compare(np.ascontiguousarray(models[..., at : at + count]), profiles) for at in starts])


def _collect_profiles(images: Sequence[BallImage], untouched: Image) -> _Profiles | None:
    """Return the profiles of presses whose surroundings are in the image, or None if there are too few."""
    stated_px = [one.ball_m / one.pitch_m for one in images]
    radii = np.array([one.circle.radius_px for one in images]) / stated_px
    first = int(np.floor(STEPS * np.log2(NEAREST * radii.min())))
    last = int(np.ceil(STEPS * np.log2(FARTHEST * radii.max())))
    steps = np.arange(first, last + 1)
    away = 2.0 ** (steps / STEPS)
    seen = np.array(
        [measure_profile(one, untouched, away / r) for one, r in zip(images, radii, strict=True)], np.float32
    )
    inside = (away >= NEAREST * radii[:, None]) & (away <= FARTHEST * radii[:, None])
    known = inside & np.isfinite(seen)
    usable = known.sum(axis=1) > SEEN * inside.sum(axis=1)
    if usable.sum() < FEWEST:
        return None
    weights = (known * away).astype(np.float32)[usable]  # as if the distances were evenly spaced
    return _Profiles(np.where(known, seen, 0)[usable], weights, steps)


def _compare(models: Float32, profiles: _Profiles) -> float:
    """Return the least misfit of profiles to models (G, D, K) of gels, at any saturation."""
    gels, depths, count = models.shape
    flat = models.reshape(-1, count)
    seen, weights = profiles.seen, profiles.weights
    power = (weights * seen**2).sum(axis=1)
    first, third = flat @ (weights * seen).T, flat**3 @ (weights * seen).T
    second, fourth, sixth = (flat**n @ weights.T for n in (2, 4, 6))
    least = np.inf
    for k in SATURATIONS:
        along = (first - k * third).reshape(gels, depths, -1)
        norm = (second - 2 * k * fourth + k * k * sixth).reshape(gels, depths, -1)
        errors, _ = choose_depths(along, norm, power)
        least = min(least, float(errors.mean(axis=1).min()))
    return float(np.sqrt(max(least, 0) + PRECISION**2))


def find_other_ball(images: Sequence[BallImage], untouched: Image) -> tuple[tuple[int, ...], float]:
    """Return the numbers of the presses that show another ball than most, and how many times as large it is.

    There are none if all presses can show one ball.
    """
    if len(images) < FEWEST_FOR_TWO:
        return (), 1.0
    logs = np.log(_measure_factors(images, untouched))
    if logs.std() < SPREAD:
        return (), 1.0
    order = logs.argsort()
    sizes = range(2, len(logs) - 1)
    cut = min(sizes, key=lambda n: n * logs[order[:n]].var() + (len(logs) - n) * logs[order[n:]].var())
    rare, usual = sorted((order[:cut], order[cut:]), key=len)
    return tuple(sorted(rare.tolist())), float(np.exp(logs[rare].mean() - logs[usual].mean()))


def _measure_factors(images: Sequence[BallImage], untouched: Image) -> Floats:
    """Return a factor (N,) for each press: labelled slopes as multiples of those that the other presses predict."""
    height, width = untouched.shape[:2]
    rng = np.random.default_rng(0)
    sums, products, samples = [], [], []
    for one in images:
        ball_px = one.ball_m / one.pitch_m
        inside = one.circle.measure_distance_px((height, width)) < INSIDE * min(one.circle.radius_px, ball_px)
        y, x = np.divmod(rng.permutation(np.flatnonzero(inside))[:SAMPLES], width)
        change = compare_colours(one.image, untouched, SMOOTHING_PX)[y, x] / 64
        slopes = np.stack([x + 0.5 - one.circle.x_px, y + 0.5 - one.circle.y_px], axis=1) / ball_px
        terms = _stack_terms(change.astype(float), x / width - 0.5, y / height - 0.5)
        sums.append(terms.T @ terms)
        products.append(terms.T @ slopes)
        samples.append((terms, slopes - slopes.mean(axis=0)))
    normal, right, few = sum(sums), sum(products), RIDGE * len(images) * np.eye(len(sums[0]))
    factors = np.ones(len(images))
    for number, (terms, slopes) in enumerate(samples):
        fitted = terms @ np.linalg.solve(normal - sums[number] + few, right - products[number])
        factors[number] = (slopes**2).sum() / max(float((slopes * (fitted - fitted.mean(axis=0))).sum()), 1e-6)
    return factors / np.median(factors)


def _stack_terms(change: Floats, x: Floats, y: Floats) -> Floats:
    """Return terms (P, 66): colours and their products at each place, and their changes over the image."""
    linear = np.column_stack([change, np.ones(len(change))])
    pairs = np.stack([change[:, i] * change[:, j] for i in range(3) for j in range(i, 3)], axis=1)
    places = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=1)
    return np.column_stack([(linear[:, :, None] * places[:, None, :]).reshape(len(change), -1), pairs])
