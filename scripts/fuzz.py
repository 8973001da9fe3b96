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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PATHS = [str(ROOT / name) for name in ("scripts", "tests", ".", "cli")]  # of the tests: helpers that write results
sys.path[:0] = PATHS

from fuzzing.readers import READERS, Reader, reader  # noqa: E402
from fuzzing.trial import READ, REFUSED, SECONDS, make_input  # noqa: E402
from kept import kept_of, write_kept  # noqa: E402

Job = tuple[str, str, int, int]

PATIENCE_S = SECONDS + 60  # for a process that does not even hear its alarm
KNOWN = [one.name for one in READERS]
EXPECTED = (0, 2, 3)  # exit codes of a command: done, refused, something to notice
COMMAND_BYTES = 12 * 2**30  # of address space; libraries take most of it without using it


@dataclass
class Progress:
    """How many inputs of a reader are done, and what became of them; through how many commands of their own."""

    done: int = 0
    commands: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)

    @property
    def findings(self) -> dict[str, int]:
        """The findings by their kinds, and how many inputs made them."""
        return {kind: count for kind, count in self.outcomes.items() if kind not in (READ, REFUSED)}


@dataclass
class State:
    """What is done of all readers with a seed, in a file."""

    path: Path
    seed: int
    readers: dict[str, Progress] = field(default_factory=dict)

    @classmethod
    def open(cls, path: Path, seed: int) -> State:
        """Read what was done with this seed; nothing, if it was another."""
        readers = kept_of(path, seed).get("readers", {})
        return cls(path, seed, {name: Progress(**values) for name, values in readers.items()})

    def of(self, name: str) -> Progress:
        """Return the progress of a reader."""
        return self.readers.setdefault(name, Progress())

    def save(self) -> None:
        """Write the file, whole."""
        write_kept(self.path, self.seed, readers={name: asdict(one) for name, one in self.readers.items()})


def fuzz(chosen: Sequence[Reader], state: State, inputs: int, commands: int, out: Path) -> None:
    """Read what is left of the inputs of readers, in one process, and the first of them by their commands, too."""
    whole = {one.name: _pristine(one, out) for one in chosen}
    while jobs := [(name, str(path), state.of(name).done, inputs) for name, path in whole.items()
                   if state.of(name).done < inputs]:  # fmt: skip
        for line in _worked(state.seed, jobs):
            _note(line, state, whole, out)
            state.of(line["reader"]).done += 1
            if line["number"] % 100 == 0:
                state.save()
    for one in (one for one in chosen if one.words):
        for number in range(state.of(one.name).commands, commands):
            _note(_commanded(one, state.seed, number, whole[one.name], out), state, whole, out)
            state.of(one.name).commands += 1
            state.save()
    state.save()


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


def _worked(seed: int, jobs: Sequence[Job]) -> Iterator[dict[str, Any]]:
    """What a process says of inputs, up to the last or to one that it does not survive."""
    with tempfile.TemporaryDirectory() as sandbox:
        words = [sys.executable, "-m", "fuzzing.worker", str(seed), sandbox, json.dumps(jobs)]
        process = subprocess.Popen(words, env=_environment(), cwd=ROOT, stdout=subprocess.PIPE, text=True)
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
        said = {"reader": chosen.name, "number": number}
        names = {"FOLDER": str(folder), "STORE": str(out / "store")}
        words = [_filled(word, names) for word in chosen.words]
        limit = f'ulimit -v {COMMAND_BYTES // 1024}; exec "$@"'
        line = ["bash", "-c", limit, "-", sys.executable, "-m", "tactile_loc_cli.main", *words]
        try:
            done = subprocess.run(line, cwd=sandbox, env=_environment(), capture_output=True, text=True,
                                  errors="replace", timeout=PATIENCE_S, check=False)  # fmt: skip
        except subprocess.TimeoutExpired:
            return {**said, "outcome": "command: too long", "details": str(words)}
        left = [path.name for path in Path(sandbox).iterdir() if path != folder]
    return {**said, "outcome": _of_command(done, left), "details": f"{words}\n{done.stderr}\n{left}"}


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


def _note(line: dict[str, Any], state: State, whole: Mapping[str, Path], out: Path) -> None:
    """Count what became of an input; of a finding keep the input."""
    name, outcome, number = line["reader"], line["outcome"], line["number"]
    counts = state.of(name).outcomes
    counts[outcome] = counts.get(outcome, 0) + 1
    if outcome in (READ, REFUSED):
        return
    folder = out / "findings" / f"{name}-{number}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        make_input(reader(name), whole[name], folder, state.seed, number)
    told = {"reader": name, "seed": state.seed, "number": number, "outcome": outcome}
    (folder / "finding.json").write_text(json.dumps(told) + "\n", encoding="utf-8")
    (folder / "finding.txt").write_text(line["details"], encoding="utf-8")
    print(f"{name} {number}: {outcome}", flush=True)


def _say(name: str, progress: Progress) -> None:
    read, refused = (progress.outcomes.get(outcome, 0) for outcome in (READ, REFUSED))
    said = f"{progress.done:6d} inputs, {progress.commands:3d} commands: {read} read, {refused} refused"
    print(f"{name:16s} {said}, {sum(progress.findings.values())} findings {progress.findings or ''}", flush=True)


def main(words: list[str] | None = None) -> int:
    """Fuzz the readers that are asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(KNOWN))
    parser.add_argument("--inputs", type=int, default=2000, help="inputs a reader (2000)")
    parser.add_argument("--commands", type=int, default=5, help="of these through the command line (5)")
    parser.add_argument("--seed", type=int, default=0, help="another seed makes other inputs (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fuzz", help="where all is kept (out/fuzz)")
    given = parser.parse_args(words)
    chosen = [one for one in READERS if one.name in (given.readers or KNOWN)]
    if unknown := sorted(set(given.readers) - set(KNOWN)):
        parser.error(f"there is no reader {unknown[0]!r}; there are {', '.join(KNOWN)}")
    out = given.out.absolute()  # commands run in folders of their own
    state = State.open(out / "state.json", given.seed)
    for one in chosen:
        fuzz([one], state, given.inputs, given.commands, out)
        _say(one.name, state.of(one.name))
    return int(any(state.of(one.name).findings for one in chosen))


if __name__ == "__main__":
    sys.exit(main())
