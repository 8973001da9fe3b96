"""Sensors and surfaces with known numbers for the tests of simulated images."""

import math

import numpy as np
import press_sets
from press_sets import places

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.lamps import Light, Optics

PRESS_M = 1e-3
BALL_M = 4e-3
SIDES = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "below": (0.0, 1.0), "above": (0.0, -1.0)}


def sensor(px: int = 80, **more) -> SensorGeometry:
    """An orthographic sensor of a square field, 16 mm wide."""
    return press_sets.sensor(px, max_depth_m=2e-3, **more)


def ball_depth(geometry: SensorGeometry, x_m: float = 0.0, y_m: float = 0.0) -> np.ndarray:
    """Contact depths (1, H, W) of a ball pressed in by PRESS_M, metres."""
    x, y = places(geometry)
    rise = BALL_M - np.sqrt(np.maximum(BALL_M**2 - (x - x_m) ** 2 - (y - y_m) ** 2, 0))
    return np.minimum(rise, PRESS_M).astype(np.float32)[None]


def tip_depth(geometry: SensorGeometry, half_m: float = 4e-3) -> np.ndarray:
    """Contact depths (1, H, W) of a flat square tip pressed in by PRESS_M, metres."""
    x, y = places(geometry)
    inside = (np.abs(x) < half_m) & (np.abs(y) < half_m)
    return np.where(inside, 0.0, PRESS_M).astype(np.float32)[None]


def presses(count: int = 1) -> np.ndarray:
    return np.full(count, PRESS_M)


def lamp(side: str = "right", elevation: float = 30.0, strength: float = 0.9, colour=(1.0, 1.0, 1.0)) -> Light:
    x, y = SIDES[side]
    return Light.at(math.atan2(y, x), math.radians(elevation), colour, strength)


def lit(*sides: str, elevation: float = 30.0, **more) -> Optics:
    """Optics without noise: a white lamp at every side."""
    return Optics(tuple(lamp(side, elevation, 0.9 / len(sides)) for side in sides), **more)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)
