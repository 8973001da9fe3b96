"""Any option of a slot works with any option of the others: all pairs of options occur in combinations that locate."""

from __future__ import annotations

import importlib.util
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import strange_matchers

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.slots import registry as registry_module
from tactile_loc.core.slots.compatibility import INCOMPATIBILITIES, require_compatible
from tactile_loc.core.slots.registry import PROJECT, registry
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.store.store import StageStore

ROOT = Path(__file__).parents[1]
OUTLINE = ROOT / "plugins_contrib" / "tactile-loc-outline"
HOPF, FACE, MOCO = ("grid", "hopf"), ("grid", "face"), ("encoder", "moco")
Pair = frozenset[tuple[str, str]]


def loaded() -> ModuleType:
    """The benchmark of the full product: what it locates with, these tests do."""
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
    """Return few combinations in which all pairs of options occur.

    Each begins with a pair that is still missing. Each other slot gets the option that adds most missing pairs; of as
    good ones the first.
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

    name, value = "outline", "tactile_loc_outline"
    dist = SimpleNamespace(name="tactile-loc-outline")

    def load(self) -> Any:
        return importlib.import_module(self.value)


@pytest.fixture(scope="module", autouse=True)
def installed() -> Iterator[None]:
    """The contributed encoder, and matchers of which some cannot weigh, beside the built-in components."""
    found = [point for point in entry_points(group=PROJECT) if registry_module._is_built_in(point)]
    plugins = [*found, Outline(), strange_matchers.Stranger()]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(OUTLINE))
        patch.setattr(registry_module, "entry_points", lambda group: plugins)
        registry.cache_clear()
        yield
    registry.cache_clear()


@pytest.fixture(scope="module")
def shared_store(tmp_path_factory: pytest.TempPathFactory) -> StageStore:
    """One store for all combinations, and for all processes that test them."""
    folder = tmp_path_factory.getbasetemp()
    return StageStore((folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "combinations")


@pytest.fixture(scope="module")
def box() -> ObjectModel:
    return bench.chamfered_box()


def test_all_pairs_of_options_occur():
    assert set().union(*map(pairs_of, ROWS)) == set(all_pairs(OPTIONS))
    assert len(ROWS) <= 26, "24 is the least: each renderer with each refiner"


def test_the_options_are_all_that_are_built_in_and_one_that_is_contributed():
    names = {slot: set(registry().names(slot)) for slot in OPTIONS}
    names["matcher"] -= strange_matchers.SPECS.keys()
    assert names == {slot: set(some) for slot, some in OPTIONS.items()}


def make_smaller(row: Mapping[str, str], patch: pytest.MonkeyPatch) -> None:
    """Coarser grids and less learning than the benchmark's: just enough for its limits."""
    coarser = {FACE: {"spacing_mm": 3.0}, HOPF: {"spacing_mm": 3.5}}
    if row["renderer"] == "pyrender":  # it draws each pose by itself
        coarser[HOPF]["spacing_mm"] = 5.0
    learning = {"queries": 128} if row["grid"] == "hopf" else {"epochs": 1, "queries": 64}  # all rotations take more
    for key, options in {**coarser, MOCO: learning}.items():
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


@pytest.mark.parametrize("grid", OPTIONS["grid"])
def test_the_least_alike_poses_are_not_the_right_ones(grid, box, shared_store, monkeypatch):
    """Encoder and matcher count: the other components do not find the pose by themselves."""
    scores = DenseMatcher.scores
    monkeypatch.setattr(DenseMatcher, "scores", lambda *words: -scores(*words))
    turned_round = {**ROWS[0], "grid": grid, "encoder": "pixel", "matcher": "dense", "refiner": "none"}
    make_smaller(turned_round, monkeypatch)
    assert "mm off" in bench.try_combination(turned_round, box, shared_store)["failed"]


def test_no_combination_is_refused_but_by_a_rule():
    """Of all combinations; a rule is a row of the table in docs/plugins.md."""
    slots = {"matcher": (*OPTIONS["matcher"], "listed", "plain")}
    made = {
        slot: {name: registry().create(slot, name, bench.SMALL.get((slot, name))) for name in names}
        for slot, names in {**OPTIONS, **slots}.items()
    }
    refused = set()
    for names in bench.combinations({**OPTIONS, **slots}):
        components = {slot: made[slot][name] for slot, name in names.items()}
        if any(rule.applies(components) for rule in INCOMPATIBILITIES):
            refused.add((names["grid"], names["matcher"]))
            with pytest.raises(ConfigError):
                require_compatible(components, names)
        else:
            require_compatible(components, names)
    assert refused == {("whole", "listed"), ("whole", "plain")}


@pytest.mark.parametrize("matcher", ["listed", "plain"])
@pytest.mark.parametrize("grid", OPTIONS["grid"])
def test_what_is_refused_is_refused_before_anything_is_built(grid, matcher, box, tmp_path):
    store = StageStore(tmp_path / "store")
    combination = {**ROWS[0], "grid": grid, "matcher": matcher}
    if grid != "whole":
        bench.make_localizer(combination, box, store)
        return
    with pytest.raises(ConfigError) as error:
        bench.make_localizer(combination, box, store)
    assert any(rule.reason in str(error.value) for rule in INCOMPATIBILITIES)
    assert store.built == []
    assert bench.try_combination(combination, box, store)["refused"] == str(error.value)
