"""Touches of one object at rest: one pose in the base frame, and pairs of fingers that face each other."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.plugins.grids.whole import WholeGrid
from tactile_loc.simulate.resting_touches import draw_resting_touches, rest
from tactile_loc.simulate.touch_simulation import simulate_touches


@pytest.fixture
def sampler() -> WholeGrid:
    return WholeGrid(WholeGrid.Options(min_contact_percent=0.1))


@pytest.mark.parametrize("opposed", [False, True])
def test_the_object_rests_at_one_pose(make_scene, pinhole, box, sampler, opposed):
    touches = draw_resting_touches(sampler, make_scene(box, pinhole), 4, np.random.default_rng(0), opposed=opposed)
    placed = [touch.T_base_sensor @ touch.T_sensor_object for touch in touches]
    np.testing.assert_allclose(placed, [placed[0]] * 4, atol=1e-12)
    assert not np.allclose(placed[0], np.eye(4))
    assert [touch.name for touch in touches] == [f"touch-{k:04d}" for k in range(4)]
    assert all(touch.contact_shape.contact.any() for touch in touches)


def test_opposed_fingers_face_each_other(make_scene, pinhole, box, sampler):
    touches = draw_resting_touches(sampler, make_scene(box, pinhole), 4, np.random.default_rng(1), opposed=True)
    for first, second in (touches[:2], touches[2:]):
        np.testing.assert_allclose(first.T_base_sensor[:3, 2], -second.T_base_sensor[:3, 2], atol=1e-12)
        gap_m = np.linalg.inv(first.T_base_sensor) @ second.T_base_sensor
        np.testing.assert_allclose(gap_m[:2, 3], 0, atol=1e-12)  # on one axis
        assert gap_m[2, 3] > 2 * pinhole.standoff_m


def test_an_odd_number_of_opposed_touches_and_an_unknown_pose_are_refused(make_scene, pinhole, box, sampler):
    scene, rng = make_scene(box, pinhole), np.random.default_rng(0)
    with pytest.raises(TouchError, match="3"):
        draw_resting_touches(sampler, scene, 3, rng, opposed=True)
    (touch,) = simulate_touches(sampler, scene, 1, rng)
    with pytest.raises(TouchError):
        rest([replace(touch, T_sensor_object=None)], np.eye(4))
