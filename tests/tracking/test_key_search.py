"""The search of a track: touches far apart are its keys; its result is that of locating them together."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from track_settings import SETTINGS

import tactile_loc.tracking.key_search as module
from tactile_loc.core.geometry.rigid import invert, make_translation
from tactile_loc.locate.localizer import Localizer
from tactile_loc.tracking.key_search import KeySearch, locate_keys, search_keys


@pytest.fixture(scope="module")
def pin(store) -> Localizer:
    return Localizer.create("pin", store=store, tracker={"keyframes": 3}, **SETTINGS)


@pytest.fixture(scope="module")
def touches(pin):
    """Return touches whose sensor poses are 1 mm apart."""
    return [
        replace(touch, T_base_sensor=make_translation([1e-3 * k, 0.0, 0.0]), name=str(k))
        for k, touch in enumerate(pin.simulate(9, seed=2))
    ]


def test_only_touches_far_from_all_key_touches_are_new_places(pin, touches):
    search = KeySearch(pin).add(touches[0])
    assert not search.is_new_place(touches[1])
    assert search.is_new_place(touches[3])
    assert not search.add(touches[3]).is_new_place(touches[4])


def test_of_too_many_key_touches_one_of_the_two_nearest_is_dropped(pin, touches):
    search = KeySearch(pin)
    for k in (0, 3, 5, 8):
        search = search.add(touches[k])
    names = [key.name for key in search.keys]
    assert len(names) == 3
    assert {"0", "8"} < set(names)


def test_a_search_ends_with_the_touches_located_together(pin, touches):
    search = KeySearch(pin).add(touches[0])
    assert not search.begin((), 0.0).is_due
    search, finished = finish(search)
    assert finished.keys == (touches[0],)
    whole = locate_keys(pin, [touches[0]])
    assert finished.found.verdict is whole.verdict
    assert np.array_equal(finished.found.best.T_sensor_object, whole.best.T_sensor_object)
    assert not search.is_due
    assert search.add(touches[3]).is_due


def test_a_restart_forgets_the_key_touches(pin, touches):
    search = KeySearch(pin).add(touches[0]).begin((), 0.0).restart(touches[5:6])
    assert search.keys == (touches[5],)
    assert search.running is None
    assert search.is_due


def test_a_search_also_refines_the_poses_that_the_search_before_listed(pin, touches):
    search = finish(KeySearch(pin).add(touches[0]))[0]
    listed = search.listed
    search, finished = finish(search.add(touches[3]))
    compared = [*finished.found.hypotheses, *finished.found.unlisted]
    proposed = np.stack([hypothesis.T_sensor_object_grid for hypothesis in compared])
    starts = invert(touches[0].T_base_sensor) @ listed
    kept = [np.isclose(proposed, start).all(axis=(1, 2)).any() for start in starts]
    assert sum(kept) > 1  # others are merged with a better pose
    assert np.allclose(search.listed[0], touches[0].T_base_sensor @ finished.found.best.T_sensor_object)
    assert search.restart(touches[5:6]).listed is None


def finish(search):
    """Return a search after its end, and its result."""
    search = search.begin((), 1.0)
    assert search.finish(1.0, waits=True) == (search, None), "the result is not used before it is due"
    return search.finish(1.0 + search.localizer.config.tracker.latency_s, waits=True)


def test_a_live_track_does_not_wait_for_a_search(pin, touches, monkeypatch):
    started, go_on = threading.Event(), threading.Event()

    def search_slowly(*given):
        started.set()
        assert go_on.wait(60)
        return search_keys(*given)

    monkeypatch.setattr(module, "search_keys", search_slowly)
    search = KeySearch(pin).add(touches[0]).begin((), 0.0)
    assert started.wait(60)
    assert search.finish(10.0, waits=False) == (search, None)
    go_on.set()
    assert search.finish(10.0, waits=True)[1].keys == (touches[0],)
