"""The parts of a library are compared, searched and identified as localizers of their meshes are located."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import naming
from tactile_loc import Localizer, PoseMetric, RobotTouches, RunConfig, TactileLocError, Touch, identify, make_noise
from tactile_loc.plugin import ConfigError, registry
from tactile_loc.plugin.helpers import ByteCache, invert
from tactile_loc.plugins.grids.whole import WholeGrid

from tactile_loc_library import identification, similarity
from tactile_loc_library import search as module
from tactile_loc_library.building import build_library, list_meshes
from tactile_loc_library.identification import LOCATED, find_candidates, identify_part
from tactile_loc_library.library import Library
from tactile_loc_library.record import LibraryError, PlaceGrid
from tactile_loc_library.search import PartSearch, RoughFit, open_localizer
from tactile_loc_library.votes import Shortlist

FEW = PlaceGrid("whole", {"directions": 300})
SETTINGS = {"sensor": "gelsight-mini", "temperature": 0.05}
ONE = Shortlist(0.0, 1, 1)


@pytest.fixture(scope="module")
def solids(tmp_path_factory) -> list[str]:
    """Mesh files of a plate, a ring, a rod, and a ring that is turned and has a wider hole."""
    folder = tmp_path_factory.mktemp("solids")
    wider = trimesh.creation.annulus(5, 11, 8, sections=32)
    wider.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    solids = {
        "plate": trimesh.creation.box((30, 20, 6)),
        "ring": trimesh.creation.annulus(6, 11, 8, sections=32),
        "rod": trimesh.creation.cylinder(4, 40, sections=32),
        "wider-ring": wider,
    }
    for name, solid in solids.items():
        solid.export(folder / f"{name}.stl")
    return [str(folder / f"{name}.stl") for name in solids]


@pytest.fixture(scope="module")
def library(solids, tmp_path_factory) -> Library:
    return build_library(tmp_path_factory.mktemp("library"), list_meshes(solids, units="mm"), FEW).library


@pytest.fixture(scope="module")
def open_search(library, store):
    """Return a function that opens the search of some parts, as a new process would."""

    def open_some(*names: str, **limits: int) -> PartSearch:
        some = dataclasses.replace(library, rows={name: library.rows[name] for name in names or library.names})
        return PartSearch(some, RunConfig.from_dict(SETTINGS), store, **limits)

    return open_some


@pytest.fixture(scope="module")
def search(open_search) -> PartSearch:
    """The search of the plate, the ring and the rod."""
    return open_search("plate", "ring", "rod")


@pytest.fixture(scope="module")
def touches(search) -> dict[str, list[Touch]]:
    """Two touches of each part, from another renderer."""
    renderer, rng, found = registry().create("renderer", "zbuffer", {}), np.random.default_rng(3), {}
    for k, name in enumerate(search.names):
        with search.use(k) as part:
            source = RobotTouches(part.model.object, part.model.scene.geometry, renderer, (0.7, 0.9))
            found[name] = source.draw_example(2, rng)[0]
    return found


def test_the_parts_give_the_answer_of_localizers_of_their_meshes(search, solids, store, touches):
    grid = {"name": "whole", "directions": 300}
    models = [Localizer.create(path, units="mm", store=store, grid=grid, **SETTINGS) for path in solids[:3]]
    one, other = identify_part(touches["ring"], search), identify(touches["ring"], models)
    assert [o.name for o in one.objects] == [o.name for o in other.objects]
    assert [o.probability for o in one.objects] == pytest.approx([o.probability for o in other.objects], abs=0.02)
    assert one.best is not None
    assert one.best.name == "ring"


def test_only_the_part_with_the_best_rough_fit_is_located(search, touches):
    said = identify_part(touches["ring"], search, located=1)
    assert [one.name for one in said.objects if one.found is not None] == ["ring"]
    assert {one.probability for one in said.objects if one.found is None} == {0.0}
    candidates = find_candidates(touches["ring"], search)
    assert candidates.choose(ONE) == [search.names.index("ring")]
    assert [one.name for one in said.objects] == [search.names[k] for k in candidates.order]


def test_a_part_of_the_same_size_as_the_best_one_gets_a_rough_fit(open_search, search, touches, monkeypatch):
    for name in ("EXAMINED", "LOOKED_INTO"):
        monkeypatch.setattr(identification, name, ONE)
    alone = find_candidates(touches["ring"], search)
    assert [fit.iou > 0 for fit in alone.fits] == [False, True, False], "only the most similar part is searched"
    assert alone.alike.argmax() == 1
    said = identify_part(touches["ring"], open_search(), located=2)
    assert {one.name for one in said.objects if one.found is not None} == {"ring", "wider-ring"}
    first, second = said.objects[:2]
    assert first.probability == pytest.approx(second.probability, rel=0.01), "both touches are beside the hole"
    assert (first.name, second.name) == ("ring", "wider-ring"), "equally probable parts are listed by name"


def test_parts_of_the_same_size_as_many_others_are_searched_by_their_votes(search, touches, monkeypatch):
    searched: list[int] = []
    order = np.argsort(-search.compare(touches["ring"]).nats)
    for name in ("EXAMINED", "LOOKED_INTO", "LOCATED"):
        monkeypatch.setattr(identification, name, ONE)
    monkeypatch.setattr(identification, "MOST_OF_SAME_SIZE", 1)
    monkeypatch.setattr(search, "find_same_size", lambda some: [k for k in range(len(search)) if k not in some])
    monkeypatch.setattr(search, "look_into", lambda k, *_: searched.append(k) or RoughFit(1.0, 0.5))
    find_candidates(touches["ring"], search)
    assert searched == order[:2].tolist()


def test_parts_of_the_same_size_are_found_in_any_order_of_the_axes(search, library):
    row = library.rows["plate"]
    sizes_mm = [(30, 20, 6), (6.05, 30, 20), (30, 20.2, 6)]
    rows = {f"part-{k}": dataclasses.replace(row, x_mm=x, y_mm=y, z_mm=z) for k, (x, y, z) in enumerate(sizes_mm)}
    some = PartSearch.__new__(PartSearch)
    some._rows = list(rows.values())
    assert some.find_same_size([0]) == [1]
    assert some.find_same_size([1, 0]) == some.find_same_size([2]) == some.find_same_size([]) == []


@pytest.mark.parametrize("name", ["plate", "ring", "rod"])
def test_noisy_touches_fit_their_own_part_best(search, name):
    own, renderer = search.names.index(name), registry().create("renderer", "zbuffer", {})
    with search.use(own) as part:
        noise = make_noise("mild")
        source = RobotTouches(part.model.object, part.model.scene.geometry, renderer, (0.7, 0.9), noise=noise)
    noisy, _ = source.draw_example(2, np.random.default_rng(8))
    votes = search.compare(noisy)
    rough = [search.look_into(k, votes, search.examine(k, votes)) for k in range(len(search))]
    assert min(rough) == rough[own]
    assert rough[own].misfit > 0
    assert 0.5 < rough[own].iou <= 1


def test_comparing_opens_no_part(open_search, touches, monkeypatch):
    search = open_search("plate", "ring", "rod")
    monkeypatch.setattr(PartSearch, "use", lambda *_: pytest.fail("a part was opened"))
    nats = search.compare(touches["rod"][:1]).nats
    assert search.names[int(nats.argmax())] == "rod"
    assert search.nbytes == 0, "mapped arrays do not count"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_comparison_for_a_shortlist_chooses_the_same_parts(search, count):
    shortlist = Shortlist(1.0, 1, 2)
    for k in range(len(search)):
        with search.use(k) as part:
            drawn = part.model.simulate(count, seed=7, press_depth_m=9e-4)
        some = [dataclasses.replace(touch, T_base_sensor=invert(touch.T_sensor_object)) for touch in drawn]
        exact, found = search.compare(some).nats, search.compare(some, shortlist).nats
        chosen = shortlist.choose(exact)
        assert shortlist.choose(found) == chosen
        assert np.array_equal(found[chosen], exact[chosen])
        assert (found >= exact).all()


def test_one_pass_through_the_shards_compares_the_parts_that_are_left(open_search):
    search, done = open_search("plate", "rod"), []
    touches = np.random.default_rng(3).normal(0, 3000, (2, 128)).astype(np.int16)
    found = search.find_most_similar(touches, done.append)
    every = [similarity.compare_vectors(search.describe(k).vectors, touches).max(axis=1) for k in range(2)]
    assert np.array_equal(found, np.stack(every, axis=1))
    assert sum(done) == len(search) == 2


def test_what_is_kept_in_memory_stays_below_the_bound(open_search, touches, monkeypatch):
    free = open_search("plate", "rod")
    truth = identify_part(touches["plate"], free)
    sizes = [free._kept._kept[k][1] for k in range(2)]
    assert sum(sizes) == free.nbytes
    bound, held, real = max(sizes) + 1000, [], ByteCache.keep
    search = open_search("plate", "rod", most_bytes=bound)

    def keep(cache: ByteCache, key: object, value: object) -> None:
        real(cache, key, value)
        held.append(search.nbytes)

    monkeypatch.setattr(ByteCache, "keep", keep)
    for _ in range(2):
        said = identify_part(touches["plate"], search)
        assert [(o.name, o.probability, o.misfit) for o in said.objects] == [
            (o.name, o.probability, o.misfit) for o in truth.objects
        ]
    assert 0 < max(held) <= bound


def test_a_touch_is_located_as_with_the_mesh(library, solids, store, monkeypatch):
    settings = {"sensor": "digit", "shape_px": 32, "temperature": 0.02}
    record, grid = library.read("plate"), {"name": "whole", "directions": 300}
    plain = Localizer.create(solids[0], units="mm", grid=grid, store=store, **settings)
    (touch,) = plain.simulate(1, seed=3)
    wanted = plain.localize(touch)
    monkeypatch.setattr(WholeGrid, "places", None)  # the places are not drawn again
    opened = open_localizer(record, store=store, **settings)
    assert opened.sampler.options.directions == 300
    found = opened.localize(touch)
    assert found.verdict == wanted.verdict
    assert found.best.imprint_iou == pytest.approx(wanted.best.imprint_iou, abs=0.01)
    assert PoseMetric(record.object).symmetric_distance(wanted.best.T_sensor_object, found.best.T_sensor_object) < 3e-4
    copied = pickle.loads(pickle.dumps(opened)).localize(touch)
    assert np.array_equal(copied.best.T_sensor_object, found.best.T_sensor_object)


def test_unsuitable_libraries_settings_and_records_are_refused(library, store, solids, tmp_path: Path):
    record = library.read("plate")
    with pytest.raises(ConfigError, match="leave out `grid`"):
        open_localizer(record, "digit", store, grid="whole")
    with pytest.raises(LibraryError, match="another version"):
        open_localizer(dataclasses.replace(record, places_version=99), "digit", store)
    config = RunConfig.from_dict({**SETTINGS, "grid": {"name": "whole", "directions": 500}})
    with pytest.raises(ConfigError, match=naming(str(library.path))):
        PartSearch(library, config, store)
    with pytest.raises(ConfigError, match="`encoder` pixel"):
        PartSearch(library, RunConfig.from_dict({**SETTINGS, "encoder": "moco"}), store)
    other = dataclasses.replace(library, manifest=library.manifest.model_copy(update={"descriptor": "0" * 64}))
    with pytest.raises(LibraryError, match=naming(str(library.path))):
        PartSearch(other, RunConfig.from_dict(SETTINGS), store)
    build_library(tmp_path, list_meshes(solids[:1], units="mm"), FEW)
    with pytest.raises(LibraryError, match=naming(str(tmp_path))):
        PartSearch(Library.open(tmp_path).remove(["plate"]), RunConfig.from_dict(SETTINGS), store)


def test_unsuitable_touches_and_numbers_are_refused(search, touches):
    with pytest.raises(ConfigError, match=naming(0)):
        identify_part(touches["plate"], search, located=0)
    lost = [dataclasses.replace(touch, T_base_sensor=None) for touch in touches["ring"]]
    with pytest.raises(ConfigError, match=naming("touch 1", "T_base_sensor")):
        identify_part(lost, search)
    with pytest.raises(TactileLocError, match="no touch"):
        identify_part([], search)
    assert LOCATED.most == 12
    assert module.KEPT_BYTES == 768 * 2**20
