"""The search of a track: touches far apart are its keys; its turns end like locating them together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from track_settings import SETTINGS

from tactile_loc.core.geometry.rigid import make_translation
from tactile_loc.locate.localizer import Localizer
from tactile_loc.tasks.key_search import KeySearch, locate_keys


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


def test_the_turns_of_a_search_end_with_the_touches_located_together(pin, touches):
    search = KeySearch(pin).add(touches[0]).begin(())
    assert not search.is_due
    finished = None
    for _ in range(100):
        search, finished = search.take_turn()
        if finished is not None:
            break
    assert finished.keys == (touches[0],)
    whole = locate_keys(pin, [touches[0]])
    assert finished.found.verdict is whole.verdict
    assert np.array_equal(finished.found.best.T_sensor_object, whole.best.T_sensor_object)
    assert not search.is_due
    assert search.add(touches[3]).is_due


def test_a_restart_forgets_the_key_touches(pin, touches):
    search = KeySearch(pin).add(touches[0]).begin(()).restart(touches[5])
    assert search.keys == (touches[5],)
    assert search.turns is None
    assert search.is_due
