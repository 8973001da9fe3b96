"""The benchmark's sweep, small: on local processes and on a Dask cluster, each with a worker killed in the middle."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import pytest

from tactile_loc.sweeps.results import read_sweep
from tactile_loc.sweeps.table import MOMENTARY

ROOT = Path(__file__).parents[2]
COMBINATIONS = 1 * 1 * 2 * 2


@pytest.mark.slow
def test_nothing_is_lost_and_nothing_built_twice_though_workers_are_killed(tmp_path, monkeypatch, capsys):
    for library in ("distributed", "pyarrow", "torch"):
        pytest.importorskip(library)
    options = ["--out", str(tmp_path), "--only-killed", "--small", "--count", "1", "--spacing-mm", "12"]
    monkeypatch.setattr(sys, "argv", ["sweep.py", *options])
    assert runpy.run_path(str(ROOT / "benchmarks" / "sweep.py"))["main"]() == 0, capsys.readouterr()
    local, dask = json.loads((tmp_path / "counts.json").read_text())
    for found in (local, dask):
        assert (found["killed"], found["rows"], found["failed"], found["most_builds_of_one"]) == (1, COMBINATIONS, 0, 1)
        built = {stage: count for stage, count in found["built"].items() if stage != "bank"}
        assert built == {"grid": 1, "shapes": 1, "encoder": 1, "evaluation": COMBINATIONS}
    tables = [read_sweep(tmp_path / name)["rows"] for name in ("local-killed", "dask-killed")]
    first, second = ([{k: v for k, v in row.items() if k not in MOMENTARY} for row in table] for table in tables)
    assert first == second
    assert len({row["key"] for row in first}) == COMBINATIONS
