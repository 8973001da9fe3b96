"""The benchmark's sweep: 2 renderers x 3 encoders x 4 refiners x 3 objects, and a worker killed in the middle."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tactile_loc.sweeps.table import MOMENTARY, read_csv

ROOT = Path(__file__).parents[2]
COMBINATIONS = 2 * 3 * 4 * 3


@pytest.mark.slow
def test_nothing_is_lost_and_nothing_built_twice_though_workers_are_killed(tmp_path):
    for library in ("distributed", "pyarrow", "torch"):
        pytest.importorskip(library)
    script = [
        sys.executable,
        str(ROOT / "benchmarks" / "sweep.py"),
        "--out",
        str(tmp_path),
        "--only-killed",
        "--count",
        "1",
    ]
    done = subprocess.run(script, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    local, dask = json.loads((tmp_path / "counts.json").read_text())
    for found in (local, dask):
        assert (found["killed"], found["rows"], found["failed"], found["most_builds_of_one"]) == (1, COMBINATIONS, 0, 1)
        built = {stage: count for stage, count in found["built"].items() if stage != "bank"}
        assert built == {"grid": 3, "shapes": 6, "encoder": 6, "evaluation": COMBINATIONS}
    tables = [read_csv(tmp_path / name / "sweep.csv") for name in ("local-killed", "dask-killed")]
    first, second = ([{k: v for k, v in row.items() if k not in MOMENTARY} for row in table] for table in tables)
    assert first == second
    assert len({row["key"] for row in first}) == COMBINATIONS
