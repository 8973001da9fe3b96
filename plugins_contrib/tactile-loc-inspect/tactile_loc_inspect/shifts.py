"""The test for a moved shape: do the touches fit clearly better if the surface near a place is shifted?

The pose of a touch may follow a shifted boss, and then hide the shift. So the pose and a shift of the surface in a
window are fitted together. The statistic is the drop of the misfit, as of a ratio of two likelihoods. Each window needs
one linear system. The best windows are fitted again with the model redrawn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from tactile_loc.plugin.helpers import exponential, invert, logarithm, transform_points

from tactile_loc_inspect.comparison import (
    ABOVE_M,
    CORRELATED_M2,
    PRIOR_STD,
    Bools,
    Floats,
    TouchImage,
    measure_roughness,
    smooth_imprints,
)

RADII_M = (1.5e-3, 2.2e-3, 3.2e-3)  # of the windows
WHOLE = 0.75  # share of the radius within which the surface moves whole
SPACING_M = 1e-3  # of the windows' middles
SCALE_M = 1e-5  # least error of an imprint
SHIFT_STD_M = 5e-4  # of a shift, before the touches
LEAST_PX = 0.5  # the error of an edge along the pixels may be a smaller shift
CANDIDATES, NEARLY = 5, 0.3  # windows that are fitted again, and the least share of the greatest drop
ROUNDS, STEP_M = 4, 3e-4  # of these fits, and the largest change of the shift in each
MOST_M, EXPLAINED = 8e-4, 0.7  # the largest shift, and the least share of the misfit that it explains
STEP_Z_M = 2e-5  # along the sensor's axis, for derivatives
FLOOR_M = 1e-5  # error of a shift that no averaging reduces


@dataclass(frozen=True, eq=False)
class Shift:
    """A place where the surface differs as if it was shifted.

    The surface within `radius_m` of `point_m` (3,) is shifted by `shift_m` (3,), with the standard deviation `std_m`,
    all metres in the object's frame. If it `explains` little of the difference, the shape differs in another way.
    `ratio` is the statistic: the root of the drop of the misfit.
    """

    point_m: Floats
    radius_m: float
    shift_m: Floats
    std_m: float = 0.0
    explains: bool = False
    ratio: float = 0.0

    def weigh(self, points_m: Floats) -> Floats:
        """Return the share of the shift that points (..., 3), metres, take part in."""
        return weigh_distances(np.linalg.norm(points_m - self.point_m, axis=-1), self.radius_m)

    def to_json(self) -> dict[str, Any]:
        """Return the shift as JSON values, in SI units."""
        values = {name: getattr(self, name) for name in ("radius_m", "std_m", "explains")}
        return {"point_m": self.point_m.tolist(), "shift_m": self.shift_m.tolist(), **values, "statistic": self.ratio}

    def describe(self) -> str:
        """Return the shift in words."""
        x, y, z = 1e3 * self.point_m
        where = f"the shape within {1e3 * self.radius_m:.1f} mm of ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        if not self.explains:
            return f"{where} differs from the model"
        along = ", ".join(f"{1e3 * part:.2f}" for part in self.shift_m)
        size_mm = 1e3 * np.linalg.norm(self.shift_m)
        return f"{where} is moved against the rest by {size_mm:.2f} +- {2e3 * self.std_m:.2f} mm: ({along})"


@dataclass(frozen=True, eq=False)
class ImprintResiduals:
    """The imprint of a touch beside the model's at a pose `T` (4, 4), at P compared pixels.

    `off_m` (P,) are the differences, metres, and `weights` (P,) their inverse variances. `J` (6, P) and `slopes`
    (3, P) are the derivatives of the model's imprint by a twist and by a motion of the surface in the object's frame.
    `points_m` (P, 3) are the surface, and `inside` (P,) marks contact. `H` (6, 6) and `g` (6,) are the information
    about the pose and its gradient, with the prior of the pose. `misfit` is the sum of squares.
    """

    T: Floats
    off_m: Floats
    weights: Floats
    J: Floats
    slopes: Floats
    points_m: Floats
    inside: Bools
    H: Floats
    g: Floats
    misfit: float


@dataclass(frozen=True, eq=False)
class Observation:
    """A touch, and its given pose (4, 4), which holds the fit."""

    image: TouchImage
    given: Floats

    def compare(self, T: Floats, moved: Shift | None = None) -> ImprintResiduals:
        """Return the residuals at a pose (4, 4), with a part of the surface shifted."""
        image, geometry, centre = self.image, self.image.geometry, self.image.geometry.gel_middle_m
        lower = exponential(np.array([0, 0, 0, 0, 0, STEP_Z_M]), centre) @ T
        drawn_m, pitch_m = image.draw(np.stack([T, lower])), geometry.pixel_pitch_m
        z_m = geometry.surface_m - image.press_m + np.minimum(drawn_m[0], image.press_m + ABOVE_M)
        points = transform_points(invert(T), geometry.backproject(z_m))
        if moved is not None:
            drawn_m = shift_depths(drawn_m, moved.weigh(points), T[:3, :3] @ moved.shift_m, pitch_m)
        seen_m, model_m = smooth_imprints(image, drawn_m)
        known = geometry.observed_mask & (np.maximum(seen_m, model_m[0]) > 0)
        down, right = np.gradient(model_m[0], pitch_m)
        # along the sensor, gradients of the image are those of a pose, too: steps of a pose miss edges along the pixels
        slopes = np.stack([-right, -down, (model_m[1] - model_m[0]) / STEP_Z_M])[:, known]
        arms = (geometry.backproject(z_m) - centre)[known]
        J = np.concatenate([np.cross(arms, slopes.T).T, slopes])
        variances = SCALE_M**2 + measure_roughness(model_m[0])[known] ** 2
        weights = pitch_m**2 / CORRELATED_M2 / variances
        off_m, away = (seen_m - model_m[0])[known], logarithm(T @ invert(self.given), centre) / PRIOR_STD
        H, g = (J * weights) @ J.T + np.diag(PRIOR_STD**-2.0), (J * weights) @ off_m - away / PRIOR_STD
        inside, misfit = (drawn_m[0] < image.cut_m)[known], float(weights @ off_m**2 + away @ away)
        return ImprintResiduals(T, off_m, weights, J, T[:3, :3].T @ slopes, points[known], inside, H, g, misfit)


def find_shift(observations: Sequence[Observation], poses: Sequence[Floats], least: float) -> Shift | None:
    """Return the shift that explains touches best, from their poses (4, 4), metres; None if there is none.

    The poses are those of least squares. A statistic below `least` is no shift.
    """
    residuals = [one.compare(T) for one, T in zip(observations, poses, strict=True)]
    axes = np.linalg.svd(np.mean([one.T[2, :3] for one in residuals], axis=0)[None])[2][1:].T  # across the touches
    touched = np.concatenate([one.points_m[one.inside] for one in residuals])
    if not len(touched):
        return None
    middles = touched[np.unique(np.floor(touched / SPACING_M), axis=0, return_index=True)[1]]
    each = [_reduce(residuals, middles, radius_m, axes) for radius_m in RADII_M]
    H, g = (np.concatenate([one[k] for one in each], axis=1) for k in (0, 1))
    shifts = np.linalg.solve(H.sum(axis=0) + np.eye(2) / SHIFT_STD_M**2, g.sum(axis=0)[..., None])[..., 0]
    drops = np.einsum("ka,ka->k", shifts, g.sum(axis=0))
    pitch_m = max(one.image.geometry.pixel_pitch_m for one in observations)
    drops = np.where(np.linalg.norm(shifts, axis=1) > LEAST_PX * pitch_m, np.maximum(drops, 0), 0)
    ratio = float(np.sqrt(drops.max()))
    if ratio < least:
        return None
    points, radii = np.tile(middles, (len(RADII_M), 1)), np.repeat(RADII_M, len(middles))
    left, fitted = drops >= NEARLY * drops.max(), list[tuple[float, Shift]]()
    while left.any() and len(fitted) < CANDIDATES:
        k = int(np.where(left, drops, -1).argmax())
        left &= np.linalg.norm(points - points[k], axis=1) > radii[k] / 2
        fitted.append(fit_shift(observations, residuals, Shift(points[k], float(radii[k]), np.zeros(3)), axes))
    misfit, best = min(fitted, key=lambda one: one[0])
    whole = sum(one.misfit - one.g @ np.linalg.solve(one.H, one.g) for one in residuals)
    explains = bool(np.linalg.norm(best.shift_m) < MOST_M and misfit < (1 - EXPLAINED) * whole)
    return dataclasses.replace(best, explains=explains, ratio=ratio)


def fit_shift(
    observations: Sequence[Observation], residuals: Sequence[ImprintResiduals], moved: Shift, axes: Floats
) -> tuple[float, Shift]:
    """Return the least misfit, and the shift along axes (3, 2) that has it."""
    best = (np.inf, moved)
    for _ in range(ROUNDS):
        H, g = (one.sum(axis=0)[0] for one in _reduce(residuals, moved.point_m[None], moved.radius_m, axes))
        H = H + np.eye(2) / SHIFT_STD_M**2
        step = np.linalg.solve(H, g - axes.T @ moved.shift_m / SHIFT_STD_M**2)
        step = axes @ step * min(1.0, STEP_M / float(np.linalg.norm(step)))
        changes = [(step @ one.slopes) * moved.weigh(one.points_m) for one in residuals]
        twists = [
            np.asarray(np.linalg.solve(one.H, one.g - (one.J * one.weights) @ change), np.float64)
            for one, change in zip(residuals, changes, strict=True)
        ]
        std_m = float(np.hypot(FLOOR_M, np.linalg.eigvalsh(H)[0] ** -0.5))
        moved = dataclasses.replace(moved, shift_m=moved.shift_m + step, std_m=std_m)
        residuals = [
            mine.compare(exponential(twist, mine.image.geometry.gel_middle_m) @ one.T, moved)
            for mine, one, twist in zip(observations, residuals, twists, strict=True)
        ]
        best = min(best, (sum(one.misfit for one in residuals), moved), key=lambda one: one[0])
    return best


def shift_depths(depths_m: Floats, share: Floats, shift_m: Floats, pitch_m: float) -> Floats:
    """Return depths (N, H, W), metres, moved by a share (H, W) of a shift (3,), metres, in the sensor's frame."""
    rows, columns = np.mgrid[: share.shape[0], : share.shape[1]]
    where = np.stack([rows - share * shift_m[1] / pitch_m, columns - share * shift_m[0] / pitch_m])
    moved_m = [map_coordinates(one, where, order=1, mode="nearest") for one in depths_m]
    return np.asarray(np.stack(moved_m) + share * shift_m[2])


def weigh_distances(distances_m: Floats, radius_m: float) -> Floats:
    """Return the share of a shift at distances from its middle: 1 up to WHOLE of the radius, then falling to 0."""
    x = np.clip((1 - distances_m / radius_m) / (1 - WHOLE), 0, 1)
    return np.asarray(x**2 * (3 - 2 * x))


def _reduce(
    residuals: Sequence[ImprintResiduals], middles_m: Floats, radius_m: float, axes: Floats
) -> tuple[Floats, Floats]:
    """Return the information (T, K, 2, 2) about the shifts of K windows, and its gradients (T, K, 2), without poses."""
    found_H, found_g = [], []
    for one in residuals:
        share = weigh_distances(np.linalg.norm(one.points_m - middles_m[:, None], axis=-1), radius_m)
        slopes, inverse = axes.T @ one.slopes, np.linalg.inv(one.H)
        weighted = slopes * one.weights
        across = np.stack([share @ (row * one.J).T for row in weighted], axis=1)
        products = (weighted[:, None] * slopes).reshape(4, -1)
        found_H.append((share**2 @ products.T).reshape(-1, 2, 2) - across @ inverse @ across.transpose(0, 2, 1))
        found_g.append(share @ (weighted * one.off_m).T - across @ (inverse @ one.g))
    return np.stack(found_H), np.stack(found_g)
