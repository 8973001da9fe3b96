#!/usr/bin/env python3
"""Change the numerical core in one place at a time, and check that a test notices each mutant.

The seed draws a sample of cosmic-ray's mutants of each target. cosmic-ray runs the target's own tests on these mutants,
in a copy of the project whose kernels run uncompiled. Survivors are shown as diffs. OUT/TARGET-SEED.sqlite keeps a
session for `cr-report` and `cr-html`. The same command continues the session. It begins a new session after a change of
the target's files, their tests or the number of mutants.
"""

import contextlib
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from cosmic_ray.commands import execute, init
from cosmic_ray.config import ConfigDict
from cosmic_ray.tools.report import report
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome
from mutants import TARGETS, Target, counts, find_uncounted, sample
from record import ONE_THREAD, ROOT, limit_memory, make_parser

PACKAGE = Path("tactile_loc")
COPIED = ("tactile_loc", "cli", "tests", "scripts", "pyproject.toml")
LEAST_S, PATIENCE = 60.0, 5.0  # limits of a trial: least seconds, and multiple of the duration without a mutant
MEMORY_BYTES = 16 * 2**30  # address space
SETTINGS = {"NUMBA_DISABLE_JIT": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", **ONE_THREAD}


def make_command(target: Target) -> list[str]:
    """Return the command that runs a target's tests until one fails."""
    options = "-B -m pytest -x -q -p no:cacheprovider"
    return [*limit_memory(MEMORY_BYTES), sys.executable, *options.split(), *target.tests]


def draw_mutants(db: WorkDB, target: Target, count: int, seed: int) -> None:
    """Fill an empty session with a sample of a target's mutants."""
    init([PACKAGE / file for file in target.files], db, {})
    spans = {PACKAGE / file: find_uncounted((PACKAGE / file).read_text()) for file in target.files}
    mutants = [(item.mutations[0], item) for item in db.work_items]
    mutants = [(one, item) for one, item in mutants if counts(one, spans[one.module_path])]
    chosen = sample([(one.module_path.as_posix(), one) for one, _ in mutants], count, seed)
    db.clear()
    db.add_work_items([mutants[k][1] for k in chosen])


def judge_mutants(db: WorkDB, target: Target) -> None:
    """Judge the remaining mutants of a session. Raises SystemExit if the tests fail without a mutant."""
    if not (pending := len(list(db.pending_work_items))):
        return
    start = time.monotonic()
    done = subprocess.run(make_command(target), capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the tests of {target.name} fail without a mutant:\n{done.stdout}{done.stderr}")
    print(f"{target.name}: {pending} mutants to judge", file=sys.stderr)
    seconds = max(LEAST_S, PATIENCE * (time.monotonic() - start))
    settings = {"test-command": shlex.join(make_command(target)), "timeout": seconds, "distributor": {"name": "local"}}
    execute(db, ConfigDict(settings))
    print(f"{target.name}: judged in {time.monotonic() - start:.0f} s", file=sys.stderr)
    for _, result in db.completed_work_items:
        if result.worker_outcome != WorkerOutcome.NORMAL or result.test_outcome == TestOutcome.INCOMPETENT:
            raise SystemExit(f"a mutant of {target.name} could not be judged:\n{result.output}")


def prepare_session(out: Path, target: Target, count: int, seed: int) -> Path:
    """Return the path of a session's file. Delete the session if it has other sources or another number of mutants."""
    tests = [Path(test) for test in target.tests if test.startswith("tests/")]
    files = [file for test in tests for file in ([test] if test.is_file() else sorted(test.glob("*.py")))]
    texts = [path.read_bytes() for path in [*(PACKAGE / file for file in target.files), *files]]
    path, stamp = out / f"{target.name}-{seed}.sqlite", out / f"{target.name}-{seed}.sources"
    now = f"{count} mutants of {hashlib.sha256(bytes(0).join(texts)).hexdigest()}"
    if not stamp.exists() or stamp.read_text() != now:
        path.unlink(missing_ok=True)
        stamp.write_text(now)
    return path


def mutate(targets: Sequence[Target], count: int, seed: int, out: Path) -> None:
    """Judge a sample of each target's mutants, and show the survivors and their number."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, contextlib.chdir(folder):
        paths = os.pathsep.join(str(Path(name).absolute()) for name in (".", "cli", "tests", "scripts"))
        os.environ.update(SETTINGS, PYTHONPATH=paths)
        for source in (ROOT / name for name in COPIED):
            if source.is_dir():
                shutil.copytree(source, source.name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, source.name)
        for target in targets:
            path = prepare_session(out, target, count, seed)
            with use_db(path) as db:
                if not db.num_work_items:
                    draw_mutants(db, target, count, seed)
                judge_mutants(db, target)
            print(f"{target.name}:")
            report.callback(False, True, False, True, path)  # diffs of survivors, and their number


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge the mutants of the chosen targets."""
    known = {target.name: target for target in TARGETS}
    numbers = {"mutants": (100, "mutants of each target")}
    given = make_parser(__doc__, "target", known, "mutants", **numbers).parse_args(arguments)
    mutate([known[name] for name in given.names], given.mutants, given.seed, given.out)


if __name__ == "__main__":
    main()
