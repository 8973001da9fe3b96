#!/usr/bin/env python3
"""Damaged and strange inputs for every reader: each must be read rightly or refused in one sentence.

Inputs are numbered: a number, the seed and the reader's name make the same input again. A finding is an exception that
is none of tactile-loc's, a refusal that is no sentence or names no file, more than a minute or 3 GiB, a process that
dies, or something written elsewhere. OUT/findings/READER-NUMBER holds a finding and its input. OUT/state.json keeps
what is done: the same command goes on there.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PATHS = [str(ROOT / name) for name in ("scripts", "tests", ".", "cli")]  # tests have helpers that write results
sys.path[:0] = PATHS

from fuzzing.readers import READERS  # noqa: E402
from fuzzing.trial import READ, REFUSED, SECONDS, Job, make_input  # noqa: E402
from record import ONE_THREAD, PROGRAM, Done, Record  # noqa: E402

PATIENCE_S = SECONDS + 60  # for a process that does not even hear its alarm
EXPECTED = (0, 2, 3)  # exit codes of a command: done, refused, something to notice
COMMAND_BYTES = 12 * 2**30  # of address space; libraries take most of it without using it
ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(PATHS), **ONE_THREAD, "TACTILE_LOC_PLUGINS": ""}


def fuzz(names: Sequence[str], state: Record, inputs: int, commands: int, out: Path) -> None:
    """Have readers read the rest of their inputs, in one process, and their commands the first of these."""
    for name in names:
        _write_whole(name, out)
    while jobs := [(name, str(out / "whole" / name), state.of(name)["inputs"], inputs)
                   for name in names if state.of(name)["inputs"] < inputs]:  # fmt: skip
        for line in _worked(state.seed, jobs):
            _note(line, "inputs", state, out)
            if line["number"] % 100 == 0:
                state.save()
    for name in (name for name in names if READERS[name].line):
        for number in range(state.of(name)["commands"], commands):
            _note(_commanded(name, state.seed, number, out), "commands", state, out)
            state.save()
    state.save()


def findings(counts: Counter[str]) -> dict[str, int]:
    """Return the findings of a reader by their kinds."""
    return {kind: n for kind, n in counts.items() if kind not in (READ, REFUSED, "inputs", "commands")}


def _write_whole(name: str, out: Path) -> None:
    """Write, once, a reader's files as they should be."""
    folder, making = out / "whole" / name, out / "whole" / f".{name}"
    if not folder.is_dir():
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        READERS[name].write(making)
        making.rename(folder)


def _worked(seed: int, jobs: Sequence[Job]) -> Iterator[dict[str, Any]]:
    """Yield what a process says of inputs, up to the last or to one that it does not survive."""
    with tempfile.TemporaryDirectory() as sandbox:
        words = [sys.executable, "-m", "fuzzing.trial", str(seed), sandbox, json.dumps(jobs)]
        environment = {**os.environ, **ENVIRONMENT}
        process = subprocess.Popen(words, env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        for name, *_ in jobs:
            said = _line(process)
            if said is None or said["outcome"] not in (READ, REFUSED):
                process.kill()
                sys.exit(f"{name} does not read what is as it should be: {said}")
        for name, number in ((name, number) for name, _, first, last in jobs for number in range(first, last)):
            said = _line(process)
            if said is None:
                process.kill()
                yield {"reader": name, "number": number, "outcome": f"dies ({process.wait()})", "details": ""}
                return
            yield said
        process.wait()


def _line(process: subprocess.Popen[str]) -> dict[str, Any] | None:
    """Return the next line of a process; None if it ended, or hangs."""
    ready, _, _ = select.select([process.stdout], [], [], PATIENCE_S)
    text = process.stdout.readline() if ready and process.stdout else ""
    return json.loads(text) if text else None


def _commanded(name: str, seed: int, number: int, out: Path) -> dict[str, Any]:
    """Return what the command line makes of an input."""
    with tempfile.TemporaryDirectory() as sandbox:
        folder = Path(sandbox, "input")
        make_input(READERS[name], out / "whole" / name, folder, seed, number)
        words = [word.replace("FOLDER", str(folder)).replace("STORE", str(out / "store"))
                 for word in READERS[name].line.split()]  # fmt: skip
        line = ["bash", "-c", f'ulimit -v {COMMAND_BYTES // 1024}; exec "$@"', "-", *PROGRAM, *words]
        try:
            done = subprocess.run(line, cwd=sandbox, env={**os.environ, **ENVIRONMENT}, capture_output=True, text=True,
                                  errors="replace", timeout=PATIENCE_S, check=False)  # fmt: skip
            left = [path.name for path in Path(sandbox).iterdir() if path != folder]
            outcome, details = _outcome(Done(done.returncode, done.stdout, done.stderr), left), f"{done.stderr}\n{left}"
        except subprocess.TimeoutExpired:
            outcome, details = "command: too long", ""
    return {"reader": name, "number": number, "outcome": outcome, "details": f"{words}\n{details}"}


def _outcome(done: Done, left: list[str]) -> str:
    if done.code not in EXPECTED:
        return f"command: exit code {done.code}"
    if done.code == 2 and not done.is_refusal:
        return "command: no sentence"
    return "command: writes elsewhere" if left else (REFUSED if done.code == 2 else READ)


def _note(line: dict[str, Any], what: str, state: Record, out: Path) -> None:
    """Count what became of an input; keep the input of a finding."""
    name, outcome, number = line["reader"], line["outcome"], line["number"]
    state.of(name).update((what, outcome))
    if outcome in (READ, REFUSED):
        return
    folder = out / "findings" / f"{name}-{number}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        make_input(READERS[name], out / "whole" / name, folder, state.seed, number)
    told = {"reader": name, "seed": state.seed, "number": number, "outcome": outcome}
    (folder / "finding.json").write_text(json.dumps(told) + "\n", encoding="utf-8")
    (folder / "finding.txt").write_text(line["details"], encoding="utf-8")
    print(f"{name} {number}: {outcome}", flush=True)


def main(words: list[str] | None = None) -> int:
    """Fuzz the readers that are asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(READERS))
    parser.add_argument("--inputs", type=int, default=2000, help="inputs a reader (2000)")
    parser.add_argument("--commands", type=int, default=5, help="of these through the command line (5)")
    parser.add_argument("--seed", type=int, default=0, help="another seed makes other inputs (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fuzz", help="where all is kept (out/fuzz)")
    given = parser.parse_args(words)
    if unknown := sorted(set(given.readers) - set(READERS)):
        parser.error(f"there is no reader {unknown[0]!r}; there are {', '.join(READERS)}")
    chosen = [name for name in READERS if name in (given.readers or READERS)]
    out = given.out.absolute()  # commands run in folders of their own
    state = Record.open(out / "state.json", given.seed)
    for name in chosen:
        fuzz([name], state, given.inputs, given.commands, out)
        counts = state.of(name)
        said = f"{counts['inputs']:6d} inputs, {counts['commands']:3d} commands: {counts[READ]} read"
        found = findings(counts)
        print(f"{name:16s} {said}, {counts[REFUSED]} refused, {sum(found.values())} findings {found or ''}", flush=True)
    return int(any(findings(state.of(name)) for name in chosen))


if __name__ == "__main__":
    sys.exit(main())
