"""Every pair of options of two slots occurs in a combination that locates a touch."""

import importlib.util
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import strange_matchers

from tactile_loc import ObjectModel, StageStore
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.slots import registry as registry_module
from tactile_loc.slots.code import find_plugins
from tactile_loc.slots.registry import PROJECT, registry

ROOT = Path(__file__).parents[1]
OUTLINE = ROOT / "plugins_contrib" / "tactile-loc-outline"
HOPF, FACE, MOCO = ("grid", "hopf"), ("grid", "face"), ("encoder", "moco")
Pair = frozenset[tuple[str, str]]


def loaded() -> ModuleType:
    """The benchmark of all combinations, whose options and limits these tests use."""
    spec = importlib.util.spec_from_file_location("benchmark_combinations", ROOT / "benchmarks" / "combinations.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bench = loaded()
OPTIONS: dict[str, tuple[str, ...]] = bench.OPTIONS


def all_pairs(options: Mapping[str, Sequence[str]]) -> list[Pair]:
    """Return all pairs of options of two slots."""
    named = [[(slot, name) for name in names] for slot, names in options.items()]
    return [frozenset(pair) for a, b in itertools.combinations(named, 2) for pair in itertools.product(a, b)]


def pairs_of(row: Mapping[str, str]) -> set[Pair]:
    """Return the pairs of options in a combination."""
    return {frozenset(pair) for pair in itertools.combinations(row.items(), 2)}


def pairwise(options: Mapping[str, Sequence[str]]) -> list[dict[str, str]]:
    """Return a small set of combinations that contains all pairs of options.

    Each combination begins with a missing pair. Each other slot gets the option that adds most missing pairs, or the
    first of several equal ones.
    """
    slots = sorted(options, key=lambda slot: -len(options[slot]))
    missing = dict.fromkeys(all_pairs({slot: options[slot] for slot in slots}))
    rows = []
    while missing:
        row = dict(next(iter(missing)))
        for slot in (slot for slot in slots if slot not in row):
            added = [len(pairs_of({**row, slot: name}) & missing.keys()) for name in options[slot]]
            row[slot] = options[slot][int(np.argmax(added))]
        rows.append({slot: row[slot] for slot in options})
        for pair in pairs_of(row) & missing.keys():
            del missing[pair]
    return rows


ROWS = pairwise(OPTIONS)


class Outline:
    """The entry point of the contributed encoder, installed from its folder."""

    name, value, group = "outline", "tactile_loc_outline", PROJECT
    dist = SimpleNamespace(name="tactile-loc-outline")

    def load(self) -> Any:
        return importlib.import_module(self.value)


@pytest.fixture(scope="module", autouse=True)
def installed() -> Iterator[None]:
    """Install the contributed encoder and the strange matchers beside the built-in components."""
    found = [point for point in find_plugins() if registry_module._is_built_in(point)]
    plugins = [*found, Outline(), strange_matchers.Stranger()]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(OUTLINE))
        patch.setattr(registry_module, "find_plugins", lambda: plugins)
        registry.cache_clear()
        yield
    registry.cache_clear()


@pytest.fixture(scope="module")
def shared_store(tmp_path_factory: pytest.TempPathFactory) -> StageStore:
    """One store for all combinations and all test processes."""
    folder = tmp_path_factory.getbasetemp()
    return StageStore((folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "combinations")


@pytest.fixture(scope="module")
def box() -> ObjectModel:
    return bench.chamfered_box()


def test_the_combinations_contain_all_pairs_of_options():
    assert set().union(*map(pairs_of, ROWS)) == set(all_pairs(OPTIONS))
    assert len(ROWS) <= 26, "24 is the minimum: each renderer with each refiner"


def test_the_options_are_all_installed_components():
    names = {slot: set(registry().names(slot)) for slot in OPTIONS}
    names["matcher"] -= strange_matchers.SPECS.keys()
    assert names == {slot: set(some) for slot, some in OPTIONS.items()}


def make_smaller(row: Mapping[str, str], patch: pytest.MonkeyPatch) -> None:
    """Use coarser grids and less training than the benchmark, just enough to meet its limits."""
    coarser = {FACE: {"spacing_mm": 3.0}, HOPF: {"spacing_mm": 3.5}}
    if row["renderer"] == "pyrender":  # it draws each pose separately
        coarser[HOPF]["spacing_mm"] = 5.0
    for key, options in {**coarser, MOCO: {"queries": 128}}.items():
        patch.setitem(bench.SMALL, key, {**bench.SMALL[key], **options})
    if row["encoder"] == "moco":
        patch.setattr("tactile_loc.plugins.encoders.moco.training.VALIDATION_TOUCHES", 32)


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("row", ROWS, ids=lambda row: "-".join(row.values()))
def test_a_combination_locates_a_touch(row, box, shared_store, monkeypatch):
    make_smaller(row, monkeypatch)
    found = bench.try_combination(row, box, shared_store)
    assert not found["refused"]
    assert not found["failed"], found
    assert set(found["errors_mm"]) == ({"2"} if row["fuser"] == "kinematic" else {"1", "2"})


@pytest.mark.slow
@pytest.mark.parametrize("grid", OPTIONS["grid"])
def test_inverted_scores_locate_the_wrong_pose(grid, box, shared_store, monkeypatch):
    """The other components do not find the pose without the encoder and the matcher."""
    scores = DenseMatcher.scores
    monkeypatch.setattr(DenseMatcher, "scores", lambda *words: -scores(*words))
    turned_round = {**ROWS[0], "grid": grid, "encoder": "pixel", "matcher": "dense", "refiner": "none"}
    make_smaller(turned_round, monkeypatch)
    assert "mm off" in bench.try_combination(turned_round, box, shared_store)["failed"]


@pytest.mark.parametrize("grid", OPTIONS["grid"])
def test_a_matcher_without_weights_locates_with_every_grid(grid, box, shared_store, monkeypatch):
    pytest.importorskip("open3d")
    combination = {**ROWS[0], "grid": grid, "encoder": "pixel", "matcher": "listed"}
    make_smaller(combination, monkeypatch)
    row = bench.try_combination(combination, box, shared_store)
    assert (row["refused"], row["failed"]) == ("", "")
