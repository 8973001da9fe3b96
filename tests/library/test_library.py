"""A library reads and verifies the stored parts of an object when they are used, and keeps those used last."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tactile_loc.core.runtime.caches import ByteCache
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store import artifact as artifact_module
from tactile_loc.store.store import StageStore
from tactile_loc.tasks.identify import identify
from tactile_loc.tasks.library import Comparison, Library, RoughFit

NAMES = ("plate", "rod")


@pytest.fixture(scope="module")
def objects(make_object) -> list:
    plate, rod = trimesh.creation.box((0.03, 0.02, 0.006)), trimesh.creation.cylinder(0.004, 0.04, sections=32)
    return [make_object(plate, "x2*y2", "plate"), make_object(rod, "zinf*x2", "rod")]


@pytest.fixture
def root(tmp_path) -> Path:
    return tmp_path / "store"


@pytest.fixture
def open_library(objects, root):
    """Return a function that opens a library as a new process would."""
    grid = {"name": "whole", "directions": 300, "turns": 24}
    config = RunConfig.from_dict({"grid": grid, "sensor": "gelsight-mini", "temperature": 0.05})
    return lambda **limits: Library([Localizer(config, obj, StageStore(root)) for obj in objects], **limits)


@pytest.fixture
def touch(open_library):
    """Return a touch of the plate; everything that it needs is stored."""
    library = open_library()
    (touch,) = library.models[0].simulate(1, seed=5, press_depth_m=9e-4)
    comparison = library.compare([touch])
    for k in range(len(library)):
        search_roughly(library, k, comparison)
    return touch


@pytest.fixture
def hashed(monkeypatch) -> list[tuple[str, str]]:
    """Return a list that grows by the stage and the file of each checksum that is computed."""
    found: list[tuple[str, str]] = []
    real = artifact_module.hash_file

    def spy(path: Path) -> str:
        found.append((path.parent.parent.name, path.name))
        return real(path)

    monkeypatch.setattr(artifact_module, "hash_file", spy)
    return found


def search_roughly(library: Library, k: int, comparison: Comparison) -> RoughFit:
    return library.look_into(k, comparison, library.examine(k, comparison))


def flip_last_byte(paths: list[Path]) -> None:
    for path in paths:
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(content)


def test_checksums_are_verified_when_a_file_is_used(open_library, touch, hashed):
    library = open_library()
    assert hashed == []
    comparison = library.compare([touch])
    assert {stage for stage, _ in hashed} == {"descriptions"}
    hashed.clear()
    search_roughly(library, 1, comparison)
    assert {stage for stage, _ in hashed} == {"places"}
    assert not any(model.store.built for model in library.models)
    hashed.clear()
    search_roughly(library, 1, comparison)
    assert hashed == []


def test_damaged_descriptors_are_found_and_computed_again_at_use(open_library, touch, root):
    truth = open_library().compare([touch])
    library = open_library()
    flip_last_byte(list(root.glob("descriptions/*/vectors.npy")))
    found = library.compare([touch])
    assert [model.store.built[0].stage for model in library.models] == ["descriptions"] * len(NAMES)
    assert np.array_equal(found.nats, truth.nats)


def test_damaged_places_are_found_and_built_again_at_use(open_library, touch, root):
    whole = open_library()
    truth = search_roughly(whole, 1, whole.compare([touch]))
    library = open_library()
    comparison = library.compare([touch])
    flip_last_byte(list(root.glob("places/*/runs.npz")))
    assert search_roughly(library, 1, comparison) == truth
    assert [[key.stage for key in model.store.built] for model in library.models] == [[], ["places"]]


def test_what_is_kept_in_memory_stays_below_the_bound(open_library, touch, monkeypatch):
    free = open_library()
    truth = identify([touch], free)
    one = max(model.loaded_bytes for model in free.models)
    everything = sum(model.loaded_bytes for model in free.models)
    assert one < everything == free.nbytes, "the descriptors are mapped, so they do not count"
    bound = one + 1000
    held: list[int] = []
    real = ByteCache.keep

    def keep(cache: ByteCache, key: object, value: object) -> None:
        real(cache, key, value)
        held.append(library.nbytes)

    library = open_library(most_bytes=bound)
    monkeypatch.setattr(ByteCache, "keep", keep)
    for _ in range(2):
        said = identify([touch], library)
        assert sum(model.loaded_bytes for model in library.models) <= library.nbytes <= bound
        assert [(o.name, o.probability, o.misfit, o.rough_misfit) for o in said.objects] == [
            (o.name, o.probability, o.misfit, o.rough_misfit) for o in truth.objects
        ]
        assert np.array_equal(said.best.found.best.T_sensor_object, truth.best.found.best.T_sensor_object)
    assert 0 < max(held) <= bound


def test_a_released_localizer_gives_the_same_answer(open_library, touch):
    model = open_library().models[0]
    first = model.localize(touch)
    assert model.loaded_bytes > model.source.places.patches.nbytes
    model.release()
    assert model.loaded_bytes == 0
    again = model.localize(touch)
    assert not model.store.built
    assert [h.probability for h in again.hypotheses] == [h.probability for h in first.hypotheses]
    assert np.array_equal(again.best.T_sensor_object, first.best.T_sensor_object)


def test_describing_all_objects_stays_below_the_bound(open_library):
    library = open_library(most_bytes=1)
    (touch,) = library.models[0].simulate(1, seed=5, press_depth_m=9e-4)
    library.compare([touch])
    assert all("descriptions" in [key.stage for key in model.store.built] for model in library.models)
    assert [model.loaded_bytes for model in library.models] == [0, 0]
