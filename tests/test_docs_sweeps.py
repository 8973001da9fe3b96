"""The page on sweeps: plans can be read, commands are valid, Python runs, and all columns are explained."""

from __future__ import annotations

import itertools
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from typer.main import get_command

from tactile_loc.evaluation.sweep.plan import Plan, find_varied_options, split_all
from tactile_loc.evaluation.sweep.sweep import IDENTITY, MOMENTARY, list_columns

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "sweeps.md").read_text()
CLUSTERS = ("dask_jobqueue", "dask_kubernetes")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def commands() -> list[list[str]]:
    """The words of every command, without leading environment variables."""
    lines = [shlex.split(line, comments=True) for block in blocks("sh") for line in block.splitlines()]
    return [list(itertools.dropwhile(re.compile(r"[A-Z_]+=\S*").fullmatch, line)) for line in lines if line]


def test_every_block_has_a_tested_kind():
    assert set(re.findall(r"^```(\w*)$", PAGE, re.MULTILINE)) == {"sh", "toml", "python", ""}
    assert {words[0] for words in commands()} == {"pip", "tactile-loc", "dask"}


def understood(words: list[str]) -> dict[str, Any]:
    from tactile_loc_cli.main import app

    command = get_command(app).commands[words[0]]
    return command.make_context(words[0], list(words[1:])).params


@pytest.mark.parametrize("words", [w[1:] for w in commands() if w[0] == "tactile-loc"], ids=" ".join)
def test_every_command_on_the_pages_is_valid(words):
    given = understood(words)
    assert given["plan"] is not None or given["object"] or given["renderer"] or given["compare"]


@pytest.mark.parametrize("words", [w[1:] for w in commands() if w[0] == "dask"], ids=" ".join)
def test_every_dask_command_is_valid(words):
    pytest.importorskip("distributed")
    from distributed.cli import dask_scheduler, dask_worker

    command = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[words[0]]
    command.make_context(words[0], list(words[1:]))


def test_the_extra_in_the_install_command_exists():
    (words,) = [w for w in commands() if w[0] == "pip"]
    extra = re.fullmatch(r"tactile-loc\[(\w+)\]", words[-1])[1]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {"distributed", "pandas", "pyarrow"} <= {
        re.split(r"[<>=]", r)[0] for r in project["optional-dependencies"][extra]
    }


@pytest.mark.parametrize("text", blocks("toml"))
def test_every_plan_on_the_pages_can_be_read(text):
    plan = Plan.from_values(tomllib.loads(text), "docs/sweeps.md")
    assert [len(plan.slots[slot]) for slot in ("sensor", "renderer", "grid", "encoder", "refiner")] == [2, 2, 2, 2, 3]
    assert (len(plan.objects), plan.noises, plan.seeds, plan.count) == (2, ("none", "strong"), (0, 1), 50)


def test_the_example_of_options_gives_the_documented_combinations():
    words = next(w[1:] for w in commands() if "encoder.cells=12,20" in w)
    given = understood(words)
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


@pytest.mark.parametrize("text", [b for b in blocks("python") if any(name in b for name in CLUSTERS)])
def test_the_cluster_examples_start_a_valid_command(text, monkeypatch):
    """Stand-ins replace Slurm and Kubernetes."""
    jobqueue, kubernetes, operator = (ModuleType(n) for n in (*CLUSTERS, "dask_kubernetes.operator"))
    jobqueue.SLURMCluster = operator.KubeCluster = FakeCluster
    operator.make_cluster_spec = fake_spec
    for module in (jobqueue, kubernetes, operator):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    ran: list[list[str]] = []
    monkeypatch.setattr(subprocess, "run", lambda words, check: ran.append(words))
    exec(compile(text, "docs/sweeps.md", "exec"), {})
    ((program, *words),) = ran
    assert program == "tactile-loc"
    assert understood(words)["scheduler"] == FakeCluster.scheduler_address


@pytest.mark.slow
def test_the_python_example_runs(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = [b for b in blocks("python") if not any(name in b for name in CLUSTERS)]
    exec(compile(example, "docs/sweeps.md", "exec"), {"__name__": "__main__"})
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in rows] == ["none", "icp"]
    assert all(float(value) > 0 for _, value in rows)
    named = set(re.findall(r"`([\w.-]+)`", PAGE[PAGE.index("| file |") : PAGE.index("`sweep.md` and the pictures")]))
    assert named <= {path.name for path in (tmp_path / "sweep").iterdir()}


def test_every_column_is_explained():
    rows = PAGE[PAGE.index("| column |") : PAGE.index("The last columns")].strip().splitlines()[2:]
    explained = {name for row in rows for name in re.findall(r"`([\w.-]+)`", row.split("|")[1])}
    plan = Plan.from_values({"object": "pin", "option": ["grid.spacing_mm=3,4", "encoder.cells=12,20"]})
    assert find_varied_options(plan.slots["grid"]) == ["spacing_mm"]
    columns = list_columns(plan)
    assert explained <= set(columns)
    assert {c for c in columns if not re.fullmatch(r"[\w-]+_(median_mm|mean_mm|median_share)", c)} <= explained
    assert set(IDENTITY) <= explained
    assert tuple(columns[columns.index("encode_ms") :]) == MOMENTARY
