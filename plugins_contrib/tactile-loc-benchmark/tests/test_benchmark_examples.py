"""Examples: the same presses for all sources, true poses in a random base frame, and refused presses."""

import numpy as np
import pytest
from tactile_loc import StageStore
from tactile_loc.plugin.helpers import is_rigid, rotation_angle

from tactile_loc_benchmark.examples import DrawnTouches, ExampleDrawer
from tactile_loc_benchmark.prepare import load_objects, prepare_source


@pytest.fixture
def draw(make_suite, bench_store):
    """Draw the examples of the only object of a source's entry; keywords replace values of the suite."""

    def draw(entry: object, **changes: object) -> DrawnTouches:
        return make_drawer(entry, **changes).load(StageStore(bench_store))

    def make_drawer(entry: object, **changes: object) -> ExampleDrawer:
        suite = make_suite(source=[entry], **changes)
        source = prepare_source(suite.source[0], load_objects(suite.objects), suite, bench_store)
        (obj,) = source.objects.values()
        return ExampleDrawer(suite, source.entry, source.table, obj)

    draw.drawer = make_drawer
    return draw


def test_all_sources_get_the_same_presses(draw):
    one = draw("sketch")
    other = draw({"name": "sketch", "label": "other", "style": "bold"})
    assert len(one) == 3
    assert (one.count == 2).all()
    np.testing.assert_array_equal(one.T_sensor_object, other.T_sensor_object)
    np.testing.assert_array_equal(one.T_base_object, other.T_base_object)


def test_a_refused_press_is_counted_and_replaced_without_changing_the_other_touches(draw):
    free, shy = draw("sketch", examples=6), draw({"name": "sketch", "label": "shy", "refused": 0.4}, examples=6)
    assert free.refused.sum() == 0
    assert shy.refused.sum() > 0
    assert (shy.count == 2).all()
    same = (free.T_sensor_object == shy.T_sensor_object).all(axis=(2, 3))
    assert 0 < same.sum() < same.size
    assert same[shy.refused == 0].all()
    assert (same.size - same.sum()) <= shy.refused.sum()


def test_examples_whose_presses_are_all_refused_have_no_touch(draw):
    found = draw({"name": "sketch", "label": "blind", "refused": 1.0})
    assert (found.count == 0).all()
    assert (found.refused > 10).all()
    assert found.picture.size == 0


def test_touches_state_where_the_sensor_was_in_a_random_base_frame(draw):
    drawer = draw.drawer("sketch")
    found = draw("sketch")
    for k, touch in enumerate(found.make_touches(0, drawer.sensor)):
        np.testing.assert_allclose(
            np.asarray(touch.T_base_sensor) @ found.T_sensor_object[0, k], found.T_base_object[0], atol=1e-12
        )
        np.testing.assert_array_equal(touch.contact_shape.depth_m, found.depth_m[0, k])
    assert is_rigid(found.T_base_object)
    relative = found.T_base_object[0].T @ found.T_base_object[1]
    assert rotation_angle(relative[None, :3, :3])[0] > 0.1
    assert np.ptp(found.T_base_object[:, :3, 3], axis=0).max() > 0.05


def test_every_recorded_touch_is_an_example(draw):
    found = draw("archive")
    np.testing.assert_array_equal(found.count, [1, 0])
    np.testing.assert_array_equal(found.refused, [0, 1])
    np.testing.assert_array_equal(found.T_sensor_object[0, 0][:3, 3], [0, 0, 0.02])
    assert found.picture.shape == (32, 32)
