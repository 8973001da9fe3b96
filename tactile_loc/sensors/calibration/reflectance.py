"""The contacts of balls, found by one reflectance of the gel that all presses share.

A visible circle is not the contact: a shadow moves its centre and widens it. The reflectance is the change of colour as
a function of slope and place. It is the same in all presses, so it shows which circles are wrong. Two steps alternate:
the reflectance is fitted to the slopes under all balls, and each ball is moved until its colours follow the
reflectance. Pixels far from the fit, such as those in shadow, count little (Geman and McClure, 1987). Until the last
round, the reflectance is fitted in the contacts alone, where there are no shadows.

The reflectance is quadratic in the sines of the slope, and its factors are quadratic in place. Flat gel has no change.
A function with more freedom also fits shadows: it then keeps circles that are too wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Floats
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.gel_fit import BallImage, GelFit, fit_gel, press_balls
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.circles import Circle, compare_colours

ROUNDS, REWEIGHTED = 4, 4  # of both steps, and of the weights in a fit of the reflectance
REACH = 2.6  # distance from a circle's centre up to which pixels count, in radii
INNER = 0.9  # distance from a contact's centre up to which the reflectance is fitted, in radii, until the last round
EVERY = 3  # each of these rows and columns counts
SMOOTHING_PX = 1.0  # of the colours, against the camera's noise
FAR = 2.0  # residual at which a pixel counts a quarter, in standard deviations of the noise
RIDGE = 1e-6  # of the reflectance's factors, as a share of their mean weight
LEAST_NOISE = 0.1  # of the colours, counts
NUDGE = np.array([0.3, 0.3, 0.03])  # steps of the numerical derivatives: centre, pixels, and logarithm of the radius
FARTHEST = np.array([1.5, 1.5, 0.1])  # largest changes in one step
UNSURE = np.array([0.5, 0.5, 0.1])  # changes from the circle that count as much as one pixel's noise


class BallContact(NamedTuple):
    """Where a ball touches the gel: the contact's centre, pixels of the image, and its radius, metres."""

    x_px: float
    y_px: float
    radius_m: float


@dataclass(frozen=True)
class SeenBalls:
    """Images of pressed balls at the size of a sensor's `geometry`, and an image of the `untouched` gel (H, W, 3)."""

    images: Sequence[BallImage]
    untouched: Image
    geometry: SensorGeometry

    def fit(self, fit: GelFit) -> tuple[GelFit, list[BallContact]]:
        """Return the gel and the contacts of the balls, given a gel that was fitted to the visible circles.

        The gel is fitted again to the contacts. Its `contact` and `contacts` are shares of the visible circles' radii.
        """
        circles_m = [ball.circle.radius_px * ball.pitch_m for ball in self.images]
        contacts = [
            BallContact(ball.circle.x_px, ball.circle.y_px, share * radius_m)
            for ball, radius_m, share in zip(self.images, circles_m, fit.contacts, strict=True)
        ]
        contacts = self._find_contacts(contacts, fit.gel)
        moved = [
            ball._replace(circle=Circle(x_px, y_px, radius_m / share / ball.pitch_m))
            for ball, (x_px, y_px, radius_m), share in zip(self.images, contacts, fit.contacts, strict=True)
        ]
        again = fit_gel(moved, self.untouched)
        if again is None or not again.is_elastic:
            return fit, contacts
        contacts = self._find_contacts(contacts, again.gel)
        shares = [contact.radius_m / radius_m for contact, radius_m in zip(contacts, circles_m, strict=True)]
        return replace(again, contact=float(np.median(shares)), contacts=tuple(shares)), contacts

    def _find_contacts(self, start: Sequence[BallContact], gel: Gel) -> list[BallContact]:
        """Return the contacts of the balls, given guesses of them and the gel."""
        presses = []
        for ball, contact in zip(self.images, start, strict=True):
            change = compare_colours(ball.image, self.untouched, SMOOTHING_PX)
            presses.append(_Press.of(ball, np.asarray(change, float), contact, self.geometry))
        for left in reversed(range(ROUNDS)):
            reflectance, noise = _fit_reflectance(presses, gel, INNER if left else math.inf)
            for press in presses:
                press.move(reflectance, noise, gel)
        return [BallContact(x, y, math.exp(log_m)) for x, y, log_m in (press.found.tolist() for press in presses)]


@dataclass(eq=False)
class _Press:
    """The pixels (N) around a ball with a radius of `ball_m` metres.

    `at_m` (N, 2) are the pixels on the surface, metres from the image's corner, `place` (N, 6) the factors of their
    place, and `colours` (N, 3) the changes of colour, counts. `start` and `found` (3,) are the contact's centre,
    pixels, and the logarithm of its radius in metres; `per_m` (2,) are pixels per metre.
    """

    ball_m: float
    at_m: Floats
    place: Floats
    colours: Floats
    per_m: Floats
    start: Floats
    found: Floats

    @classmethod
    def of(cls, ball: BallImage, change: Floats, contact: BallContact, geometry: SensorGeometry) -> _Press:
        """Return the pixels around a ball's circle, given the change of colour (H, W, 3) and a guess of the contact."""
        circle, (height, width) = ball.circle, change.shape[:2]
        rows, columns = np.mgrid[:height:EVERY, :width:EVERY].reshape(2, -1)
        x, y = columns + 0.5, rows + 0.5
        near = np.hypot(x - circle.x_px, y - circle.y_px) < REACH * circle.radius_px
        at_px = np.stack([x, y], axis=1)[near]
        across, down = (2 * at_px / (width, height) - 1).T
        place = np.stack([np.ones(len(at_px)), across, down, across**2, across * down, down**2], axis=1)
        per_m, start = np.array(geometry.scale_at_surface), np.array([*contact[:2], math.log(contact.radius_m)])
        return cls(ball.ball_m, at_px / per_m, place, change[rows[near], columns[near]], per_m, start, start)

    def measure_terms(self, contact: Floats, gel: Gel) -> Floats:
        """Return the terms (N, K) of the reflectance if the ball touches the gel at a `contact` (3,)."""
        off_m = self.at_m - contact[:2] / self.per_m
        away_m = np.hypot(*off_m.T)
        lean = press_balls(gel, self.ball_m).interpolate_slope(away_m, math.exp(contact[2]))
        p, q = (-lean / np.sqrt(1 + lean**2) / np.maximum(away_m, 1e-9)) * off_m.T
        slopes = np.stack([p, q, p**2, p * q, q**2], axis=1)
        count = slopes.shape[1] * self.place.shape[1]
        return np.asarray((slopes[:, :, None] * self.place[:, None]).reshape(len(p), count))

    def is_within(self, reach: float) -> Bools:
        """Mark the pixels (N) within `reach` radii of the contact."""
        off_m = self.at_m - self.found[:2] / self.per_m
        return np.asarray(np.hypot(*off_m.T) < reach * math.exp(self.found[2]))

    def move(self, reflectance: Floats, noise: float, gel: Gel) -> None:
        """Move the contact by a step of Gauss and Newton towards the colours that a reflectance (K, 3) predicts."""
        off = self._miss(self.found, reflectance, gel)
        slopes = np.stack(
            [
                (self._miss(self.found + nudge, reflectance, gel) - self._miss(self.found - nudge, reflectance, gel))
                / (2 * nudge.sum())
                for nudge in np.diag(NUDGE)
            ],
            axis=-1,
        )
        weights, firm = _weigh(off, noise), (noise / UNSURE) ** 2
        hessian = np.einsum("n,nci,ncj->ij", weights, slopes, slopes, optimize=True) + np.diag(firm)
        gradient = np.einsum("n,nci,nc->i", weights, slopes, off, optimize=True) + firm * (self.found - self.start)
        self.found = self.found - np.clip(np.linalg.solve(hessian, gradient), -FARTHEST, FARTHEST)

    def _miss(self, contact: Floats, reflectance: Floats, gel: Gel) -> Floats:
        return np.asarray(self.colours - self.measure_terms(contact, gel) @ reflectance)


def _fit_reflectance(presses: Sequence[_Press], gel: Gel, reach: float) -> tuple[Floats, float]:
    """Return the factors (K, 3) of the reflectance, counts, and the standard deviation of the noise, counts.

    The pixels within `reach` radii of the contacts count.
    """
    near = [press.is_within(reach) for press in presses]
    terms = np.concatenate([one.measure_terms(one.found, gel)[some] for one, some in zip(presses, near, strict=True)])
    colours = np.concatenate([one.colours[some] for one, some in zip(presses, near, strict=True)])
    weights, noise = np.ones(len(terms)), LEAST_NOISE
    factors = np.zeros((terms.shape[1], 3))
    for _ in range(REWEIGHTED):
        weighted = terms * weights[:, None]
        equations = terms.T @ weighted
        equations += (RIDGE * np.trace(equations) / len(equations) + RIDGE) * np.eye(len(equations))
        factors = np.linalg.solve(equations, weighted.T @ colours)
        off = colours - terms @ factors
        noise = max(1.48 * float(np.median(np.sqrt((off**2).mean(axis=1)))), LEAST_NOISE) if len(off) else LEAST_NOISE
        weights = _weigh(off, noise)
    return factors, noise


def _weigh(off: Floats, noise: float) -> Floats:
    """Return the weights (N,) of pixels with residuals (N, 3), counts, given the standard deviation of the noise."""
    return np.asarray(1 / (1 + (off**2).mean(axis=1) / (FAR * noise) ** 2) ** 2)
