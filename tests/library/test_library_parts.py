"""The parts of a library on disk give the answers that localizers of the same meshes give, and are opened when used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.runtime.errors import ConfigError, LibraryError
from tactile_loc.io.config import RunConfig, SlotConfig
from tactile_loc.library.building import build_library, list_meshes
from tactile_loc.library.folder import LibraryFolder
from tactile_loc.locate.localizer import Localizer
from tactile_loc.tasks.identify import identify
from tactile_loc.tasks.library import Library
from tactile_loc.tasks.library_parts import Parts, StoredParts
from tactile_loc.tasks.shortlist import Shortlist

pytest.importorskip("pyarrow")

FEW = SlotConfig(name="whole", options={"directions": 300})
SETTINGS = {"sensor": "gelsight-mini", "temperature": 0.05}


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("meshes")
    solids = {
        "plate": trimesh.creation.box((30, 20, 6)),
        "rod": trimesh.creation.cylinder(4, 40, sections=32),
        "ring": trimesh.creation.annulus(6, 11, 8, sections=32),
    }
    for name, solid in solids.items():
        solid.export(folder / f"{name}.stl")
    return [str(folder / f"{name}.stl") for name in solids]


@pytest.fixture(scope="module")
def folder(meshes, tmp_path_factory) -> LibraryFolder:
    path = tmp_path_factory.mktemp("library")
    build_library(path, list_meshes(meshes, units="mm"), FEW)
    return LibraryFolder.open(path)


@pytest.fixture(scope="module")
def parts(folder, store) -> StoredParts:
    return StoredParts(folder, RunConfig.from_dict(SETTINGS), store)


def test_the_sizes_of_stored_parts_are_those_of_their_meshes(parts):
    assert parts.names == ("plate", "ring", "rod")
    assert parts.extents_m == pytest.approx(np.array([[30, 20, 6], [22, 22, 8], [8, 8, 40]]) * 1e-3, rel=1e-3)


def test_objects_of_the_same_size_are_found_in_any_order_of_the_axes(parts, monkeypatch):
    library = Library(parts)
    sizes_mm = np.array([[30, 20, 6], [6.05, 30, 20], [30, 20.2, 6]])
    monkeypatch.setattr(library.models, "extents_m", 1e-3 * sizes_mm)
    assert library.find_same_size([0]) == [1]
    assert library.find_same_size([1, 0]) == library.find_same_size([2]) == library.find_same_size([]) == []


def test_a_stored_library_answers_like_localizers_of_its_meshes(parts, meshes, store):
    grid = {"name": "whole", "directions": 300}
    given = Library([Localizer.create(path, units="mm", store=store, grid=grid, **SETTINGS) for path in meshes])
    touches = parts[1].simulate(1, seed=7, press_depth_m=9e-4)
    one, other = (identify(touches, library) for library in (Library(parts), given))
    assert [o.name for o in one.objects] == [o.name for o in other.objects]
    assert [o.probability for o in one.objects] == pytest.approx([o.probability for o in other.objects], abs=0.02)
    assert one.best is not None
    assert one.best.name == parts.names[1]


def test_describing_parts_opens_no_localizer(parts, monkeypatch):
    library = Library(parts)
    touches = parts[0].simulate(1, seed=7, press_depth_m=9e-4)
    monkeypatch.setattr(StoredParts, "__getitem__", lambda *_: pytest.fail("a localizer was opened"))
    comparison = library.compare(touches)
    assert np.isfinite(comparison.nats).all()
    assert parts.names[int(comparison.nats.argmax())] == parts.names[0]
    assert library.nbytes < 1e5, "mapped arrays do not count"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_comparison_for_a_shortlist_chooses_the_same_parts(parts, count):
    library, shortlist = Library(parts), Shortlist(1.0, 1, 2)
    for model in parts:
        touches = model.simulate(count, seed=7, press_depth_m=9e-4)
        touches = [replace(touch, T_base_sensor=invert(touch.T_sensor_object)) for touch in touches]
        exact, found = library.compare(touches).nats, library.compare(touches, shortlist).nats
        chosen = shortlist.choose(exact)
        assert shortlist.choose(found) == chosen
        assert np.array_equal(found[chosen], exact[chosen])
        assert (found >= exact).all()


def test_one_pass_through_the_shards_compares_the_parts_that_are_left(folder, store):
    left = replace(folder, rows={name: row for name, row in folder.rows.items() if name != folder.names[1]})
    parts = StoredParts(left, RunConfig.from_dict(SETTINGS), store)
    describe, touches = Library(parts).describe, np.random.default_rng(3).normal(0, 3000, (2, 128)).astype(np.int16)
    done: list[int] = []
    found = parts.find_most_similar(touches, describe, done.append)
    assert np.array_equal(found, Parts.find_most_similar(parts, touches, describe, lambda count: None))
    assert sum(done) == len(parts) == 2


def test_a_grid_of_its_own_is_refused(folder, store):
    config = RunConfig.from_dict({**SETTINGS, "grid": {"name": "whole", "directions": 500}})
    with pytest.raises(ConfigError, match=naming(str(folder.path))):
        StoredParts(folder, config, store)


def test_vectors_of_other_weights_are_refused(folder, store):
    other = replace(folder, manifest=folder.manifest.model_copy(update={"descriptor": "0" * 64}))
    with pytest.raises(LibraryError, match=naming(str(folder.path))):
        StoredParts(other, RunConfig.from_dict(SETTINGS), store)


def test_an_empty_library_is_refused(meshes, store, tmp_path: Path):
    build_library(tmp_path, list_meshes(meshes[:1], units="mm"), FEW)
    empty = LibraryFolder.open(tmp_path).remove(["plate"])
    with pytest.raises(LibraryError, match=naming(str(tmp_path))):
        StoredParts(empty, RunConfig.from_dict(SETTINGS), store)
