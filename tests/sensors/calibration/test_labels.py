"""Labels of presses: the ball's formula, and unknown pixels."""

import dataclasses

import numpy as np
import pytest
from message_helpers import naming
from press_sets import BALL_M, ball_indentation, contact_radius, places, sensor

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.sensors.calibration.labels import SKIRT, label_ball

GEOMETRY = sensor(80)
PITCH_M = 2e-4
RADIUS_PX = 9.0
RADIUS_M = RADIUS_PX * PITCH_M


def test_the_indentation_matches_the_ball_inside_and_is_zero_outside():
    press_m = 6e-4
    radius_px = contact_radius(press_m) / PITCH_M
    label = label_ball(GEOMETRY, (35.0, 42.0), radius_px, BALL_M)
    true = ball_indentation(GEOMETRY, (35 - 40) * PITCH_M, (42 - 40) * PITCH_M, press_m)
    np.testing.assert_allclose(label.indentation_m, true, atol=1e-9)
    np.testing.assert_array_equal(label.contact, true > 0)
    assert label.indentation_m.dtype == label.slope.dtype == np.float32


def test_slope_is_the_derivative_of_the_indentation():
    label = label_ball(GEOMETRY, (40.5, 40.5), RADIUS_PX, BALL_M)
    right, below = label.slope[40, 45], label.slope[44, 40]  # 1 mm right of the middle, 0.8 mm below it
    assert right == pytest.approx([-1e-3 / np.sqrt(BALL_M**2 - 1e-6), 0], abs=1e-6)  # it falls off to the right
    assert below == pytest.approx([0, -8e-4 / np.sqrt(BALL_M**2 - 64e-8)], abs=1e-6)
    down, across = np.gradient(label.indentation_m.astype(float), PITCH_M)
    x, y = places(GEOMETRY)
    inner = np.hypot(x, y) < RADIUS_M - 3 * PITCH_M
    np.testing.assert_allclose(label.slope[inner], np.stack([across, down], -1)[inner], atol=3e-3)
    assert not label.slope[~label.contact].any()


def test_a_ball_is_round_in_pixels_that_are_not_square():
    flat = dataclasses.replace(GEOMETRY, height_px=40, fy=2500.0, cy=20.0)  # 0.2 x 0.4 mm
    label = label_ball(flat, (40.0, 20.0), 6.0, BALL_M)
    x, y = places(flat)
    rho = np.hypot(x, y)
    radius_m = 6.0 * flat.pixel_pitch_m
    np.testing.assert_array_equal(label.contact, rho < radius_m)
    true = np.sqrt(BALL_M**2 - rho**2, where=label.contact, out=np.zeros_like(rho)) - np.sqrt(BALL_M**2 - radius_m**2)
    np.testing.assert_allclose(label.indentation_m[label.contact], true[label.contact], atol=1e-9)


def test_pixels_between_contact_and_untouched_gel_are_unknown():
    label = label_ball(GEOMETRY, (40.0, 40.0), RADIUS_PX, BALL_M)
    rho = np.hypot(*places(GEOMETRY))
    np.testing.assert_array_equal(label.contact, rho < RADIUS_M)
    np.testing.assert_array_equal(~label.known, (rho >= RADIUS_M) & (rho <= SKIRT * RADIUS_M))
    cut = label_ball(GEOMETRY, (0.0, 40.0), RADIUS_PX, BALL_M)  # by the border of the image
    np.testing.assert_array_equal(cut.indentation_m[:, :40], label.indentation_m[:, 40:])


def test_the_label_of_a_deep_press_ends_near_the_balls_equator():
    label = label_ball(GEOMETRY, (40.0, 40.0), 18.0, BALL_M)  # the ball's radius is 15 px
    rho = np.hypot(*places(GEOMETRY))
    np.testing.assert_array_equal(label.contact, rho < 0.98 * BALL_M)
    assert not label.known[(rho > BALL_M) & (rho < 1.2 * 2 * BALL_M)].any()


@pytest.mark.parametrize(
    ("centre", "radius_px", "ball_m", "words"),
    [
        ((40, 40), 24.1, BALL_M, ("24.1 px", "3 mm", "radius")),  # much larger than the ball
        ((40, 40), 100.0, BALL_M, ("100 px", "3 mm", "radius")),
        ((40, 40), 0.0, BALL_M, ("0 px", "3 mm")),
        ((40, 40), -3.0, BALL_M, ("-3 px", "3 mm")),
        ((40, 40), 5.0, 0.0, ("5 px", "0 mm")),
        ((40, 40), 5.0, -1e-3, ("5 px", "-1 mm")),
        *((at, RADIUS_PX, BALL_M, (at, "80 x 80 px")) for at in ((-1, 40), (40, -0.5), (80.5, 40), (40, 81))),
    ],
)
def test_an_impossible_circle_is_refused(centre, radius_px, ball_m, words):
    with pytest.raises(CalibrationError, match=naming(*words)):
        label_ball(GEOMETRY, centre, radius_px, ball_m)
