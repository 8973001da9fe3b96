#!/usr/bin/env python3
"""Mutants of the numerical core: code changed in one place, which a test should notice.

A sample of cosmic-ray's mutants is drawn from each target, a seed's always the same, and judged by the target's own
tests, in a copy of the project. What survives is shown as a diff. A target's session is kept in OUT/TARGET-SEED.sqlite,
which cosmic-ray's own tools read (`cr-html`): the same command goes on there. It begins anew when the target's files,
their tests or the number of mutants are others.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkResult
from mutating.mutants import counts, sample, uncounted
from mutating.targets import TARGETS, Target
from mutating.trial import KILLED, LEAST_S, PATIENCE, SURVIVED, TIMED_OUT, Copy, preload

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tactile_loc"


def begin(db: WorkDB, target: Target, count: int, seed: int) -> None:
    """Fill an empty session with a sample of a target's mutants."""
    init([PACKAGE / file for file in target.files], db, {})
    spans = {file: uncounted((PACKAGE / file).read_text()) for file in target.files}
    items = [(_file(item.mutations[0]), item) for item in db.work_items]
    items = [(file, item) for file, item in items if counts(item.mutations[0], spans[file])]
    chosen = sample([(file, item.mutations[0]) for file, item in items], count, seed)
    db.clear()
    db.add_work_items([items[i][1] for i in chosen])


def _file(mutation: MutationSpec) -> str:
    return mutation.module_path.relative_to(PACKAGE).as_posix()


def pursue(db: WorkDB, target: Target, copy: Copy) -> None:
    """Judge what is left of a session; ends the program when its tests fail without a mutant."""
    pending = sorted(db.pending_work_items, key=lambda item: item.job_id)
    if not pending:
        return
    start = time.monotonic()
    outcome, output = copy.judge(target.tests, 600.0)
    if outcome != SURVIVED:
        raise SystemExit(f"the tests of {target.name} fail without a mutant:\n{output}")
    print(f"{target.name}: {len(pending)} mutants to judge", file=sys.stderr)
    seconds = max(LEAST_S, PATIENCE * (time.monotonic() - start))
    for item in pending:
        db.set_result(item.job_id, _judged(item.mutations[0], target, copy, seconds))
    print(f"{target.name}: judged in {time.monotonic() - start:.0f} s", file=sys.stderr)


def _judged(mutation: MutationSpec, target: Target, copy: Copy, seconds: float) -> WorkResult:
    tests, file = target.tests_of(_file(mutation)), f"tactile_loc/{_file(mutation)}"
    path = copy.without_bytecode(file)
    source = path.read_text()
    operator = get_operator(mutation.operator_name)(**mutation.operator_args)
    mutant = mutate_code(source, operator, mutation.occurrence)
    try:
        path.write_text(mutant)
        outcome, output = copy.judge(tests, seconds)
    finally:
        path.write_text(source)
    survived = TestOutcome.SURVIVED if outcome == SURVIVED else TestOutcome.KILLED
    text = "timeout" if outcome == TIMED_OUT else output
    diff = "\n".join(difflib.unified_diff(source.splitlines(), mutant.splitlines(), file, file, lineterm="", n=1))
    return WorkResult(WorkerOutcome.NORMAL, text, survived, diff)


def outcomes(db: WorkDB) -> Iterator[tuple[str, str]]:
    """The files of the mutants of a session that were judged, and what became of each."""
    for item, result in db.completed_work_items:
        killed = TIMED_OUT if result.output == "timeout" else KILLED
        yield _file(item.mutations[0]), SURVIVED if result.test_outcome == TestOutcome.SURVIVED else killed


def row(name: str, found: Counter[str]) -> str:
    """One line of the table."""
    total = sum(found.values())
    share = f"{100 * (total - found[SURVIVED]) / max(total, 1):.0f} %"
    return f"| {name} | {total} | {found[KILLED]} | {found[TIMED_OUT]} | {found[SURVIVED]} | {share} |"


def _table(judged: dict[str, list[tuple[str, str]]]) -> str:
    lines = ["| target, file | mutants | killed | timed out | survived | noticed |", "|---|---|---|---|---|---|"]
    for name, found in judged.items():
        lines.append(row(f"**{name}**", Counter(outcome for _, outcome in found)))
        files = sorted({file for file, _ in found})
        lines += [row(file, Counter(outcome for f, outcome in found if f == file)) for file in files]
    return "\n".join(lines)


def _session(out: Path, target: Target, count: int, seed: int) -> Path:
    """The file of a session; one of other sources is removed."""
    path, stamp = out / f"{target.name}-{seed}.sqlite", out / f"{target.name}-{seed}.sources"
    now = f"{count} mutants {_digest(target)}"
    if not stamp.exists() or stamp.read_text() != now:
        path.unlink(missing_ok=True)
        stamp.write_text(now)
    return path


def _digest(target: Target) -> str:
    """A hash of a target's files and tests."""
    tests = [ROOT / test for test in target.tests if test.startswith("tests/")]
    files = [file for test in tests for file in ([test] if test.is_file() else sorted(test.glob("*.py")))]
    texts = [path.read_bytes() for path in [*(PACKAGE / file for file in target.files), *files]]
    return hashlib.sha256(b"\0".join(texts)).hexdigest()


def mutate(targets: Sequence[Target], count: int, seed: int, out: Path) -> str:
    """Judge a sample of each target's mutants and show those that survive; the table of them all."""
    preload()
    out.mkdir(parents=True, exist_ok=True)
    judged = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(ROOT, Path(folder) / "project")
        for target in targets:
            with use_db(_session(out, target, count, seed)) as db:
                if not db.num_work_items:
                    begin(db, target, count, seed)
                pursue(db, target, copy)
                judged[target.name] = list(outcomes(db))
                print(*_survivors(db), sep="\n\n", end="\n\n")
    return _table(judged)


def _survivors(db: WorkDB) -> list[str]:
    """The diffs of the mutants that no test noticed."""
    return [result.diff for _, result in db.completed_work_items if result.test_outcome == TestOutcome.SURVIVED]


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line, judge mutants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = {target.name: target for target in TARGETS}
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(known)}; all by default")
    parser.add_argument("--mutants", type=int, default=100, help="of each target (100)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutants", help="folder of the sessions")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.targets) - set(known))
    if unknown:
        parser.error(f"there is no target {', '.join(unknown)}; there are {', '.join(known)}")
    chosen = [known[name] for name in options.targets or known]
    print(mutate(chosen, options.mutants, options.seed, options.out.absolute()))


if __name__ == "__main__":
    main()
