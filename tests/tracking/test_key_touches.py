"""Key touches are far apart, few, in order, and those with the most contact."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.tracking.key_touches import choose_key_touches, measure_motion_m

APART_M, LEVER_M = 2e-3, 1e-2


@pytest.fixture(scope="module")
def touch(localizer) -> Touch:
    return localizer.simulate(1, seed=1)[0]


def at(touch: Touch, x_m: float, press_share: float = 1.0) -> Touch:
    shape = touch.contact_shape.press_to(press_share * touch.press_depth_m)
    return replace(touch, contact_shape=shape, T_base_sensor=make_translation([x_m, 0.0, 0.0]))


def places_mm(touches: list[Touch]) -> list[float]:
    return [round(1e3 * float(touch.T_base_sensor[0, 3]), 6) for touch in touches]


def test_a_rotation_counts_as_the_motion_of_a_lever():
    turned = make_transform(rotation_about([0, 0, 1], 0.2), [0.0, 0.0, 0.0])
    assert measure_motion_m(np.eye(4), turned, np.zeros(3), LEVER_M) == pytest.approx(0.2 * LEVER_M)
    assert measure_motion_m(np.eye(4), make_translation([3e-3, 0, 4e-3]), np.zeros(3), LEVER_M) == pytest.approx(5e-3)
    gel_m = np.array([0.05, 0.0, 0.0])  # the gel moves, although the origin does not
    assert measure_motion_m(np.eye(4), turned, gel_m, 0.0) == pytest.approx(2 * 0.05 * np.sin(0.1))


def test_near_touches_are_represented_by_the_one_with_most_contact(touch):
    near = [at(touch, 0.0, 0.5), at(touch, 1e-3), at(touch, 1.5e-3, 0.7)]
    assert places_mm(choose_key_touches(near, 8, APART_M, LEVER_M)) == [1.0]
    assert places_mm(choose_key_touches([*near, at(touch, 9e-3)], 8, APART_M, LEVER_M)) == [1.0, 9.0]


def test_long_sequences_give_few_touches_over_the_whole_way(touch):
    found = places_mm(choose_key_touches((at(touch, 1e-3 * k) for k in range(200)), 6, APART_M, LEVER_M))
    assert 3 <= len(found) <= 6
    assert found == sorted(found)
    assert found[-1] - found[0] > 90
    assert choose_key_touches([], 6, APART_M, LEVER_M) == []
