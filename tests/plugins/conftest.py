"""Plugins are installed offline into a folder, and Python processes see them there."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
OFFLINE = ["--no-index", "--no-deps", "--no-build-isolation"]
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.egg-info", "build", ".*")


@pytest.fixture(scope="session")
def install_offline(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Install distributions from copies of these folders, and return the folder that holds them."""
    pytest.importorskip("setuptools", minversion="77")  # older versions cannot read the licence

    def install(*sources: Path) -> Path:
        folder = tmp_path_factory.mktemp("installed")
        copies = [shutil.copytree(source, folder / source.name, ignore=LEFT_OUT) for source in sources]
        subprocess.run([*PIP, *OFFLINE, "--target", str(folder / "site"), *map(str, copies)], check=True)
        return folder / "site"

    return install


@pytest.fixture(scope="session")
def run_python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run Python in a new process that sees installed plugins and not their sources; keywords are environment."""

    def run(site: Path, folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        seen = {k: v for k, v in os.environ.items() if k != "TACTILE_LOC_PLUGINS"}
        seen |= {"PYTHONPATH": str(site), "COLUMNS": "200", "PYTHONDONTWRITEBYTECODE": "1", **environment}
        return subprocess.run([sys.executable, *words], env=seen, cwd=folder, capture_output=True, text=True)

    return run


@pytest.fixture(scope="session")
def run_own_tests(tmp_path_factory: pytest.TempPathFactory, run_python) -> Callable[..., str]:
    """Run the tests of installed plugins in copies of their folders, by name, and return the output."""

    def run(site: Path, tests: dict[str, Path]) -> str:
        folder = tmp_path_factory.mktemp("own")
        copies = [shutil.copytree(path, folder / name, ignore=LEFT_OUT) for name, path in tests.items()]
        quiet = ["-rA", "-p", "no:cacheprovider", "-p", "no:dash", "--import-mode=importlib", "--rootdir", str(folder)]
        return run_python(site, folder, "-m", "pytest", *quiet, *map(str, copies)).stdout

    return run
