"""The benchmark's sweep, small: on a Dask cluster, with a worker killed in the middle."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import pytest

from tactile_loc.evaluation.sweep.results import read_sweep

ROOT = Path(__file__).parents[3]
COMBINATIONS = 1 * 1 * 2 * 2


@pytest.mark.slow
def test_a_killed_worker_loses_no_row_and_repeats_no_build(tmp_path, monkeypatch, capsys):
    for library in ("distributed", "pyarrow", "torch"):
        pytest.importorskip(library)
    options = ["--out", str(tmp_path), "--ways", "dask-killed", "--small", "--count", "1", "--spacing-mm", "12"]
    monkeypatch.setattr(sys, "argv", ["sweep.py", *options])
    assert runpy.run_path(str(ROOT / "benchmarks" / "sweep.py"))["main"]() == 0, capsys.readouterr()
    (found,) = json.loads((tmp_path / "counts.json").read_text())
    assert (found["killed"], found["rows"], found["failed"], found["most_builds_of_one"]) == (1, COMBINATIONS, 0, 1)
    built = {stage: count for stage, count in found["built"].items() if stage != "bank"}
    assert built == {"grid": 1, "shapes": 1, "encoder": 1, "evaluation": COMBINATIONS}
    assert len({row["key"] for row in read_sweep(tmp_path / "dask-killed")["rows"]}) == COMBINATIONS
