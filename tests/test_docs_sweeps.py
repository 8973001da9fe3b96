"""The page on sweeps: plans can be read, cluster examples start valid commands, and all columns are explained."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from types import ModuleType
from typing import Any

import pytest
from page_helpers import ROOT, find_blocks, list_commands, read_page, understand

from tactile_loc.evaluation.sweep.plan import Plan, find_varied_options, split_all
from tactile_loc.evaluation.sweep.sweep import IDENTITY, MOMENTARY, list_columns

PAGE = read_page("sweeps.md")
CLUSTERS = ("dask_jobqueue", "dask_kubernetes")


def test_every_block_has_a_tested_kind():
    assert set(re.findall(r"^```(\w*)$", PAGE, re.MULTILINE)) == {"sh", "toml", "python", ""}
    assert {words[0] for words in list_commands(PAGE)} == {"pip", "tactile-loc", "dask"}


def test_every_dask_command_is_valid():
    pytest.importorskip("distributed")
    from distributed.cli import dask_scheduler, dask_worker

    for program, name, *words in list_commands(PAGE):
        if program == "dask":
            command = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[name]
            command.make_context(name, words)


def test_the_extra_in_the_install_command_exists():
    (words,) = [words for words in list_commands(PAGE) if words[0] == "pip"]
    extra = re.fullmatch(r"tactile-loc\[(\w+)\]", words[-1])[1]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert "distributed" in {re.split(r"[<>=]", one)[0] for one in extras[extra]}


def test_the_plans_of_the_page_give_the_documented_combinations():
    (text,) = find_blocks(PAGE, "toml")
    plan = Plan.from_values(tomllib.loads(text), "docs/sweeps.md")
    assert [len(plan.slots[slot]) for slot in ("sensor", "renderer", "grid", "encoder", "refiner")] == [2, 2, 2, 2, 3]
    assert (len(plan.objects), plan.noises, plan.seeds, plan.count) == (2, ("none", "strong"), (0, 1), 50)
    given = understand(next(words[1:] for words in list_commands(PAGE) if "encoder.cells=12,20" in words))
    plan = Plan.from_values({"encoder": split_all(given["encoder"]), "option": given["option"]})
    assert (len(plan.slots["grid"]), len(plan.slots["encoder"])) == (2, 3)


class FakeCluster:
    """A stand-in for a cluster."""

    scheduler_address = "tcp://head:1"

    def __init__(self, **settings: Any) -> None:
        self.settings = settings

    def scale(self, jobs: int) -> None:
        assert jobs > 0

    def __enter__(self) -> FakeCluster:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def fake_spec(**settings: Any) -> dict[str, Any]:
    return {"spec": {"worker": {"spec": {"containers": [{"env": settings["env"]}]}}}}


@pytest.mark.parametrize("cluster", CLUSTERS)
def test_the_cluster_examples_start_a_valid_command(cluster, monkeypatch):
    """Stand-ins replace Slurm and Kubernetes."""
    jobqueue, kubernetes, operator = (ModuleType(name) for name in (*CLUSTERS, "dask_kubernetes.operator"))
    jobqueue.SLURMCluster = operator.KubeCluster = FakeCluster
    operator.make_cluster_spec = fake_spec
    for module in (jobqueue, kubernetes, operator):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    ran: list[list[str]] = []
    monkeypatch.setattr(subprocess, "run", lambda words, check: ran.append(words))
    (text,) = [block for block in find_blocks(PAGE, "python") if cluster in block]
    exec(compile(text, "docs/sweeps.md", "exec"), {})
    ((program, *words),) = ran
    assert program == "tactile-loc"
    assert understand(words)["scheduler"] == FakeCluster.scheduler_address


@pytest.mark.slow
def test_the_python_example_runs(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = [b for b in find_blocks(PAGE, "python") if not any(name in b for name in CLUSTERS)]
    exec(compile(example, "docs/sweeps.md", "exec"), {"__name__": "__main__"})
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in rows] == ["none", "icp"]
    assert all(float(value) > 0 for _, value in rows)
    named = set(
        re.findall(r"`([\w.-]+)`", PAGE[PAGE.index("| file |") : PAGE.index("`sweep.md` and `differences.csv` show")])
    )
    assert named <= {path.name for path in (tmp_path / "sweep").iterdir()}


def test_every_column_is_explained():
    rows = PAGE[PAGE.index("| column |") : PAGE.index("The last columns")].strip().splitlines()[2:]
    explained = {name for row in rows for name in re.findall(r"`([\w.-]+)`", row.split("|")[1])}
    plan = Plan.from_values({"object": "pin", "option": ["grid.spacing_mm=3,4", "encoder.cells=12,20"]})
    assert find_varied_options(plan.slots["grid"]) == ["spacing_mm"]
    columns = list_columns(plan)
    assert explained <= set(columns)
    assert {
        c for c in columns if not re.fullmatch(r"[\w-]+_(median_mm|low_mm|high_mm|mean_mm|median_share)", c)
    } <= explained
    assert set(IDENTITY) <= explained
    assert tuple(columns[columns.index("encode_ms") :]) == MOMENTARY
