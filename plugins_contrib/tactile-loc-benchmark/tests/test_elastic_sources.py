"""The sources with an elastic gel agree with the mechanics of tactile-loc, and with formulas."""

import dataclasses
import math

import numpy as np
import pytest
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.plugin import SensorGeometry

PX, PITCH_M, PRESS_M, NU = 48, 0.2e-3, 0.4e-3, 0.45
BALL_M = 4e-3
CAMERA = SensorGeometry("orthographic", PX, PX, 1 / PITCH_M, 1 / PITCH_M, PX / 2, PX / 2, 10e-3, 1e-3)


def reach_of_ball() -> np.ndarray:
    at = (np.arange(PX) + 0.5 - PX / 2) * PITCH_M
    away = np.hypot(at[None], at[:, None])
    return np.where(away < BALL_M, PRESS_M - BALL_M + np.sqrt(np.maximum(BALL_M**2 - away**2, 0)), -0.05)


def deform(gel: Gel) -> np.ndarray:
    """Return the displacement (H, W), metres, of a gel of tactile-loc."""
    depth_m = np.clip(PRESS_M - reach_of_ball(), 0, PRESS_M).astype(np.float32)
    geometry = dataclasses.replace(CAMERA, gel=gel).press(PRESS_M)
    return PRESS_M - deform_gel(depth_m[None], PRESS_M, geometry)[0]


def test_the_layer_agrees_with_tactile_loc():
    layer = pytest.importorskip("tactile_loc_benchmark.sources.layer", exc_type=ImportError)
    gel = Gel(3e-3, NU)
    theirs = np.clip(layer.press_layer(reach_of_ball(), CAMERA, 3e-3, NU), 0, PRESS_M)
    assert np.abs(theirs - deform(gel)).max() < 0.02 * PRESS_M


def test_the_half_space_agrees_with_tactile_loc():
    half_space = pytest.importorskip("tactile_loc_benchmark.sources.half_space", exc_type=ImportError)
    theirs = half_space.HalfSpaceSolver(CAMERA, NU).press(reach_of_ball())
    assert np.abs(np.clip(theirs, 0, PRESS_M) - deform(Gel(math.inf, NU))).max() < 0.02 * PRESS_M


def test_the_load_of_a_ball_obeys_hertz():
    """The load that is found for an indentation d is 4/3 E* sqrt(R d^3), and the gel touches a circle of sqrt(R d)."""
    half_space = pytest.importorskip("tactile_loc_benchmark.sources.half_space", exc_type=ImportError)
    solver = half_space.HalfSpaceSolver(CAMERA, NU)
    solver.press(reach_of_ball())
    pressure = np.asarray(solver.model.traction)
    modulus = 2 / (1 - NU)  # E / (1 - nu^2) with the shear modulus one
    load = pressure.sum() * PITCH_M**2
    assert load == pytest.approx(4 / 3 * modulus * math.sqrt(BALL_M * PRESS_M**3), rel=0.05)
    radius_m = math.sqrt(np.count_nonzero(pressure > 0) * PITCH_M**2 / math.pi)
    assert radius_m == pytest.approx(math.sqrt(BALL_M * PRESS_M), rel=0.05)
