"""Pictures of a calibration: the circle of one photo, and the reading of one held-out photo."""

import pytest
from press_sets import BALL_M, ball_set

from tactile_loc import draw_circle, draw_reading, render_figure
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.unlabelled import find_presses

BALLS = ball_set(7, px=80)


@pytest.fixture(scope="module")
def found():
    images = {"untouched.png": BALLS.background, **{f"{n}.png": image for n, image in enumerate(BALLS.images)}}
    return find_presses(
        [PressImage(name, image) for name, image in images.items()], BALL_M / BALLS.geometry.pixel_pitch_m
    )


def test_the_circle_is_drawn_on_the_photo_and_on_its_change(found):
    figure = draw_circle(found, 2)
    circle = found.presses[2].circle
    assert len(figure.axes) == 2
    for axes in figure.axes:
        (drawn,) = axes.patches
        assert drawn.center == (circle.x_px, circle.y_px)
        assert drawn.radius == circle.radius_px
    picture = render_figure(figure, dpi=40)
    assert picture.ndim == 3
    assert picture.shape[2] == 3
    assert picture.min() < 100 < 250 < picture.max()


def test_the_reading_has_the_known_and_the_estimated_indentation():
    from tactile_loc.sensors.calibration.outcome import CalibrationOutcome
    from tactile_loc.sensors.reading.photometric import PhotometricEstimator

    untrained = PhotometricEstimator(BALLS.geometry, BALLS.background, {"hidden": 4})
    figure = draw_reading(CalibrationOutcome(BALLS, untrained, {}), 3)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:4] == [BALLS.name(3), "known", "estimated", "along x, at the deepest point"]
