"""The effective thickness of a gel, estimated from presses of balls.

A ball's visible circle gives its position, and the surface read in the circle gives its depth. The gel around the ball
then depends only on the layer's thickness. This thickness is an effective one: it also absorbs how the estimator reads
the slope around the ball, and everything in which the gel is not a linear layer.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.estimator import GelEstimator
from tactile_loc.calibration.presses import PressFolder
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

THICKNESSES_M = 1e-3 * np.geomspace(1.0, 24.0, 17)  # tried, before the least is interpolated
CORE = 0.6  # share of the circle in which the ball's depth is measured
AROUND_M = 2.5e-3  # distance from the circle up to which surfaces are compared
MOST = 12  # presses that are compared
FEWEST = 3

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GelFit:
    """A gel's effective thickness, its standard deviation, and the RMS difference between read and modelled surfaces.

    `rigid_rms_m` is that difference for a rigid gel. All are in metres.
    """

    thickness_m: float
    std_m: float
    rms_m: float
    rigid_rms_m: float


def estimate_gel(
    estimator: GelEstimator, presses: PressFolder, poisson: float = Gel().poisson, progress: Progress | None = None
) -> GelFit | None:
    """Estimate the thickness of the gel from at most MOST presses of balls; return None if there are fewer than FEWEST.

    The standard deviation is that of the mean over the presses.
    """
    numbers = [number for number, row in enumerate(presses.rows) if row.kind == "ball"]
    numbers = numbers[:: -(-len(numbers) // MOST)] if numbers else []
    if len(numbers) < FEWEST or presses.geometry.is_curved:
        return None
    errors, rigid = [], []
    with (progress or Progress()).task("measuring the gel", len(numbers)) as advance:
        for number in numbers:
            found = _compare_press(estimator, presses, number, poisson)
            if found is not None:
                errors.append(found[0])
                rigid.append(found[1])
            advance(1)
    if len(errors) < FEWEST:
        return None
    each_m = np.array([_find_least(one) for one in errors])
    mean_square = np.mean(errors, axis=0)
    thickness_m = _find_least(mean_square)
    nearest = int(np.abs(np.log(THICKNESSES_M / thickness_m)).argmin())
    return GelFit(
        thickness_m, float(each_m.std(ddof=1) / np.sqrt(len(each_m))),
        float(np.sqrt(mean_square[nearest])), float(np.sqrt(np.mean(rigid))),
    )  # fmt: skip


def _compare_press(
    estimator: GelEstimator, presses: PressFolder, number: int, poisson: float
) -> tuple[Floats, float] | None:
    """Return the mean squared differences (T,), m^2, for each thickness, and for a rigid gel; None without a depth."""
    geometry = presses.geometry
    (x_m, y_m), circle_m, ball_m = presses.place_circle(number)
    read_m = estimator.read_indentation(presses.images[number])
    away_m = _measure_distances(geometry, x_m, y_m)
    below_m = np.where(away_m < ball_m, ball_m - np.sqrt(np.maximum(ball_m**2 - away_m**2, 0)), ball_m)
    core = (away_m < CORE * circle_m) & geometry.observed_mask
    if not core.any():
        return None
    press_m = float((read_m + below_m)[core].mean())
    if not 0 < press_m < geometry.surface_m:
        return None
    near = (away_m < circle_m + AROUND_M) & geometry.observed_mask
    rigid_m = np.minimum(below_m, press_m).astype(np.float32)
    errors = [
        _mean_square((press_m - _show(rigid_m, press_m, geometry, Gel(t, poisson)) - read_m)[near])
        for t in THICKNESSES_M
    ]
    return np.array(errors), _mean_square((press_m - rigid_m - read_m)[near])


def _show(rigid_m: NDArray[np.float32], press_m: float, geometry: SensorGeometry, gel: Gel) -> NDArray[np.float32]:
    return deform_gel(rigid_m[None], press_m, dataclasses.replace(geometry, gel=gel))[0]


def _measure_distances(geometry: SensorGeometry, x_m: float, y_m: float) -> Floats:
    """Return the distances (H, W), metres, of the pixels from a point of the surface, metres."""
    k = geometry.surface_m if geometry.is_pinhole else 1.0
    x, y = (slopes * k for slopes in geometry.pixel_slopes)
    return np.hypot(x[None] - x_m, y[:, None] - y_m)


def _mean_square(values: NDArray[np.floating]) -> float:
    return float(np.mean(np.square(values, dtype=np.float64)))


def _find_least(errors: Sequence[float] | Floats) -> float:
    """Return the thickness, metres, with the least error: the vertex of a parabola through the three least values."""
    values, logs = np.asarray(errors, float), np.log(THICKNESSES_M)
    k = int(np.clip(values.argmin(), 1, len(values) - 2))
    a, b, _ = np.polyfit(logs[k - 1 : k + 2], values[k - 1 : k + 2], 2)
    vertex = -b / (2 * a) if a > 0 else logs[values.argmin()]
    return float(np.exp(np.clip(vertex, logs[0], logs[-1])))
