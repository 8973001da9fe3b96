"""One mutant's trial: a copy of the project in which a file is another, and tests in a process that was forked.

A fork has pytest, numpy and what else takes long to import already, but nothing of the project, which it imports with
its mutant. Kernels run uncompiled, so that a mutant of one is what runs, and at once.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import time
from compileall import compile_dir
from contextlib import suppress
from importlib import import_module
from pathlib import Path

PRELOADED = (
    "matplotlib.figure", "numba", "pydantic", "pytest", "scipy.ndimage", "scipy.optimize", "scipy.spatial.transform",
    "trimesh",
)  # fmt: skip
COPIED = ("tactile_loc", "cli", "tests", "scripts")
LEAST_S = 60.0  # that a trial may take
PATIENCE = 5.0  # times as long as without a mutant
MEMORY_BYTES = 16 * 2**30  # of address space
KILLED, SURVIVED, TIMED_OUT = "killed", "survived", "timed out"

SETTINGS = {
    "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
    "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
}  # fmt: skip


def preload() -> None:
    """Import what tests import of others, with threads and compilers off: numba and BLAS read that when imported."""
    os.environ.update(SETTINGS)
    sys.dont_write_bytecode = True
    for name in PRELOADED:
        import_module(name)


class Copy:
    """A copy of the project in a folder, and the tests in it."""

    def __init__(self, project: Path, folder: Path) -> None:
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        for name in COPIED:
            shutil.copytree(project / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(project / "pyproject.toml", folder)
        compile_dir(folder, quiet=2)
        self.paths = [str(folder / name) for name in (".", "cli", "tests", "scripts")]

    def without_bytecode(self, file: str) -> Path:
        """Return a file of the copy, whose bytecode is thrown away: a mutant can be as old and as large as another."""
        path = self.folder / file
        for cached in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            cached.unlink()
        return path

    def judge(self, tests: tuple[str, ...], seconds: float) -> tuple[str, str]:
        """Run tests until one fails: what becomes of the code, and what was printed."""
        log = self.folder / "tests.log"
        child = os.fork()
        if child == 0:
            self._run(tests, log)
        code = _wait(child, seconds)
        outcome = {None: TIMED_OUT, 0: SURVIVED}.get(code, KILLED)
        return outcome, log.read_text(errors="replace")[-4000:]

    def _run(self, tests: tuple[str, ...], log: Path) -> None:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        code: int = 1
        try:
            os.chdir(self.folder)
            sys.path[:0] = self.paths
            os.environ["PYTHONPATH"] = os.pathsep.join(self.paths)  # of processes that tests start
            import pytest

            code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests])
        finally:
            sys.stdout.flush()
            os._exit(int(code))


def _wait(child: int, seconds: float) -> int | None:
    """Wait for a process, and end it and all that it started; its exit code, None if it took too long."""
    end = time.monotonic() + seconds
    code = None
    while code is None and time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
        else:
            time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if code is None:
        os.waitpid(child, 0)
    return code
