"""Contacts of balls that a reflectance finds, although the visible circles are off and shadows lie beside them."""

import dataclasses

import numpy as np
import pytest
from ball_helpers import GEOMETRY, PITCH_M, UNTOUCHED, draw_press

from tactile_loc.core.sensing.gel import Gel
from tactile_loc.sensors.calibration.gel_fit import BallImage, GelFit, fit_gel
from tactile_loc.sensors.calibration.reflectance import SeenBalls

GEL = Gel(4e-3, coating_m=2e-4)
WIDER = 1.1  # the drawn circles, as multiples of the contacts
COMMON_PX = np.array([1.5, -1.0])  # by which all circles are off


@pytest.fixture(scope="module")
def drawn() -> list[BallImage]:
    return [draw_press(GEL, number) for number in range(8)]


@pytest.fixture(scope="module")
def fit(drawn: list[BallImage]) -> GelFit:
    found = fit_gel(drawn, UNTOUCHED)
    assert found is not None
    return found


def move_circle(ball: BallImage, rng: np.random.Generator) -> BallImage:
    """A ball whose circle is off."""
    x, y = COMMON_PX + rng.uniform(-1, 1, 2)
    circle = ball.circle
    moved = dataclasses.replace(
        circle, x_px=circle.x_px + x, y_px=circle.y_px + y, radius_px=circle.radius_px * rng.uniform(0.94, 1.06)
    )
    return ball._replace(circle=moved)


def shade(ball: BallImage) -> BallImage:
    """A ball with a dark crescent to the right of its contact."""
    circle = ball.circle
    away = circle.measure_distance_px(ball.image.shape[:2]) / circle.radius_px
    right = np.arange(ball.image.shape[1]) > circle.x_px + 0.5 * circle.radius_px
    image = ball.image.copy()
    image[(away > 0.95) & (away < 1.3) & right] = 60
    return ball._replace(image=image)


@pytest.mark.parametrize("in_shadow", [False, True])
def test_contacts_are_found_although_circles_are_off(drawn, fit, in_shadow):
    rng = np.random.default_rng(4)
    images = [move_circle(shade(ball) if in_shadow else ball, rng) for ball in drawn]
    again, contacts = SeenBalls(images, UNTOUCHED, GEOMETRY).fit(fit)
    off_px = [np.hypot(c.x_px - b.circle.x_px, c.y_px - b.circle.y_px) for b, c in zip(drawn, contacts, strict=True)]
    ratios = [c.radius_m / (b.circle.radius_px * PITCH_M / WIDER) for b, c in zip(drawn, contacts, strict=True)]
    assert np.median(off_px) < 0.9  # the circles are off by 1.8 px
    assert np.abs(np.log(ratios)).max() < 0.06
    assert again.is_elastic
    assert again.contact == pytest.approx(1 / WIDER, abs=0.06)  # of circles that are up to 6 % too wide or too narrow
    assert again.thickness_m == pytest.approx(4e-3, rel=0.4 if in_shadow else 0.3)  # a shadow looks like a thinner gel


def test_right_circles_are_kept(drawn, fit):
    _, contacts = SeenBalls(drawn, UNTOUCHED, GEOMETRY).fit(fit)
    off_px = [np.hypot(c.x_px - b.circle.x_px, c.y_px - b.circle.y_px) for b, c in zip(drawn, contacts, strict=True)]
    assert max(off_px) < 0.5


def test_contacts_smaller_than_the_compared_pixels_stay_where_they_are(drawn, fit):
    small = [ball._replace(circle=dataclasses.replace(ball.circle, radius_px=0.1)) for ball in drawn[:3]]
    some = dataclasses.replace(fit, contacts=fit.contacts[:3])
    _, contacts = SeenBalls(small, UNTOUCHED, GEOMETRY).fit(some)
    for ball, contact, share in zip(small, contacts, some.contacts, strict=True):
        assert np.hypot(contact.x_px - ball.circle.x_px, contact.y_px - ball.circle.y_px) < 1e-6
        assert contact.radius_m == pytest.approx(share * 0.1 * PITCH_M)
