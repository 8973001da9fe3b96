"""Combinations that fail, and workers that die: the sweep goes on."""

from __future__ import annotations

import importlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from faulty import install

from tactile_loc.core.errors import PluginError
from tactile_loc.core.registry import registry
from tactile_loc.sweeps import work as work_module
from tactile_loc.sweeps.cluster import DaskWorkers
from tactile_loc.sweeps.combinations import combine
from tactile_loc.sweeps.local import LocalWorkers
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.sweep import Sweep, run_sweep
from tactile_loc.sweeps.work import Job, work


@pytest.fixture(autouse=True, scope="module")
def faults(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Refiners that fail, for this process and its children."""
    site = str(install(tmp_path_factory.mktemp("faults") / "site"))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        patch.setenv("PYTHONPATH", os.pathsep.join([site, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))
        importlib.invalidate_caches()
        registry.cache_clear()
        yield
    registry.cache_clear()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("faulty")


def sweep(tiny: dict[str, Any], refiners: list[Any], out: Path, store: Path, workers: Any = None) -> Sweep:
    values = {**tiny, "object": ["pin", "head"], "refiner": refiners, "count": 1, "noise": "none"}
    return run_sweep(Plan.from_values(values), out, store, workers or LocalWorkers(2, 3, out / "workers.log"))


def errors(swept: Sweep) -> dict[tuple[str, str], str]:
    return {(row["object"], row["refiner"]): row["error"] for row in swept.rows}


def test_a_combination_that_fails_is_a_row_and_tried_again(tiny, folder, tmp_path):
    refiners = ["none", "raising", "grumbling", "telling"]
    swept = sweep(tiny, refiners, tmp_path, folder / "store")
    assert swept.failed == 6
    for name in ("pin", "head"):
        assert errors(swept)[name, "none"] == ""
        assert errors(swept)[name, "raising"] == "ValueError: nothing works at all"
        assert errors(swept)[name, "grumbling"] == "this touch cannot be refined; take another"
        assert errors(swept)[name, "telling"] == "ValueError: 3 3 3 3"  # the threads that were asked for
    traces = {path.stem: path.read_text() for path in (tmp_path / "errors").iterdir()}
    assert set(traces) == {row["key"] for row in swept.rows if "ValueError" in row["error"]}
    assert all("sweep_faults_parts.py" in text for text in traces.values())
    again = sweep(tiny, refiners, tmp_path, folder / "store")
    assert again.done == 6


def test_a_local_worker_that_is_killed_costs_only_time(tiny, folder, tmp_path):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally")}
    swept = sweep(tiny, ["none", lethal], tmp_path / "out", tmp_path / "store")
    assert (tmp_path / "tally").read_text() == "x"
    assert set(errors(swept).values()) == {""}
    built = Counter(name for row in swept.rows for name in json.loads(row["built"]))
    assert set(built.values()) == {1}
    assert (swept.built["grid"], swept.built["shapes"], swept.built["evaluation"]) == (2, 2, 4)


def test_what_kills_its_worker_every_time_is_a_row_that_says_so(tiny, folder, tmp_path):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally"), "deaths": 99}
    swept = sweep(tiny, ["none", lethal], tmp_path / "out", folder / "store")
    assert len((tmp_path / "tally").read_text()) == 6  # three times for each object
    for (_, refiner), error in errors(swept).items():
        assert ("was killed (SIGKILL), 3 times" in error and "workers.log" in error) == (refiner == "lethal")


def test_what_a_killed_worker_has_built_is_still_counted(tiny, tmp_path):
    combinations, objects = combine(Plan.from_values({**tiny, "object": "pin", "refiner": "raising", "count": 1}))
    (one,) = combinations
    journal = tmp_path / work_module.JOURNALS / f"{one.key}.txt"
    journal.parent.mkdir(parents=True)
    journal.write_text("grid 0123456789abcdef\n")
    outcome = work(Job(one.key, one.config, 1, tmp_path), objects["pin"])
    assert outcome.built[0] == "grid 0123456789abcdef"
    assert outcome.built[1].startswith("grid ")
    assert not journal.exists()


def test_a_worker_with_other_versions_refuses(tiny, tmp_path):
    (one,), objects = combine(Plan.from_values({**tiny, "object": "pin", "refiner": "none"}))
    outcome = work(Job("0" * 16, one.config, one.count, tmp_path), objects["pin"])
    assert "install the same versions" in outcome.error
    assert not outcome.trace


def test_a_refiner_that_is_not_there_is_refused_before_anything_runs(tiny, tmp_path):
    with pytest.raises(PluginError, match="raisin"):
        sweep(tiny, ["none", "raisin"], tmp_path / "out", tmp_path / "store")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def cluster(faults):
    distributed = pytest.importorskip("distributed")
    settings = {"n_workers": 2, "processes": True, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as cluster:
        yield cluster


def test_a_dask_worker_that_is_killed_costs_only_time(tiny, tmp_path, cluster):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally")}
    workers = DaskWorkers(cluster.scheduler_address)
    swept = sweep(tiny, ["none", lethal, "raising"], tmp_path / "out", tmp_path / "store", workers)
    assert (tmp_path / "tally").read_text() == "x"
    assert errors(swept)["pin", "lethal"] == errors(swept)["head", "lethal"] == ""
    assert errors(swept)["pin", "raising"] == "ValueError: nothing works at all"
    built = Counter(name for row in swept.rows for name in json.loads(row["built"]))
    assert set(built.values()) == {1}
    assert (swept.built["grid"], swept.built["shapes"]) == (2, 2)


def test_what_kills_dask_workers_every_time_takes_nobody_with_it(tiny, folder, tmp_path, cluster, monkeypatch):
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)  # the first death is enough, for neighbours as well
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally"), "deaths": 99}
    swept = sweep(tiny, [lethal, "none"], tmp_path / "out", folder / "store", DaskWorkers(cluster.scheduler_address))
    for (_, refiner), error in errors(swept).items():
        assert error.startswith("its Dask workers died") == (refiner == "lethal")
    assert errors(swept)["pin", "none"] == errors(swept)["head", "none"] == ""
