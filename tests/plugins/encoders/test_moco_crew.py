"""What processes that train together tell one another, tried with two of them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

torch = pytest.importorskip("torch")

from tactile_loc.plugins.encoders.moco_crew import Crew  # noqa: E402

TWO = """
import torch
from tactile_loc.plugins.encoders.moco_crew import Crew

crew = Crew(torch.device("cpu"))
mine = torch.full((2, 3), float(crew.rank))
crew.average([mine])
assert mine.eq(0.5).all(), mine
assert crew.add(torch.tensor([1.0 + crew.rank])).item() == 3.0
assert crew.agree({"rank": crew.rank}) == {"rank": 0}
assert (crew.size, crew.share(7), crew.share(1)) == (2, 3, 1)
crew.leave()
"""


def test_two_processes_average_add_and_agree(tmp_path):
    (tmp_path / "two.py").write_text(TWO)
    words = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "two.py"]
    done = subprocess.run(
        words, cwd=tmp_path, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_one_process_alone_sends_nothing():
    crew = Crew(torch.device("cpu"))
    tensor = torch.tensor([2.0])
    crew.average([tensor])
    assert (crew.rank, crew.size, crew.share(7)) == (0, 1, 7)
    assert crew.add(tensor) is tensor
    assert crew.agree("word") == "word"
    assert tensor.item() == 2.0
    crew.leave()
