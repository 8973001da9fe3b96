"""A sweep in this process, on local processes and on a Dask cluster: one table, every stage built once."""

import csv
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import Localizer, Plan, StageStore, load_object, write_sweep
from tactile_loc.core.runtime.errors import MissingLibraryError
from tactile_loc.evaluation.jobs import FinishedJobs, JobOutcome, do_job
from tactile_loc.evaluation.protocol import evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.sweep.sweep import MOMENTARY, Row, Sweep, run_sweep
from tactile_loc.evaluation.sweep.tables import format_summary
from tactile_loc.evaluation.workers import ClusterError, DaskWorkers, LocalWorkers
from tactile_loc.io.config import EXACT
from tactile_loc.plugin import Progress

distributed = pytest.importorskip("distributed")


class Watched(Progress):
    """Records the notes that were shown."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


class Nobody:
    """Workers that must get no job."""

    def run_jobs(self, jobs, objects):
        raise AssertionError(f"{len(jobs)} jobs were run again")


class Here:
    """Does the jobs in this process, which takes less time than starting others."""

    def run_jobs(self, jobs, objects):
        for job in jobs:
            yield do_job(job, objects[job.key])


@pytest.fixture(scope="module")
def plan(tiny) -> Plan:
    return Plan.from_values(
        {**tiny, "object": ["pin", "head"], "encoder": {"name": "pixel", "cells": 12}, "refiner": ["none", "filterreg"]}
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("sweeps")


@pytest.fixture(scope="module")
def swept(plan, folder) -> Sweep:
    return run_sweep(plan, folder / "here", folder / "store-here", Here())


@pytest.fixture(scope="module")
def locally(plan, folder) -> Sweep:
    before = dict(os.environ)
    swept = run_sweep(
        plan, folder / "local", folder / "store-local", LocalWorkers(2, 1, folder / "local" / "workers.log")
    )
    assert dict(os.environ) == before
    return swept


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with distributed.LocalCluster(n_workers=2, processes=True, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def on_dask(plan, folder, address) -> Sweep:
    return run_sweep(plan, folder / "dask", folder / "store-dask", DaskWorkers(address))


def lasting(rows: list[Row]) -> list[Row]:
    return [{name: value for name, value in row.items() if name not in MOMENTARY} for row in rows]


@pytest.mark.slow
def test_local_processes_and_dask_give_the_same_table(swept, locally, on_dask):
    assert lasting(locally.rows) == lasting(on_dask.rows) == lasting(swept.rows)
    assert [row["error"] for row in locally.rows] == [""] * 4


@pytest.mark.slow
@pytest.mark.parametrize("which", ["locally", "on_dask"])
def test_every_stage_is_built_once(which, request, folder):
    swept = request.getfixturevalue(which)
    built = Counter(name for row in swept.rows for name in json.loads(row["built"]))
    assert set(built.values()) == {1}
    store = StageStore(folder / ("store-local" if which == "locally" else "store-dask"))
    assert set(built) == {f"{entry.stage} {entry.digest}" for entry in store.entries()}
    assert swept.built | {"bank": 0} == {"field": 2, "grid": 2, "shapes": 2, "evaluation": 4, "bank": 0}
    seconds = [row["model_s"] for row in swept.rows]
    assert (
        sum(s > 0 for s in seconds) >= 2
    )  # the first row of each object; another row may build a part at the same time


def test_a_row_holds_the_values_of_the_protocol(swept, tmp_path):
    one, row = swept.combinations[3], swept.rows[3]
    localizer = Localizer(one.config, load_object("head"), StageStore(tmp_path))
    found = evaluate(localizer, 4, SimulatedTouches("strong", 0, renderer=EXACT))
    assert row["reg-1_median_mm"] == pytest.approx(1e3 * np.median(found.errors_m("reg-1", "add")), rel=1e-4)
    assert row["best-1_mean_mm"] == pytest.approx(1e3 * found.errors_m("best-1", "add").mean(), rel=1e-4)
    assert row["closest_median_share"] == pytest.approx(row["closest_median_mm"] / row["random_mean_mm"], rel=1e-4)
    assert (row["object"], row["refiner"], row["grid_poses"]) == ("head", "filterreg", localizer.model.size)
    assert row["chosen_ms"] >= row["reg-1_ms"] >= row["match_ms"] > 0


def test_a_finished_sweep_repeats_nothing_and_removes_partial_files_of_a_killed_one(plan, swept, folder):
    before = sorted(path.name for path in (folder / "here/rows").iterdir())
    for left in (folder / "here/rows" / f".tmp-new-{before[0]}", folder / "here/errors/.tmp-new-x.txt"):
        left.mkdir(parents=True)
    again = run_sweep(plan, folder / "here", folder / "elsewhere", Nobody())
    assert again.rows == swept.rows
    assert not again.done
    assert sorted(path.name for path in (folder / "here/rows").iterdir()) == before
    assert not list((folder / "here/errors").iterdir())


@pytest.mark.slow
def test_only_missing_rows_are_computed(plan, locally, folder):
    gone = locally.combinations[2]
    path = folder / "local" / "rows" / f"{gone.key}.json"
    path.unlink()
    watched = Watched()
    again = run_sweep(plan, folder / "local", folder / "store-local", LocalWorkers(2, 1, folder / "log"), watched)
    assert (len(again.done), again.evaluated) == (1, 0)
    assert watched.notes == ["head pixel none"]
    assert lasting(again.rows) == lasting(locally.rows)
    assert again.rows[2]["built"] == "[]"  # the evaluation is in the store
    assert again.rows[2]["model_s"] == 0


def test_a_larger_plan_reuses_the_rows_of_a_smaller_plan(swept, folder, tiny):
    smaller = Plan.from_values(
        {**tiny, "object": "pin", "encoder": {"name": "pixel", "cells": 12}, "refiner": ["filterreg"]}
    )
    found = run_sweep(smaller, folder / "here", folder / "elsewhere", Nobody())
    assert found.rows[0]["reg-1_median_mm"] == swept.rows[1]["reg-1_median_mm"]


def test_a_sweep_writes_its_tables(swept, folder):
    written = write_sweep(folder / "written", swept, "reg-1")
    tables = [f"sweep.{suffix}" for suffix in ("json", "csv", "md")]
    assert [path.name for path in written] == [*tables, "differences.csv", "touches.csv"]
    record: dict[str, Any] = json.loads(written[0].read_text())
    rows = [{k: v for k, v in row.items() if k != "configuration"} for row in record["rows"]]
    assert rows == swept.rows
    with written[1].open() as file:
        assert [(row["object"], row["key"]) for row in csv.DictReader(file)] == [
            (row["object"], row["key"]) for row in rows
        ]
    assert (record["combinations"], record["failed"], record["built"]) == (4, 0, swept.built)
    assert record["plan"]["refiner"][1]["name"] == "filterreg"
    assert {"tactile-loc", "python", "numpy"} <= set(record["versions"])
    assert record["rows"][1]["configuration"]["grid"]["options"]["spacing_mm"] == 8.0


@pytest.mark.parametrize("where", ["nowhere", "tcp://127.0.0.1:1"])
def test_a_missing_cluster_gives_an_error(plan, tmp_path, where, monkeypatch):
    monkeypatch.setattr("tactile_loc.evaluation.workers.CONNECT_S", 1)
    with pytest.raises(ClusterError, match=naming("Dask", where)):
        run_sweep(plan, tmp_path, tmp_path, DaskWorkers(where))


def test_a_missing_dask_gives_an_error_with_the_package_to_install(plan, tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingLibraryError, match=naming("pip install 'tactile-loc[sweep]'")):
        run_sweep(plan, tmp_path, tmp_path, DaskWorkers("tcp://127.0.0.1:1"))


def test_a_row_is_stored_and_read_back_and_a_traceback_is_removed_after_a_success(tmp_path):
    kept, trace = FinishedJobs(tmp_path / "out"), tmp_path / "out" / "errors" / "k.txt"
    assert kept.read("k") is None
    kept.write(JobOutcome("k", None, (), "ValueError: no", "Traceback ...\nValueError: no"), {})
    assert trace.read_text().endswith("ValueError: no")
    assert kept.read("k") == JobOutcome("k", None, (), "ValueError: no")
    outcome = JobOutcome("k", {"chosen_ms": 0.1}, ("grid 1", "bank 2"))
    kept.write(outcome, {"configuration": {"seed": 3}})
    assert kept.read("k") == outcome
    assert json.loads((tmp_path / "out" / "rows" / "k.json").read_text())["configuration"] == {"seed": 3}
    assert not trace.exists()
    for text in ("", "{", "[]", '{"key": "k"}'):
        (tmp_path / "out" / "rows" / "k.json").write_text(text)
        assert kept.read("k") is None, "an unreadable row counts as missing"


@pytest.fixture(scope="module")
def renderers(tiny, folder):
    """One object with three renderers, which see the border of contact differently."""
    values = {**tiny, "object": "elbow_pipe", "renderer": ["heightmap", "zbuffer"], "refiner": "none"}
    plan = Plan.from_values({**values, "option": {"grid": {"spacing_mm": [6], "min_contact_percent": [2]}}})
    return run_sweep(plan, folder / "renderers", folder / "store-renderers", Here())


def test_a_renderer_changes_neither_the_grid_nor_the_random_poses_nor_the_touches(renderers):
    first, *others = renderers.rows
    shared = ("grid_poses", "grid_id", "touches_id", "random_mean_mm", "random-10_median_mm", "closest_median_mm")
    for row in others:
        assert {name: row[name] for name in shared} == {name: first[name] for name in shared}
    assert renderers.find_changed() == {}


def test_another_spacing_changes_the_grid_and_another_sensor_the_touches_too(tiny, folder):
    values = {**tiny, "object": "pin", "refiner": "none", "sensor": [*tiny["sensor"], "gelsight-mini"]}
    plan = Plan.from_values({**values, "option": {"grid": {"spacing_mm": [8, 10]}}})
    found = run_sweep(plan, folder / "grids", folder / "store-grids", Here())
    assert found.find_changed() == {"sensor": ("grid", "touches"), "grid": ("grid",)}
    said = format_summary(found, "chosen").partition("Not all else is equal")[2]
    assert "`sensor` also changes the grid and the touches; `grid` also changes the grid" in said
