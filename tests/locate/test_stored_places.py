"""Places in the store: their files, and those of older versions."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.places import BELOW, FAR, PATCH_PX
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.stored_places import STAGE, STAGE_VERSION, build_places, join_patches, split_patches
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore

FEW = {"name": "whole", "directions": 100}


@pytest.fixture(scope="module")
def localizer(tmp_path_factory):
    return Localizer.create("pin", grid=FEW, store=tmp_path_factory.mktemp("store"))


def build(localizer, store):
    return build_places(localizer.sampler, localizer.scene, store, Progress())


def test_any_patches_are_the_same_after_splitting_and_joining():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, FAR + 1, (3, PATCH_PX, PATCH_PX), np.uint8)
    for patches in (noise, np.where(rng.random(noise.shape) < 0.8, FAR, noise), 0 * noise, 0 * noise + FAR, noise[:0]):
        for some in (patches, patches[:, ::-1]):
            joined = join_patches(*split_patches(some))
            assert joined.dtype == np.uint8
            assert np.array_equal(joined, some)


def test_a_patch_is_split_into_runs_and_changes():
    patch = np.full((1, PATCH_PX, PATCH_PX), FAR, np.uint8)
    patch[0, 0, 2:5] = BELOW, BELOW + 7, BELOW + 4
    runs, changes = split_patches(patch)
    assert runs.tolist() == [2, 3, PATCH_PX**2 - 5]
    assert changes.tolist() == [BELOW, 7, 256 - 3]


def test_stored_places_are_those_of_the_sampler_in_a_fifth_of_the_space(localizer, tmp_path):
    made = localizer.sampler.places(localizer.object, Progress())
    for _ in range(2):  # built, and read
        store = StageStore(tmp_path)
        places, _ = build(localizer, store)
        assert np.array_equal(places.patches, made.patches)
        assert np.array_equal(places.T_place_object, made.T_place_object)
    (entry,) = store.entries()
    assert entry.nbytes < 0.2 * (made.patches.nbytes + made.T_place_object.nbytes)


def test_places_stored_by_an_older_version_are_not_read(localizer, tmp_path):
    store = StageStore(tmp_path)
    made, key = build(localizer, store)
    old = StageKey(STAGE, STAGE_VERSION, key.inputs)  # places had this key before they were packed
    store.build(old, lambda work: work.save_array("patches", 0 * made.patches))
    places, again = build(localizer, StageStore(tmp_path))
    assert np.array_equal(places.patches, made.patches)
    assert again == old


def test_damaged_places_are_built_again(localizer, tmp_path):
    made, _ = build(localizer, StageStore(tmp_path))
    (path,) = tmp_path.glob(f"{STAGE}/*/changes.npz")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    store = StageStore(tmp_path)
    places, _ = build(localizer, store)
    assert np.array_equal(places.patches, made.patches)
    assert [key.stage for key in store.built] == [STAGE]
