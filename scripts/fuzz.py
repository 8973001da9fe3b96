#!/usr/bin/env python3
"""Give damaged inputs to every reader, which must read them correctly or refuse them in one sentence.

The reader's name, the seed and a number define an input. There are these kinds of findings: an exception that is not
one of tactile-loc's own; a refusal that is not one sentence, or names no file; the use of more than a minute or 3 GiB;
a process that dies; and a file written elsewhere. OUT/findings/READER-NUMBER has a finding and its input.
OUT/state.json keeps the counts. The same command continues from this file.
"""

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

from record import OURS, PROGRAM, ROOT, Done, Record, limit_memory, make_parser

sys.path.append(str(ROOT / "tests"))  # for the helpers that write results

from fuzzing.readers import READERS
from fuzzing.trial import READ, REFUSED, SECONDS, Job, Verdict, make_input, read_all

PATIENCE_S = SECONDS + 60  # limit for a process that ignores its alarm
EXPECTED = (0, 2)  # exit codes of a command: done, refused
COMMAND_BYTES = 12 * 2**30  # address space, which libraries reserve without using it
SPAWN = multiprocessing.get_context("spawn")


def fuzz(names: Sequence[str], state: Record, inputs: int, commands: int, out: Path) -> None:
    """Give readers their remaining inputs, in one process. Also give the first inputs of each reader to a command."""
    for name in names:
        _write_corpus(name, out)
    while jobs := [(name, number) for name in names for number in range(state.of(name)["inputs"], inputs)]:
        for (name, number), verdict in zip(jobs, _read_inputs(jobs, state.seed, out), strict=False):
            _note(name, number, verdict, "inputs", state, out)
            if number % 100 == 0:
                state.save()
    for name in (name for name in names if READERS[name].line):
        for number in range(state.of(name)["commands"], commands):
            _note(name, number, _run_command(name, state.seed, number, out), "commands", state, out)
            state.save()
    state.save()


def select_findings(counts: Counter[str]) -> dict[str, int]:
    """Return the numbers of a reader's findings by kind."""
    return {kind: n for kind, n in counts.items() if kind not in (READ, REFUSED, "inputs", "commands")}


def _write_corpus(name: str, out: Path) -> None:
    """Write a reader's correct files, unless they exist."""
    folder, making = out / "whole" / name, out / "whole" / f".{name}"
    if not folder.is_dir():
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        READERS[name].write(making)
        making.rename(folder)


def _read_inputs(jobs: Sequence[Job], seed: int, out: Path) -> Iterator[Verdict]:
    """Yield the verdicts of one process. The process ends with the last input, or with an input that kills it."""
    whole: list[Job] = [(name, None) for name in dict.fromkeys(name for name, _ in jobs)]
    with tempfile.TemporaryDirectory() as sandbox:
        hear, say = SPAWN.Pipe(duplex=False)
        arguments = ([*whole, *jobs], seed, out / "whole", Path(sandbox, "input"), say)
        process = SPAWN.Process(target=read_all, args=arguments, daemon=True)
        with mock.patch.dict(os.environ, OURS):
            process.start()
        say.close()
        for name, number in (*whole, *jobs):
            try:
                if not hear.poll(PATIENCE_S):
                    process.kill()
                verdict = hear.recv()
            except EOFError:
                process.join()
                verdict = f"dies ({process.exitcode})", ""
            if number is not None:
                yield verdict
            elif verdict[0] not in (READ, REFUSED):
                process.kill()
                sys.exit(f"{name} does not read its correct files: {verdict}")
            if verdict[0].startswith("dies"):
                return
        process.join()


def _run_command(name: str, seed: int, number: int, out: Path) -> Verdict:
    """Return the verdict of the command line on an input."""
    with tempfile.TemporaryDirectory() as sandbox:
        folder = Path(sandbox, "input")
        make_input(READERS[name], out / "whole" / name, folder, seed, number)
        words = READERS[name].line.replace("FOLDER", str(folder)).replace("STORE", str(out / "store")).split()
        line = [*limit_memory(COMMAND_BYTES), *PROGRAM, *words]
        try:
            done = subprocess.run(line, cwd=sandbox, env={**os.environ, **OURS}, capture_output=True, text=True,
                                  errors="replace", timeout=PATIENCE_S, check=False)  # fmt: skip
        except subprocess.TimeoutExpired:
            return "command: too long", str(words)
        left = [path.name for path in Path(sandbox).iterdir() if path != folder]
    return _judge_command(Done(done.returncode, done.stdout, done.stderr), left), f"{words}\n{done.stderr}\n{left}"


def _judge_command(done: Done, left: list[str]) -> str:
    if done.code not in EXPECTED:
        return f"command: exit code {done.code}"
    if done.code == 2 and not done.is_refusal:
        return "command: no sentence"
    return "command: writes elsewhere" if left else (REFUSED if done.code == 2 else READ)


def _note(name: str, number: int, verdict: Verdict, what: str, state: Record, out: Path) -> None:
    """Count the outcome of an input, and keep the input of a finding."""
    outcome, details = verdict
    state.of(name).update((what, outcome))
    if outcome in (READ, REFUSED):
        return
    folder = out / "findings" / f"{name}-{number}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        make_input(READERS[name], out / "whole" / name, folder, state.seed, number)
    finding = {"reader": name, "seed": state.seed, "number": number, "outcome": outcome}
    (folder / "finding.json").write_text(json.dumps(finding) + "\n", encoding="utf-8")
    (folder / "finding.txt").write_text(details, encoding="utf-8")
    print(f"{name} {number}: {outcome}", flush=True)


def main(words: list[str] | None = None) -> int:
    """Fuzz the chosen readers. Return 1 if there are findings."""
    numbers = {"inputs": (2000, "inputs of each reader"), "commands": (5, "inputs of each command")}
    given = make_parser(__doc__, "reader", READERS, "fuzz", **numbers).parse_args(words)
    state = Record.open(given.out / "state.json", given.seed)
    for name in given.names:
        fuzz([name], state, given.inputs, given.commands, given.out)
        counts = state.of(name)
        line = f"{counts['inputs']:6d} inputs, {counts['commands']:3d} commands: {counts[READ]} read"
        found = select_findings(counts)
        print(f"{name:16s} {line}, {counts[REFUSED]} refused, {sum(found.values())} findings {found or ''}", flush=True)
    return int(any(select_findings(state.of(name)) for name in given.names))


if __name__ == "__main__":
    sys.exit(main())
