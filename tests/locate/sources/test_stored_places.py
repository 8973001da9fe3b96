"""Places in the store: their files, and those of older versions."""

import numpy as np
import pytest

from tactile_loc import Localizer, StageKey, StageStore
from tactile_loc.locate.sources.stored_places import STAGE, STAGE_VERSION, build_places
from tactile_loc.plugin import Progress

FEW = {"name": "whole", "directions": 100}


@pytest.fixture(scope="module")
def localizer(tmp_path_factory):
    return Localizer.create("pin", grid=FEW, store=tmp_path_factory.mktemp("store"))


def build(localizer, store):
    return build_places(localizer.sampler, localizer.scene, store, Progress())


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
