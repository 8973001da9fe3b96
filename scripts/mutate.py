#!/usr/bin/env python3
"""Mutants of the numerical core: code changed in one place, which a test should notice.

A seed draws the same sample of cosmic-ray's mutants of each target. cosmic-ray judges them by the target's own tests,
in a copy of the project whose kernels run uncompiled. Survivors are shown as diffs. OUT/TARGET-SEED.sqlite keeps a
session, which `cr-report` and `cr-html` read: the same command goes on there. It begins anew when the target's files,
their tests or the number of mutants are others.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from cosmic_ray.commands import execute, init
from cosmic_ray.config import ConfigDict
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome
from mutants import TARGETS, Target, counts, sample, uncounted
from record import ONE_THREAD

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = Path("tactile_loc")
COPIED = ("tactile_loc", "cli", "tests", "scripts", "pyproject.toml")
LEAST_S, PATIENCE = 60.0, 5.0  # seconds that a trial may take, or times as long as without a mutant
MEMORY_BYTES = 16 * 2**30  # of address space
SETTINGS = {"NUMBA_DISABLE_JIT": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", **ONE_THREAD}
OUTCOMES = ("killed", "timed out", "survived")


def command(target: Target) -> list[str]:
    """Return the command that runs a target's tests until one fails, with a limit of memory."""
    limited = ["bash", "-c", f'ulimit -v {MEMORY_BYTES // 1024}; exec "$@"', "-"]
    return [*limited, sys.executable, "-B", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *target.tests]


def begin(db: WorkDB, target: Target, count: int, seed: int) -> None:
    """Fill an empty session with a sample of a target's mutants."""
    init([PACKAGE / file for file in target.files], db, {})
    spans = {PACKAGE / file: uncounted((PACKAGE / file).read_text()) for file in target.files}
    mutants = [(item.mutations[0], item) for item in db.work_items]
    mutants = [(one, item) for one, item in mutants if counts(one, spans[one.module_path])]
    chosen = sample([(one.module_path.as_posix(), one) for one, _ in mutants], count, seed)
    db.clear()
    db.add_work_items([mutants[k][1] for k in chosen])


def pursue(db: WorkDB, target: Target) -> None:
    """Judge the rest of a session. Raises SystemExit when its tests fail without a mutant, or cannot run."""
    if not (pending := len(list(db.pending_work_items))):
        return
    start = time.monotonic()
    done = subprocess.run(command(target), capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the tests of {target.name} fail without a mutant:\n{done.stdout}{done.stderr}")
    print(f"{target.name}: {pending} mutants to judge", file=sys.stderr)
    seconds = max(LEAST_S, PATIENCE * (time.monotonic() - start))
    settings = {"test-command": shlex.join(command(target)), "timeout": seconds, "distributor": {"name": "local"}}
    execute(db, ConfigDict(settings))
    print(f"{target.name}: judged in {time.monotonic() - start:.0f} s", file=sys.stderr)
    for _, result in db.completed_work_items:
        if result.worker_outcome != WorkerOutcome.NORMAL or result.test_outcome == TestOutcome.INCOMPETENT:
            raise SystemExit(f"a mutant of {target.name} could not be judged:\n{result.output}")


def outcomes(db: WorkDB) -> list[tuple[str, str]]:
    """Return the files of a session's judged mutants, and what became of each."""
    return [
        (item.mutations[0].module_path.relative_to(PACKAGE).as_posix(),
         "timed out" if result.output == "timeout" else str(result.test_outcome.value))
        for item, result in db.completed_work_items
    ]  # fmt: skip


def table(judged: dict[str, list[tuple[str, str]]]) -> str:
    """Return a table of targets and their files: mutants, what became of them, and the share that was noticed."""
    lines = [f"| target, file | mutants | {' | '.join(OUTCOMES)} | noticed |", "|---" * 6 + "|"]
    for target, found in judged.items():
        for name in (f"**{target}**", *sorted({file for file, _ in found})):
            came = Counter(outcome for file, outcome in found if name in (file, f"**{target}**"))
            share = 100 * (1 - came["survived"] / max(came.total(), 1))
            lines.append(f"| {name} | {came.total()} | {' | '.join(str(came[o]) for o in OUTCOMES)} | {share:.0f} % |")
    return "\n".join(lines)


def session(out: Path, target: Target, count: int, seed: int) -> Path:
    """Return the file of a session. One of other sources is removed."""
    tests = [Path(test) for test in target.tests if test.startswith("tests/")]
    files = [file for test in tests for file in ([test] if test.is_file() else sorted(test.glob("*.py")))]
    texts = [path.read_bytes() for path in [*(PACKAGE / file for file in target.files), *files]]
    path, stamp = out / f"{target.name}-{seed}.sqlite", out / f"{target.name}-{seed}.sources"
    now = f"{count} mutants of {hashlib.sha256(bytes(0).join(texts)).hexdigest()}"
    if not stamp.exists() or stamp.read_text() != now:
        path.unlink(missing_ok=True)
        stamp.write_text(now)
    return path


def mutate(targets: Sequence[Target], count: int, seed: int, out: Path) -> str:
    """Judge a sample of each target's mutants and show those that survive. Return the table of them all."""
    out.mkdir(parents=True, exist_ok=True)
    judged = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, contextlib.chdir(folder):
        paths = os.pathsep.join(str(Path(name).absolute()) for name in (".", "cli", "tests", "scripts"))
        os.environ.update(SETTINGS, PYTHONPATH=paths)
        for source in (ROOT / name for name in COPIED):
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, source.name)
        for cache in Path().rglob("__pycache__"):
            shutil.rmtree(cache)
        for target in targets:
            with use_db(session(out, target, count, seed)) as db:
                if not db.num_work_items:
                    begin(db, target, count, seed)
                pursue(db, target)
                judged[target.name] = outcomes(db)
                survived = [one.diff for _, one in db.completed_work_items if one.test_outcome == TestOutcome.SURVIVED]
                print(*survived, sep="\n\n", end="\n\n")
    return table(judged)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line, judge mutants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = {target.name: target for target in TARGETS}
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(known)}; all by default")
    parser.add_argument("--mutants", type=int, default=100, help="of each target (100)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutants", help="folder of the sessions")
    options = parser.parse_args(arguments)
    if unknown := sorted(set(options.targets) - set(known)):
        parser.error(f"there is no target {', '.join(unknown)}; there are {', '.join(known)}")
    print(
        mutate(
            [known[name] for name in options.targets or known], options.mutants, options.seed, options.out.absolute()
        )
    )


if __name__ == "__main__":
    main()
