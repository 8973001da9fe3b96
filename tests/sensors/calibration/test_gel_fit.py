"""A gel's thickness and coating, from drawn presses of balls and from real ones."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from ball_helpers import BALL_M, GEOMETRY, PITCH_M, UNTOUCHED, draw_press

from tactile_loc import EstimatorRecipe, SensorGeometry
from tactile_loc.core.sensing.gel import RIGID, Gel, make_solver
from tactile_loc.sensors.calibration import gel_fit
from tactile_loc.sensors.calibration.gel_fit import DEPTHS, fit_gel, label_elastic_ball, press_balls

OTHERS = Gel(5e-3), Gel(4e-3, coating_m=4e-4)


@pytest.mark.parametrize(
    "gel", [Gel(3e-3, coating_m=2e-4), *(pytest.param(gel, marks=pytest.mark.slow) for gel in OTHERS)], ids=str
)
def test_thickness_coating_and_contact_are_found(gel):
    fit = fit_gel([draw_press(gel, number) for number in range(5)], UNTOUCHED)
    assert fit is not None
    assert fit.is_elastic
    assert fit.thickness_m == pytest.approx(gel.thickness_m, rel=0.2)
    assert fit.coating_m == pytest.approx(gel.coating_m, abs=1.2e-4)
    assert fit.contact == pytest.approx(1 / 1.1, abs=0.03)
    assert fit.rms < 0.1
    assert fit.gel == Gel(fit.thickness_m, coating_m=fit.coating_m)


def test_a_gel_that_ends_at_the_contact_is_taken_for_rigid():
    fit = fit_gel([draw_press(RIGID, number) for number in range(4)], UNTOUCHED)
    assert fit is not None
    assert not fit.is_elastic
    assert fit.rigid_rms < 0.2


def test_too_few_presses_or_circles_beyond_the_image_give_no_fit():
    presses = [draw_press(Gel(4e-3), number) for number in range(3)]
    assert fit_gel(presses[:2], UNTOUCHED) is None
    beyond = [one._replace(circle=dataclasses.replace(one.circle, x_px=0.0, y_px=0.0)) for one in presses]
    assert fit_gel(beyond, UNTOUCHED) is None


def test_photos_without_a_press_do_not_spoil_the_fit():
    presses = [draw_press(Gel(4e-3), number) for number in range(5)]
    blank = [one._replace(image=UNTOUCHED) for one in presses[:2]]
    noise = np.random.default_rng(0).integers(-2, 3, UNTOUCHED.shape)
    dim = [one._replace(image=(UNTOUCHED + noise).astype(np.uint8)) for one in presses[:2]]
    for more in (blank, dim):
        fit = fit_gel([*presses[2:], *more], UNTOUCHED)
        assert fit is not None
        assert np.isfinite([fit.thickness_m, fit.std_m, fit.coating_m, *fit.contacts]).all()


def test_a_ball_on_a_half_space_is_as_hertz_says():
    pressed = press_balls(Gel(math.inf), BALL_M)
    depths_m = DEPTHS * BALL_M
    shallow = (depths_m > 1e-4) & (depths_m < 5e-4)
    np.testing.assert_allclose(pressed.surface_m[shallow, 0], depths_m[shallow], rtol=0.01)
    contact_m = pressed.contact_m[shallow]
    exact_m = 0.5 * contact_m * np.log((BALL_M + contact_m) / (BALL_M - contact_m))  # of a sphere, not a paraboloid
    np.testing.assert_allclose(depths_m[shallow], exact_m, rtol=0.02)


@pytest.mark.parametrize("gel", [Gel(2e-3), Gel(5e-3)], ids=str)
def test_rings_of_pressure_agree_with_the_solver_on_pixels(gel):
    pressed = press_balls(gel, BALL_M)
    chosen = int(np.abs(DEPTHS * BALL_M - 5e-4).argmin())
    pitch_m = 1e-4
    side = pitch_m * (np.arange(128) - 64)
    away = np.hypot(side[None], side[:, None])
    below = BALL_M - np.sqrt(np.maximum(BALL_M**2 - away**2, 0))
    reach = np.where(away < BALL_M, DEPTHS[chosen] * BALL_M - below, -np.inf).astype(np.float32)
    solved = make_solver(gel, reach.shape, (pitch_m, pitch_m)).press(reach[None], 20).displacement_m[0]
    wanted = np.interp(away, pressed.away_m, pressed.surface_m[chosen])
    np.testing.assert_allclose(solved[away < 6e-3], wanted[away < 6e-3], atol=0.012 * DEPTHS[chosen] * BALL_M)


def test_a_label_is_the_gel_in_and_around_the_contact():
    gel = Gel(4e-3, coating_m=2e-4)
    pressed = press_balls(gel, BALL_M)
    depth = pressed.find_depth(1.2e-3)
    label = label_elastic_ball(GEOMETRY, (70.0, 60.0), 1.2e-3, pressed)
    assert label.absolute
    assert label.known.all()
    assert label.indentation_m.max() == pytest.approx(DEPTHS[depth] * BALL_M, rel=0.01)
    assert label.contact.sum() * PITCH_M**2 == pytest.approx(math.pi * pressed.contact_m[depth] ** 2, rel=0.02)
    beside = ~label.contact & (label.indentation_m > 0.2 * label.indentation_m.max())
    assert beside.any()
    assert np.hypot(label.slope[..., 0], label.slope[..., 1])[beside].min() > 0.03


SET_MM_PX = 0.059259


@pytest.mark.slow
def test_real_presses_give_absolute_depths(shared_data, tmp_path):
    """GelSlim: balls calibrate; another ball and a flat prism are read at their stated presses, constant included."""
    from PIL import Image

    from tactile_loc.sensors.calibration.layouts import convert_presses
    from tactile_loc.sensors.calibration.outcome import calibrate
    from tactile_loc.sensors.calibration.presses import choose_size_px, read_presses
    from tactile_loc.sensors.reading.reading import read_gel, reduce_image

    balls, shapes = shared_data / "tactile/gelslim_balls", shared_data / "tactile/gelslim_shapes"
    convert_presses(balls, tmp_path / "presses", 2.92, SET_MM_PX)
    scale = 1e3 / SET_MM_PX
    camera = SensorGeometry("orthographic", 320, 320, scale, scale, 160, 160, standoff_m=0.01, max_depth_m=1.5e-3)
    presses = read_presses(tmp_path / "presses", camera, size_px=choose_size_px(camera)).measure_gel()
    assert presses.fit is not None
    assert presses.fit.rms < 0.2 * presses.fit.rigid_rms
    geometry = presses.geometry
    estimator = calibrate(presses, EstimatorRecipe()).estimator

    def read(path: Path) -> np.ndarray:
        image = np.asarray(Image.open(path).convert("RGB"))
        return read_gel(estimator, reduce_image(image, geometry.shape), geometry.gel).indentation_m

    side = geometry.pixel_pitch_m * (np.arange(160) + 0.5)
    away = np.hypot(side[None] - 208.5e-3 * SET_MM_PX, side[:, None] - 166.5e-3 * SET_MM_PX)
    truth = press_balls(Gel(geometry.gel.thickness_m), 2.92e-3)
    pose = json.loads((shapes / "poses.json").read_text())["prism_0.5"]
    u, v = (1e-3 * SET_MM_PX * (value + 0.5) for value in pose["origin_px"])
    tip = (np.abs(side[None] - u) < 2e-3) & (np.abs(side[:, None] - v) < 3e-3)  # without its border
    for press in ("0.25", "0.5", "0.75", "1.0"):
        press_m = 1e-3 * float(press)
        depth = int(np.abs(DEPTHS * 2.92e-3 - press_m).argmin())
        ball_m = np.interp(away, truth.away_m, truth.surface_m[depth]) + press_m - DEPTHS[depth] * 2.92e-3
        off_m = (read(shapes / f"sphere_{press}_real.png") - ball_m)[away < truth.contact_m[depth]]
        assert np.sqrt(np.mean(off_m**2)) < (25e-6 if press == "0.25" else 45e-6)  # without seams: 32e-6 at 0.25 mm
        flat_m = read(shapes / f"prism_{press}_real.png")[tip]
        assert flat_m.mean() == pytest.approx(press_m, rel=0.05, abs=7e-5)
        assert flat_m.std() < 4.5e-5


def make_errors(sharp: float, number: int = 10) -> np.ndarray:
    """Errors of profiles (T, C, N) with their least at 6 mm and 0.2 mm; `sharp` is their rise with the thickness."""
    off = sharp * np.log(gel_fit.THICKNESSES_M / 6e-3)[:, None] ** 2 + (gel_fit.COATINGS_M / 2e-4 - 1)[None] ** 2
    shares = np.random.default_rng(0).uniform(0.9, 1.1, number)
    return 1e-3 * (1 + off)[..., None] * shares


def test_the_stated_deviation_is_that_of_the_thicknesses_that_explain_the_presses():
    log_m, coating_m, std = gel_fit._weigh_gels(make_errors(2.0))
    assert math.exp(log_m) == pytest.approx(6e-3, rel=0.1)
    assert coating_m == pytest.approx(2e-4, rel=0.1)
    least_m, most_m = gel_fit.THICKNESSES_M[[0, -1]]
    off = np.log(np.geomspace(least_m, most_m, 1001) / 6e-3)
    weights = (1 + 2 * off**2) ** -14.5  # 3 values of 10 presses; the sum over the coatings adds half a power
    assert std == pytest.approx(math.sqrt((weights @ off**2) / weights.sum()), rel=0.1)
    wide = gel_fit._weigh_gels(make_errors(0.0))[2]
    assert wide == pytest.approx(math.log(most_m / least_m) / math.sqrt(12), rel=0.05)  # of an even distribution


def test_halves_of_the_presses_agree_within_their_stated_deviations():
    presses = [draw_press(Gel(5e-3), number) for number in range(8)]
    halves = [fit_gel(presses[start::2], UNTOUCHED) for start in (0, 1)]
    one, other = (fit for fit in halves if fit is not None)
    assert abs(one.thickness_m - other.thickness_m) < 2 * math.hypot(one.std_m, other.std_m)
    assert abs(one.thickness_m - 5e-3) < 2 * one.std_m
