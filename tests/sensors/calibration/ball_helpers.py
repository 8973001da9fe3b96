"""Drawn images of balls that are pressed into a gel under coloured lamps."""

import math

import numpy as np

from tactile_loc.core.sensing.gel import Gel, compute_smoothing, list_wave_numbers, make_solver
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.gel_fit import BallImage
from tactile_loc.sensors.reading.circles import Circle
from tactile_loc.sensors.reading.surface import differentiate

BALL_M, PITCH_M, PX = 3e-3, 1.2e-4, 140
SCALE = 1 / PITCH_M
GEOMETRY = SensorGeometry("orthographic", PX, PX, SCALE, SCALE, PX / 2, PX / 2, standoff_m=0.01, max_depth_m=1.5e-3)
UNTOUCHED = np.full((PX, PX, 3), 110, np.uint8)
LAMPS = np.array([[1.0, 0.0], [-0.5, 0.87], [-0.5, -0.87]])  # directions of the red, green and blue lamps
LIGHT_M = 3e-4, 8e-4  # least and largest press depth


def draw_press(gel: Gel, number: int, ball_m: float = BALL_M, presses_m: tuple[float, float] = LIGHT_M) -> BallImage:
    """An image of a ball under coloured lamps, and a circle that is larger than the contact by a tenth."""
    rng = np.random.default_rng(number)
    at = PITCH_M * PX * (0.5 + rng.uniform(-0.07, 0.07, 2))
    side = PITCH_M * (np.arange(PX) + 0.5)
    away = np.hypot(side[None] - at[0], side[:, None] - at[1])
    reach = rng.uniform(*presses_m) - (ball_m - np.sqrt(np.maximum(ball_m**2 - away**2, 0)))
    if gel.is_elastic:
        solver = make_solver(Gel(gel.thickness_m), (PX, PX), (PITCH_M, PITCH_M))
        pressure = solver.press(reach[None].astype(np.float32), 40).pressure[0]
        q = np.hypot(*list_wave_numbers(solver.padded, (PITCH_M, PITCH_M)))
        spectrum = np.fft.rfft2(pressure, solver.padded) * solver.compliance * compute_smoothing(q, gel)
        surface, touching = np.fft.irfft2(spectrum, solver.padded)[:PX, :PX], pressure > 0
    else:
        surface, touching = np.maximum(reach, 0), reach > 0
    slopes = differentiate(surface, GEOMETRY)
    light = slopes @ LAMPS.T / np.sqrt(1 + (slopes**2).sum(axis=2, keepdims=True))
    image = np.clip(np.rint(110 + 90 * light + rng.standard_normal((PX, PX, 3))), 0, 255).astype(np.uint8)
    radius_px = 1.1 * math.sqrt(touching.sum() / math.pi)
    return BallImage(image, Circle(at[0] / PITCH_M, at[1] / PITCH_M, radius_px), ball_m, PITCH_M)
