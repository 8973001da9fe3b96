#!/usr/bin/env python3
"""Damaged and strange inputs for every reader: each must be read rightly or refused in one sentence.

Inputs are numbered; a number, the seed and the reader's name make the same input again. A finding is an exception that
is none of tactile-loc's, a refusal that is no sentence or names no file, more than a minute or 3 GiB, a process that
dies, or something written elsewhere. Findings lie in OUT/findings/READER-NUMBER with the input that made them. What is
done is kept in OUT/state.json: the same command goes on there.
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
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PATHS = [str(ROOT / "scripts"), str(ROOT / "tests")]  # whose helpers write small results
sys.path[:0] = PATHS

from fuzzing.readers import READERS, Reader, reader  # noqa: E402
from fuzzing.trial import READ, REFUSED, SECONDS, make_input  # noqa: E402

PATIENCE_S = SECONDS + 60  # for a process that does not even hear its alarm
EXPECTED = (0, 2, 3)  # exit codes of a command: done, refused, something to notice
COMMAND_BYTES = 12 * 2**30  # of address space; libraries take most of it without using it


@dataclass
class Progress:
    """How many inputs of a reader are done, and what became of them; through how many commands of their own."""

    done: int = 0
    commands: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)


@dataclass
class State:
    """What is done of all readers with a seed, in a file."""

    path: Path
    seed: int
    readers: dict[str, Progress] = field(default_factory=dict)

    @classmethod
    def open(cls, path: Path, seed: int) -> State:
        """Read what was done with this seed; nothing, if it was another."""
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return cls(path, seed)
        if kept["seed"] != seed:
            return cls(path, seed)
        return cls(path, seed, {name: Progress(**values) for name, values in kept["readers"].items()})

    def of(self, name: str) -> Progress:
        """Return the progress of a reader."""
        return self.readers.setdefault(name, Progress())

    def save(self) -> None:
        """Write the file, whole."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_suffix(".tmp")
        kept = {"seed": self.seed, "readers": {name: asdict(one) for name, one in self.readers.items()}}
        temporary.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        temporary.replace(self.path)


def fuzz(chosen: Reader, state: State, inputs: int, commands: int, out: Path) -> Progress:
    """Read what is left of a reader's inputs, and the first of them by its command, too."""
    progress, pristine = state.of(chosen.name), _pristine(chosen, out)
    while progress.done < inputs:
        for line in _worked(chosen, state.seed, progress.done, inputs, pristine):
            _note(line, chosen, state, pristine, out)
            progress.done = line["number"] + 1
            if progress.done % 100 == 0:
                state.save()
    while chosen.words and progress.commands < commands:
        line = _commanded(chosen, state.seed, progress.commands, pristine, out)
        _note(line, chosen, state, pristine, out)
        progress.commands += 1
        state.save()
    state.save()
    return progress


def _pristine(chosen: Reader, out: Path) -> Path:
    """The folder of a reader's files as they should be, made once."""
    folder = out / "whole" / chosen.name
    if not folder.is_dir():
        making = folder.with_name(f".{folder.name}")
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        chosen.write(making)
        making.rename(folder)
    return folder


def _worked(chosen: Reader, seed: int, first: int, last: int, pristine: Path) -> Iterator[dict[str, Any]]:
    """What a process says of inputs, up to the last or to one that it does not survive."""
    with tempfile.TemporaryDirectory() as sandbox:
        words = [chosen.name, str(seed), str(first), str(last), str(pristine), sandbox]
        process = subprocess.Popen([sys.executable, "-m", "fuzzing.worker", *words], env=_environment(), cwd=ROOT,
                                   stdout=subprocess.PIPE, text=True)  # fmt: skip
        said = _line(process)
        if said is None or said["outcome"] not in (READ, REFUSED):
            process.kill()
            sys.exit(f"{chosen.name} does not read what is as it should be: {said}")
        number = first
        while number < last and (said := _line(process)) is not None:
            number = said["number"] + 1
            yield said
        process.kill()
        code = process.wait()
        if number < last:
            yield {"number": number, "outcome": f"dies ({code})", "details": ""}


def _line(process: subprocess.Popen[str]) -> dict[str, Any] | None:
    """The next line of a process; None if it ended, or hangs."""
    ready, _, _ = select.select([process.stdout], [], [], PATIENCE_S)
    text = process.stdout.readline() if ready and process.stdout else ""
    return json.loads(text) if text else None


def _environment() -> dict[str, str]:
    own = {"PYTHONPATH": os.pathsep.join(PATHS), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
           "TACTILE_LOC_PLUGINS": ""}  # fmt: skip
    return {**os.environ, **own}


def _commanded(chosen: Reader, seed: int, number: int, pristine: Path, out: Path) -> dict[str, Any]:
    """What the command line makes of an input."""
    with tempfile.TemporaryDirectory() as sandbox:
        folder = Path(sandbox, "input")
        make_input(chosen, pristine, folder, seed, number)
        names = {"FOLDER": str(folder), "STORE": str(out / "store")}
        words = [_filled(word, names) for word in chosen.words]
        limit = f'ulimit -v {COMMAND_BYTES // 1024}; exec "$@"'
        line = ["bash", "-c", limit, "-", sys.executable, "-m", "tactile_loc_cli.main", *words]
        try:
            done = subprocess.run(line, cwd=sandbox, env=_environment(), capture_output=True, text=True,
                                  errors="replace", timeout=PATIENCE_S, check=False)  # fmt: skip
        except subprocess.TimeoutExpired:
            return {"number": number, "outcome": "command: too long", "details": ""}
        left = [path.name for path in Path(sandbox).iterdir() if path != folder]
    return {"number": number, "outcome": _of_command(done, left), "details": f"{words}\n{done.stderr}\n{left}"}


def _filled(word: str, names: dict[str, str]) -> str:
    for name, text in names.items():
        word = word.replace(name, text)
    return word


def _of_command(done: subprocess.CompletedProcess[str], left: list[str]) -> str:
    """A command says nothing but an error's one line, notes and warnings."""
    errors = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    if done.returncode not in EXPECTED:
        return f"command: exit code {done.returncode}"
    if done.returncode == 2 and not (len(errors) == 1 and errors[0].startswith("error: ") and errors[0].isprintable()):
        return "command: no sentence"
    return "command: writes elsewhere" if left else (REFUSED if done.returncode == 2 else READ)


def _note(line: dict[str, Any], chosen: Reader, state: State, pristine: Path, out: Path) -> None:
    """Count what became of an input; of a finding keep the input."""
    outcome, number = line["outcome"], line["number"]
    counts = state.of(chosen.name).outcomes
    counts[outcome] = counts.get(outcome, 0) + 1
    if outcome in (READ, REFUSED):
        return
    folder = out / "findings" / f"{chosen.name}-{number}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        make_input(chosen, pristine, folder, state.seed, number)
    told = {"reader": chosen.name, "seed": state.seed, "number": number, "outcome": outcome}
    (folder / "finding.json").write_text(json.dumps(told) + "\n", encoding="utf-8")
    (folder / "finding.txt").write_text(line["details"], encoding="utf-8")
    print(f"{chosen.name} {number}: {outcome}", flush=True)


def _say(name: str, progress: Progress) -> None:
    found = Counter(progress.outcomes)
    read, refused = found.pop(READ, 0), found.pop(REFUSED, 0)
    said = f"{progress.done:6d} inputs, {progress.commands:3d} commands: {read} read, {refused} refused"
    print(f"{name:16s} {said}, {sum(found.values())} findings {dict(found) or ''}", flush=True)


def main(words: list[str] | None = None) -> int:
    """Fuzz the readers that are asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(one.name for one in READERS))
    parser.add_argument("--inputs", type=int, default=2000, help="inputs a reader (2000)")
    parser.add_argument("--commands", type=int, default=5, help="of these through the command line (5)")
    parser.add_argument("--seed", type=int, default=0, help="another seed makes other inputs (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fuzz", help="where all is kept (out/fuzz)")
    given = parser.parse_args(words)
    chosen = [reader(name) for name in given.readers] or list(READERS)
    state = State.open(given.out / "state.json", given.seed)
    for one in chosen:
        _say(one.name, fuzz(one, state, given.inputs, given.commands, given.out))
    findings = sum(count for one in chosen for kind, count in state.of(one.name).outcomes.items()
                   if kind not in (READ, REFUSED))  # fmt: skip
    return int(findings > 0)


if __name__ == "__main__":
    sys.exit(main())
