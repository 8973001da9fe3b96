"""Combinations that fail, and workers that die: the sweep goes on."""

import importlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from faulty import install
from message_helpers import naming

from tactile_loc import ExampleTable, Plan, RunConfig
from tactile_loc.core.runtime.errors import UnknownPluginError
from tactile_loc.evaluation.jobs import do_job
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.protocol import LINES, TIMED
from tactile_loc.evaluation.sweep.combination import (
    COVERAGES,
    ERRORS,
    TIMES,
    TOUCHES,
    CombinationJob,
    combine,
    summarise,
)
from tactile_loc.evaluation.sweep.sweep import Sweep, run_sweep
from tactile_loc.evaluation.workers import DaskWorkers, LocalWorkers, run_on_dask
from tactile_loc.plugin import registry


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


BOTH = ("pin", "head")


def sweep(
    tiny: dict[str, Any], refiners: list[Any], out: Path, store: Path, workers: Any = None, objects: Any = BOTH
) -> Sweep:
    values = {**tiny, "object": list(objects), "refiner": refiners, "count": 1, "noise": "none"}
    return run_sweep(Plan.from_values(values), out, store, workers or LocalWorkers(2, 3, out / "workers.log"))


def errors(swept: Sweep) -> dict[tuple[str, str], str]:
    return {(row["object"], row["refiner"]): row["error"] for row in swept.rows}


def assert_built_once(swept: Sweep) -> None:
    """No stage was built twice. A worker that is killed takes along what it has just built from the rows."""
    built = Counter(name for row in swept.rows for name in json.loads(row["built"]))
    assert set(built.values()) == {1}


@pytest.mark.slow
def test_a_failed_combination_has_a_row_and_is_tried_again(tiny, folder, tmp_path):
    refiners = ["none", "raising", "grumbling", "telling"]
    swept = sweep(tiny, refiners, tmp_path, folder / "store")
    assert swept.failed == 6
    for name in ("pin", "head"):
        assert errors(swept)[name, "none"] == ""
        assert errors(swept)[name, "raising"] == "ValueError: nothing works at all"
        assert errors(swept)[name, "grumbling"] == "this touch cannot be refined; take another"
        assert errors(swept)[name, "telling"] == "ValueError: 3 3 3 3"  # the requested number of threads
    traces = {path.stem: path.read_text() for path in (tmp_path / "errors").iterdir()}
    assert set(traces) == {row["key"] for row in swept.rows if "ValueError" in row["error"]}
    assert all("sweep_faults_parts.py" in text for text in traces.values())
    again = sweep(tiny, refiners, tmp_path, folder / "store", LocalWorkers(1, 3, tmp_path / "workers.log"))
    assert len(again.done) == again.evaluated == 6


@pytest.mark.slow
def test_a_killed_local_worker_costs_only_time(tiny, folder, tmp_path):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally")}
    swept = sweep(tiny, ["none", lethal], tmp_path / "out", tmp_path / "store")
    assert (tmp_path / "tally").read_text() == "x"
    assert set(errors(swept).values()) == {""}
    assert_built_once(swept)


@pytest.mark.slow
def test_a_job_that_always_kills_its_worker_has_a_row_with_an_error(tiny, folder, tmp_path):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally"), "deaths": 99}
    swept = sweep(tiny, ["none", lethal, "raising"], tmp_path / "out", folder / "store", objects=["pin"])
    assert (tmp_path / "tally").read_text() == 2 * 2 * "x"  # twice among the others, and twice alone
    assert errors(swept)["pin", "raising"] == "ValueError: nothing works at all"
    for (_, refiner), error in errors(swept).items():
        assert ("workers.log" in error) == (refiner == "lethal")
    assert "signal 9" in (tmp_path / "out" / "workers.log").read_text()


def test_a_worker_with_other_versions_refuses_the_job(tiny, tmp_path):
    (one,), objects = combine(Plan.from_values({**tiny, "object": "pin", "refiner": "none"}))
    outcome = do_job(CombinationJob("0" * 16, one.config, one.count, tmp_path), objects["pin"])
    assert "versions" in outcome.error
    assert not outcome.trace


def test_a_missing_refiner_is_refused_before_the_run(tiny, tmp_path):
    with pytest.raises(UnknownPluginError, match=naming("'raisin'", "'raising'")):
        sweep(tiny, ["none", "raisin"], tmp_path / "out", tmp_path / "store")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def cluster(faults):
    distributed = pytest.importorskip("distributed")
    settings = {"n_workers": 2, "processes": True, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as cluster:
        yield cluster


@pytest.mark.slow
def test_a_killed_dask_worker_costs_only_time(tiny, tmp_path, cluster):
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally")}
    workers = DaskWorkers(cluster.scheduler_address)
    swept = sweep(tiny, ["none", lethal, "raising"], tmp_path / "out", tmp_path / "store", workers)
    assert (tmp_path / "tally").read_text() == "x"
    assert errors(swept)["pin", "lethal"] == errors(swept)["head", "lethal"] == ""
    assert errors(swept)["pin", "raising"] == "ValueError: nothing works at all"
    assert_built_once(swept)


@pytest.mark.slow
def test_a_job_that_always_kills_its_dask_worker_affects_no_other_job(tiny, folder, tmp_path, cluster, monkeypatch):
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 0)  # the first death is enough, for neighbours as well
    lethal = {"name": "lethal", "tally": str(tmp_path / "tally"), "deaths": 99}
    swept = sweep(tiny, [lethal, "none"], tmp_path / "out", folder / "store", DaskWorkers(cluster.scheduler_address))
    for (_, refiner), error in errors(swept).items():
        assert ("Dask" in error) == (refiner == "lethal")
    assert errors(swept)["pin", "none"] == errors(swept)["head", "none"] == ""


class LosingFuture:
    """A future whose worker dies between the end of its job and the reading of its status."""

    def __init__(self) -> None:
        self.statuses = ["lost", "finished"]

    @property
    def status(self) -> str:
        return self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]

    def result(self) -> str:
        return "measured again"

    def release(self) -> None:
        pass


class InOrder:
    """A stand-in for `distributed.as_completed` that returns futures in the order in which they were added."""

    def __init__(self, loop: Any) -> None:
        self.queue: list[LosingFuture] = []

    def add(self, future: LosingFuture) -> None:
        self.queue.append(future)

    def __next__(self) -> LosingFuture:
        return self.queue.pop(0)


def test_a_job_whose_result_is_lost_is_awaited_again(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "as_completed", InOrder)
    client = SimpleNamespace(
        loop=None,
        scheduler=SimpleNamespace(address="tcp://host:8786"),
        submit=lambda *arguments, **keywords: LosingFuture(),
        cancel=lambda futures: None,
    )
    job = CombinationJob("key", RunConfig.from_dict({}, "a test"), 1, tmp_path)
    pin = SimpleNamespace(name="pin")
    assert list(run_on_dask(client, [job], {"key": pin})) == [(job, "measured again")]


def make_table(**columns: float) -> ExampleTable:
    """Three touches: the errors of line l are 1, 2 and 4 times l + 1 mm; random poses err by 20 mm on average."""
    errors_m = {f"{line} add_m": 1e-3 * (k + 1) * np.array([1, 2, 4]) for k, line in enumerate(LINES)}
    errors_m["random add_m"] = np.array([10e-3, 20e-3, 30e-3])
    seconds = np.array([[1, 2, 3, 4, 20], [1, 2, 3, 40, 20], [9, 2, 3, 5, 30]]) * 1e-3
    times = {f"{stage}_s": seconds[:, k] for k, stage in enumerate(TIMED)}
    labels = {"object": "pin", "encoder": "pixel", "touches": 1, "grid_poses": 7, "refused": 2}
    return ExampleTable.make({**errors_m, **times}, **labels, **{**dict.fromkeys(POSTERIOR_METRICS, 0.4), **columns})


def test_a_summary_has_errors_in_mm_and_shares_and_times_in_ms():
    found = summarise(make_table())
    assert set(found) == {"grid_poses", *ERRORS, *COVERAGES, "nll_nats", *TIMES, TOUCHES}
    line = LINES.index("reg-1") + 1
    assert found["reg-1_median_mm"] == pytest.approx(2 * line)
    assert found["reg-1_mean_mm"] == pytest.approx(7 / 3 * line, rel=1e-5)
    assert found["reg-1_median_share"] == pytest.approx(2 * line / 20)
    assert (found["random_median_mm"], found["random_mean_mm"]) == (20, 20)
    assert [found[f"{stage}_ms"] for stage in TIMED] == [1, 2, 3, 5, 20]
    assert found["best-1_ms"] == 6
    assert found["reg-1_ms"] == 19  # the median of 10, 46 and 19, not the sum of medians
    assert found["chosen_ms"] == 49  # the median of 30, 66 and 49
    assert [found[f"coverage_{level}"] for level in (50, 80, 95)] == [1, 1, 1]
    assert (found["nll_nats"], found["grid_poses"]) == (0.4, 7)
    assert found[TOUCHES]["reg-1_mm"] == pytest.approx([line, 2 * line, 4 * line])
    assert found[TOUCHES]["reg-1_ms"] == pytest.approx([10, 46, 19])
    assert found[TOUCHES]["refused"] == [2, 2, 2]
    assert found["reg-1_low_mm"] is None, "three touches are too few for an interval"
    found = summarise(make_table(nll_nats=np.inf, credible_level=0.9))
    assert found["nll_nats"] is None, "an infinite value is missing"
    assert [found[f"coverage_{level}"] for level in (50, 80, 95)] == [0, 0, 1]
