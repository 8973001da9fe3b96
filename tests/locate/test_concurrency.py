"""A localizer can be pickled, and several threads or processes may locate with it."""

import multiprocessing
import pickle
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from tactile_loc import Localization, Localizer, StageStore, Touch

WHOLE = {"sensor": "gelsight-mini", "grid": {"name": "whole", "directions": 300}, "temperature": 0.05}
FACE = {"grid": {"name": "face", "spacing_mm": 8.0}, "temperature": 0.05}
OTHERS = {
    "faiss-filterreg": {**WHOLE, "matcher": "faiss", "refiner": "filterreg"},
    "raycast-icp": {**WHOLE, "renderer": "raycast", "refiner": "icp"},
    "zbuffer-render": {**WHOLE, "renderer": "zbuffer", "refiner": "render"},
    "pyrender-kiss-icp": {**FACE, "renderer": "pyrender", "refiner": "kiss-icp"},
}
CHOICES = [
    pytest.param(WHOLE, id="whole"),
    pytest.param(FACE, id="face"),
    *(pytest.param(settings, id=name, marks=pytest.mark.slow) for name, settings in OTHERS.items()),
]


def make(store: StageStore, settings: dict) -> Localizer:
    return Localizer.create("pin", store=store, **settings)


def require_equal(found: Sequence[Localization], expected: Sequence[Localization]) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.posterior.log_p, other.posterior.log_p)
        assert len(one.hypotheses) == len(other.hypotheses)
        for mine, yours in zip(one.hypotheses, other.hypotheses, strict=True):
            np.testing.assert_array_equal(mine.T_sensor_object, yours.T_sensor_object)
            assert mine.probability == yours.probability


def locate(localizer: Localizer, touches: Sequence[Touch]) -> list[Localization]:
    return [localizer.localize(touch) for touch in touches]


@pytest.mark.parametrize("settings", CHOICES)
def test_a_copy_finds_the_same_poses(store, settings):
    localizer = make(store, settings)
    before = pickle.dumps(localizer)
    touches = localizer.simulate(2, seed=7)
    expected = locate(localizer, touches)
    after = pickle.dumps(localizer)
    assert len(after) < 3e6, "what is in the store must not be copied"
    for copied in (before, after):
        require_equal(locate(pickle.loads(copied), touches), expected)


@pytest.mark.parametrize("settings", CHOICES)
def test_threads_find_the_same_poses(store, settings):
    """The second localizer is used by several threads from the start, so they also build its parts at once."""
    touches = make(store, settings).simulate(6, seed=8)
    expected = locate(make(store, settings), touches)
    shared = make(store, settings)
    with ThreadPoolExecutor(4) as threads:
        require_equal(list(threads.map(shared.localize, touches)), expected)
        require_equal(list(threads.map(shared.localize, touches)), expected)


def test_threads_may_build_a_model(tmp_path):
    """Threads that meet an empty store wait for the thread that builds."""
    localizer = make(StageStore(tmp_path), FACE)
    touches = localizer.simulate(4, seed=9)
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(localizer.localize, touches))
    require_equal(found, locate(make(StageStore(tmp_path), FACE), touches))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [WHOLE, FACE], ids=["whole", "face"])
def test_processes_find_the_same_poses(store, settings):
    localizer = make(store, settings)
    touches = localizer.simulate(4, seed=10)
    expected = locate(localizer, touches)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as processes:
        require_equal(list(processes.map(localizer.localize, touches, chunksize=2)), expected)


def test_a_copy_keeps_a_trained_encoder(store):
    pytest.importorskip("torch")
    tiny = {"epochs": 1, "queries": 32, "batch": 16, "backbone": "small", "channels": 4}
    localizer = make(store, {**FACE, "encoder": {"name": "moco", **tiny}})
    touches = localizer.simulate(1, seed=11)
    expected = locate(localizer, touches)
    copy = pickle.loads(pickle.dumps(localizer))
    require_equal(locate(copy, touches), expected)
    assert copy.source.trained == localizer.source.trained
