"""The search of a track: touches far apart are its keys; its result is that of locating them together."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from track_settings import SETTINGS

import tactile_loc.tracking.key_search as module
from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotation_about
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.locate.hypotheses import compute_imprint_ious
from tactile_loc.locate.localizer import Localizer
from tactile_loc.tracking.key_search import KeySearch, choose_telling, measure_motion_m, search_touches


@pytest.fixture(scope="module")
def pin(store) -> Localizer:
    return Localizer.create("pin", store=store, tracker={"keyframes": 2, "places": 3}, **SETTINGS)


@pytest.fixture(scope="module")
def touches(pin):
    """Return touches whose sensor poses are 1 mm apart."""
    return [
        replace(touch, T_base_sensor=make_translation([1e-3 * k, 0.0, 0.0]), name=str(k))
        for k, touch in enumerate(pin.simulate(9, seed=2))
    ]


NONE = np.empty((0, 4, 4))


def test_only_touches_far_from_all_others_are_new_places(pin, touches):
    touches = [replace(touch, contact_shape=touches[0].contact_shape) for touch in touches]
    search = KeySearch(pin).add_new_places(touches[:2])
    assert search.touches == (touches[0],)
    assert search.add_new_places(touches[3:5]).touches == (touches[0], touches[3])


def test_a_touch_with_far_more_contact_takes_the_place_of_a_light_one(pin, touches):
    deep, beside = touches[0], replace(touches[1], contact_shape=touches[0].contact_shape)
    light = replace(deep, contact_shape=deep.contact_shape.press_to(0.2 * deep.press_depth_m))
    assert KeySearch(pin).add_new_places([light, beside]).touches == (beside,)
    assert KeySearch(pin).add_new_places([beside, light]).touches == (beside,)


def test_of_too_many_touches_one_of_the_two_nearest_is_dropped(pin, touches):
    names = [touch.name for touch in KeySearch(pin).add_new_places([touches[k] for k in (0, 3, 6, 8)]).touches]
    assert len(names) == 3
    assert {"0", "3"} < set(names)


@pytest.fixture(scope="module")
def resting(pin):
    """Return touches of an object at rest, which together determine its pose."""
    return pin.simulate_together(4, seed=3)


def test_the_touch_that_rules_out_a_wrong_pose_is_chosen(pin, resting):
    """A wrong pose explains all touches but one as well as the true pose."""
    truth = resting[0].T_base_sensor @ resting[0].T_sensor_object
    assert choose_telling(pin, resting[:2], NONE, 2) == resting[:2]
    wrong = truth @ make_translation([0.0, 2e-3, 0.0])
    views = pin.make_views(resting)
    poses = invert(resting[0].T_base_sensor) @ np.stack([truth, wrong])
    right, other = compute_imprint_ious(views, poses, 60)
    telling = resting[int((right - other).argmax())]
    chosen = choose_telling(pin, resting, np.stack([truth, wrong]), 1)
    assert [one.name for one in chosen] == [telling.name]


def test_all_touches_judge_the_pose_that_the_chosen_ones_find(pin, resting):
    finished = search_touches(pin, resting, None, NONE)
    assert len(finished.best.imprint_ious) == len(resting)
    off_m = measure_pose_errors(pin.object, finished.best.T_sensor_object[None], resting[0].T_sensor_object)
    assert off_m[0] < 1e-3


def test_a_search_ends_with_the_touches_located_together(pin, touches):
    search = KeySearch(pin).add_new_places(touches[:1])
    assert not search.begin(NONE, 0.0).is_due
    search, finished = finish(search)
    assert search.begun == (touches[0],)
    whole = pin.localize(touches[0])
    assert finished.verdict is whole.verdict
    assert np.array_equal(finished.best.T_sensor_object, whole.best.T_sensor_object)
    assert not search.is_due
    assert search.add_new_places(touches[3:4]).is_due


def test_a_restart_forgets_the_touches(pin, touches):
    search = KeySearch(pin).add_new_places(touches[:1]).begin(NONE, 0.0).restart(touches[5:6])
    assert search.touches == (touches[5],)
    assert search.running is None
    assert search.is_due


def test_a_search_also_refines_known_poses_and_those_that_the_search_before_found(pin, touches):
    search = finish(KeySearch(pin).add_new_places(touches[:1]))[0]
    listed, known = search.listed, make_translation([0.0, 0.0, 1e-3]) @ search.listed[:1]
    search, finished = finish(search.add_new_places(touches[3:4]), known)
    compared = [*finished.hypotheses, *finished.unlisted]
    proposed = np.stack([hypothesis.T_sensor_object_grid for hypothesis in compared])
    starts = invert(touches[0].T_base_sensor) @ np.concatenate([known, listed])
    kept = [np.isclose(proposed, start).all(axis=(1, 2)).any() for start in starts]
    assert sum(kept) > 1  # others are merged with a better pose
    assert np.allclose(search.listed[0], touches[0].T_base_sensor @ finished.best.T_sensor_object)
    assert len(search.restart(touches[5:6]).listed) == 0


def finish(search, known=NONE):
    """Return a search after its end, and its result."""
    search = search.begin(known, 1.0)
    assert search.finish(1.0, waits=True) == (search, None), "the result is not used before it is due"
    return search.finish(1.0 + search.localizer.config.tracker.latency_s, waits=True)


def test_a_live_track_does_not_wait_for_a_search(pin, touches, monkeypatch):
    started, go_on = threading.Event(), threading.Event()

    def search_slowly(*given):
        started.set()
        assert go_on.wait(60)
        return search_touches(*given)

    monkeypatch.setattr(module, "search_touches", search_slowly)
    search = KeySearch(pin).add_new_places(touches[:1]).begin(NONE, 0.0)
    assert started.wait(60)
    assert search.finish(10.0, waits=False) == (search, None)
    go_on.set()
    assert search.finish(10.0, waits=True)[1].touch is touches[0]


def test_a_rotation_counts_as_the_motion_of_a_lever():
    turned = make_transform(rotation_about([0, 0, 1], 0.2), [0.0, 0.0, 0.0])
    assert measure_motion_m(np.eye(4), turned, np.zeros(3), 1e-2) == pytest.approx(0.2 * 1e-2)
    assert measure_motion_m(np.eye(4), make_translation([3e-3, 0, 4e-3]), np.zeros(3), 1e-2) == pytest.approx(5e-3)
    gel_m = np.array([0.05, 0.0, 0.0])  # the gel moves, although the origin does not
    assert measure_motion_m(np.eye(4), turned, gel_m, 0.0) == pytest.approx(2 * 0.05 * np.sin(0.1))
