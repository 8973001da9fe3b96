"""Balls that are pressed into a gel: the gel's surface, the slopes that the camera sees, and the contact's radius."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.gel import Float32, Gel, compute_smoothing, list_wave_numbers, make_solver

DEPTHS = np.linspace(0.12, 0.77, 131) ** 2  # in radii of the ball; the contacts' radii are about evenly spaced
EVERY = 5  # each of these depths is solved; the surfaces between are interpolated
PIXELS, WIDTH = 144, 5.2  # pixels along a side of the window in which balls are pressed, and its width in radii
SOLVED = 12  # iterations of the solver

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PressedBalls:
    """A ball that is pressed by DEPTHS into a gel, at distances `away_m` (K,), metres, from the ball's axis.

    `surface_m` (D, K) is the displacement of the gel's surface, and `slope` (D, K) the downward slope that the camera
    sees. `contact_m` (D,) are the radii of the contacts.
    """

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

    def find_depth(self, contact_m: float) -> int:
        """Return the index of the depth whose contact has the radius `contact_m`, metres."""
        return int(np.abs(self.contact_m - contact_m).argmin())


@lru_cache(maxsize=256)
def press_balls(gel: Gel, ball_m: float) -> PressedBalls:
    """Press a ball of `ball_m` metres into a gel."""
    pitch_m, middle = WIDTH * ball_m / PIXELS, PIXELS // 2
    away_m = np.asarray(pitch_m * np.arange(PIXELS - middle), float)
    if not gel.is_elastic:
        surface = np.maximum((DEPTHS * ball_m)[:, None] - _shape_ball(away_m, ball_m), 0)
        slope = np.asarray(-np.gradient(surface, pitch_m, axis=1), float)
        return PressedBalls(away_m, surface, slope, ball_m * np.sqrt(1 - (1 - DEPTHS) ** 2))
    bare = Gel(gel.thickness_m, gel.poisson)
    surface, pressure = _press(bare, ball_m)
    spectrum, padded = _transform(bare, ball_m)
    smoothing = compute_smoothing(np.hypot(*list_wave_numbers(padded, (pitch_m, pitch_m))), gel)
    # One row of the inverse transform: the sum along the other axis, then a transform along the row.
    wave = np.exp(2j * np.pi * middle * np.arange(padded[0]) / padded[0]) / padded[0]
    row = np.einsum("dkm,km->dm", spectrum, wave[:, None] * smoothing)
    visible = np.fft.irfft(row, padded[1])[:, middle:PIXELS]
    contact_m = pitch_m * np.sqrt((pressure > 0).sum(axis=(1, 2)) / np.pi)
    slope = np.asarray(-np.gradient(visible, pitch_m, axis=1), float)
    rows = (surface[:, middle, middle:].astype(float), slope, contact_m)
    return PressedBalls(away_m, *(_interpolate(values) for values in rows))


@lru_cache(maxsize=32)
def _press(gel: Gel, ball_m: float) -> tuple[Float32, Float32]:
    """Return the displacements and pressures (D', H, W) of a ball that is pressed by the solved depths into a gel."""
    pitch_m = WIDTH * ball_m / PIXELS
    away = np.asarray(pitch_m * np.abs(np.arange(PIXELS) - PIXELS // 2), float)
    below_m = _shape_ball(np.hypot(away[None], away[:, None]), ball_m)
    reach_m = ((DEPTHS[::EVERY] * ball_m)[:, None, None] - below_m).astype(np.float32)
    contact = make_solver(gel, below_m.shape, (pitch_m, pitch_m)).press(reach_m, SOLVED)
    return contact.displacement_m, contact.pressure


@lru_cache(maxsize=4)  # for the coatings of one gel
def _transform(gel: Gel, ball_m: float) -> tuple[NDArray[np.complex128], tuple[int, int]]:
    """Return the spectra (D', N, M / 2 + 1) of the displacements by `_press`, and their padded size (N, M)."""
    pitch_m = WIDTH * ball_m / PIXELS
    solver = make_solver(gel, (PIXELS, PIXELS), (pitch_m, pitch_m))
    spectrum = np.fft.rfft2(_press(gel, ball_m)[1], solver.padded) * solver.compliance
    return spectrum, solver.padded


def _interpolate(solved: Floats) -> Floats:
    """Return values (D, ...) at DEPTHS, given those (D', ...) at the solved depths."""
    at = np.arange(len(DEPTHS)) / EVERY
    low = np.minimum(at.astype(int), len(solved) - 2)
    part = (at - low).reshape(-1, *[1] * (solved.ndim - 1))
    return np.asarray(solved[low] + part * (solved[low + 1] - solved[low]))


def _shape_ball(away_m: Floats, ball_m: float) -> Floats:
    """Return the heights, metres, of a ball's underside over its deepest point, at distances from its axis, metres."""
    return np.asarray(ball_m - np.sqrt(np.maximum(ball_m**2 - away_m**2, 0)))
