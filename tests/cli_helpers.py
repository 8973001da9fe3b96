"""Helpers for the tests of the command line."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import Result

TINY = ["--grid", "face", "-o", "grid.spacing_mm=8"]  # a grid of a few hundred poses
SURE = ["-o", "temperature=0.05"]  # no temperature is fitted, which takes a second for each grid
FLAT_SENSOR = """\
camera = "orthographic"
image_size_px = [80, 80]
max_depth_mm = 2.0
mm_per_px = 0.35
"""
NO_CONTACT_M = 0.002
HANGS_S = 1800  # generous limit against hanging processes, since a machine may be busy

Cli = Callable[..., Result]


def command(*words: object) -> list[str]:
    """The command line of a separate process."""
    return [sys.executable, "-m", "tactile_loc_cli.main", *map(str, words)]


def hear_ctrl_c() -> None:
    """Let a process react to Ctrl-C as in a terminal; background jobs of a shell would ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start_process(line: list[str], folder: Path, store: Path, **options: Any) -> subprocess.Popen[str]:
    """Start a command line in a folder, with a store; the process reacts to Ctrl-C as in a terminal."""
    environment, pipe = {**os.environ, "TACTILE_LOC_STORE": str(store)}, subprocess.PIPE
    return subprocess.Popen(
        line, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True, preexec_fn=hear_ctrl_c, **options
    )


def assert_one_error(stderr: str, code: int, *mentioned: str) -> None:
    """Require exit code 2 and a single line with the error; other lines may be warnings or notes."""
    lines = [line for line in stderr.splitlines() if not line.startswith(("warning: ", "note: "))]
    assert code == 2, stderr
    assert len(lines) == 1, stderr
    assert lines[0].startswith("error: ")
    assert "Traceback" not in stderr
    for words in mentioned:
        assert words in lines[0]


def succeed(result: Result) -> Result:
    """Require exit code 0, and return the result."""
    assert result.exit_code == 0, result.stderr
    return result


def assert_refused(result: Result, *mentioned: str) -> None:
    assert_one_error(result.stderr, result.exit_code, *mentioned)


def touch_depths(shape: tuple[int, int] = (200, 200)) -> np.ndarray:
    """A contact shape in metres with an edge: the corner of a box on the left of the image."""
    depth = np.full(shape, NO_CONTACT_M, np.float32)
    depth[60:140, :90] = 0.0
    return depth


BOX = """\
v 0 0 0
v {x} 0 0
v {x} {y} 0
v 0 {y} 0
v 0 0 {z}
v {x} 0 {z}
v {x} {y} {z}
v 0 {y} {z}
"""
FACES = ["1 3 2", "1 4 3", "5 6 7", "5 7 8", "1 2 6", "1 6 5", "2 3 7", "2 7 6", "3 4 8", "3 8 7", "4 1 5", "4 5 8"]


def write_box(path: Path, x: object = 30, y: object = 20, z: object = 10, faces: int = 12) -> Path:
    """Write a box as OBJ, with the first `faces` of its twelve faces."""
    path.write_text(BOX.format(x=x, y=y, z=z) + "".join(f"f {face}\n" for face in FACES[:faces]))
    return path
