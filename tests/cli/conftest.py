"""Fixtures that run the command in this process for speed, or in a separate process where that matters."""

from __future__ import annotations

import math
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cli_helpers import HANGS_S, Cli, command
from matplotlib.figure import Figure
from PIL import Image
from tactile_loc_cli import console
from tactile_loc_cli.main import app
from typer.testing import CliRunner


def blank(figure: Figure, path: Path, dpi: int, **_: object) -> None:
    """Write a white picture of a figure's size in its place."""
    width_px, height_px = (int(dpi * inches) for inches in figure.get_size_inches())
    Image.new("L", (width_px, height_px), 255).save(path)


@pytest.fixture
def drawn_pictures() -> None:
    """Draw real pictures, for tests that inspect them."""


@pytest.fixture(autouse=True)
def blank_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Save white pictures in all other tests, because drawing takes longer than locating with a stored model."""
    if "drawn_pictures" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", blank)


@pytest.fixture(scope="session", autouse=True)
def quick_machine() -> Iterator[None]:
    """Write no lines of progress, which a busy machine would add to stderr."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "EVERY_S", math.inf)
        yield


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One store for all tests that do not depend on its contents."""
    return tmp_path_factory.mktemp("store")


@pytest.fixture
def cli(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Run the command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store))
    return lambda *words: CliRunner().invoke(app, [*map(str, words)], prog_name="tactile-loc")


@pytest.fixture
def run_process(store: Path, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the command in one or several separate processes; keywords are environment variables."""

    def run(*words: object, processes: int = 1, **environment: str) -> subprocess.CompletedProcess[str]:
        line = command(*words)
        if processes > 1:
            line[1:1] = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
        variables = {**os.environ, "TACTILE_LOC_STORE": str(store), **environment}
        return subprocess.run(line, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=HANGS_S)

    return run
