"""Wrong statements about the ball are found in drawn photos of presses, and right ones cause no doubt."""

import pytest
from ball_helpers import BALL_M, PITCH_M, UNTOUCHED, draw_press

from tactile_loc.core.sensing.gel import Gel
from tactile_loc.sensors.calibration.statement import check_statement

GEL = Gel(8e-3, coating_m=2e-4)
DEEP_M = 4e-4, 2.2e-3  # least and largest press depth
COUNT = 10
NAMES = [f"{number}.png" for number in range(COUNT)]


@pytest.fixture(scope="module")
def presses():
    return [draw_press(GEL, number, presses_m=DEEP_M) for number in range(COUNT)]


@pytest.mark.parametrize("stated", [0.5, 1.0, 2.0])
def test_half_and_twice_the_radius_cannot_be_right(presses, stated):
    found = check_statement([one._replace(ball_m=stated * BALL_M) for one in presses], UNTOUCHED)
    doubts = found.list_doubts(NAMES, 1e3 * stated * BALL_M, 1e3 * PITCH_M)
    assert found.others == ()
    assert found.least <= 1 / stated <= found.most
    assert 0.6 < found.ratio * stated < 1.7  # misfits hardly differ within the range that fits
    assert found.is_possible == (stated == 1) == (not doubts) == bool(found.list_facts())
    assert all(word in "".join(doubts) for word in ("`ball_radius`", "`mm_per_px`") if doubts)


def test_light_presses_allow_a_wide_range():
    light = [draw_press(GEL, number, presses_m=(2e-4, 3e-4)) for number in range(COUNT)]
    found = check_statement(light, UNTOUCHED)
    assert found.is_possible
    assert found.most > 1.5 * found.least


@pytest.mark.slow
def test_the_presses_of_a_second_ball_are_named(presses):
    numbers, names = (2, 5, 7), [f"{number}.png" for number in range(16)]
    mixed = [*presses, *(draw_press(GEL, number, presses_m=DEEP_M) for number in range(COUNT, 16))]
    assert check_statement(mixed, UNTOUCHED).others == ()
    for number in numbers:
        mixed[number] = draw_press(GEL, number, 1.5 * BALL_M, DEEP_M)._replace(ball_m=BALL_M)
    found = check_statement(mixed, UNTOUCHED)
    assert found.others == numbers
    assert found.larger == pytest.approx(1.5, rel=0.2)
    (doubt,) = found.list_doubts(names, 1e3 * BALL_M, 1e3 * PITCH_M)
    assert "2.png, 5.png, 7.png" in doubt
    for number in numbers:  # each press states its own ball
        mixed[number] = mixed[number]._replace(ball_m=1.5 * BALL_M)
    assert check_statement(mixed, UNTOUCHED).others == ()


def test_too_few_presses_show_nothing(presses):
    found = check_statement(presses[:2], UNTOUCHED)
    assert found.ratio is None
    assert found.is_possible
    assert found.list_doubts(NAMES, 3.0, 0.12) == found.list_facts() == []
