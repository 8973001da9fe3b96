"""What is tried, what a command comes to undisturbed, and the judgement of what it leaves."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from record import Done, Record

from killing import remains
from killing.commands import COMMANDS, Life, Place


@dataclass(frozen=True)
class Calm:
    """What a command comes to when nothing disturbs it: with nothing stored, and once more."""

    cold: Life
    warm: Life
    answer: dict[str, str]
    leftovers: list[str]
    locks: int
    nbytes: int  # of the disk, without the inputs


def taken(place: Place) -> int:
    """Return how many bytes of the disk a place takes."""
    return sum(512 * path.lstat().st_blocks for path in place.root.rglob("*") if path.is_file())


@dataclass(frozen=True)
class Plan:
    """What is to be done and where: the numbers of trials by kind, of all commands together."""

    out: Path
    inputs: Path
    record: Record
    commands: Sequence[str]
    wanted: dict[str, int]

    def share(self, kind: str, name: str) -> int:
        """Return how many of a kind's trials are of one command."""
        every, more = divmod(self.wanted[kind], len(self.commands))
        return every + (self.commands.index(name) < more)

    def trials(self, kind: str, name: str) -> Trials:
        """Return the trials of a kind with something."""
        return Trials(self, kind, name)

    def calm(self, name: str) -> Calm:
        """Return what a command comes to, found once and kept. Raises RuntimeError when it fails."""
        kept = self.out / "calm" / f"{name}.json"
        if kept.is_file():
            values = json.loads(kept.read_text(encoding="utf-8"))
            return Calm(**{**values, "cold": Life(**values["cold"]), "warm": Life(**values["warm"])})
        place = Place(self.out / "calm" / name).make(self.inputs)
        before = taken(place)
        (done, cold), (again, warm) = place.lived(COMMANDS[name]), place.lived(COMMANDS[name])
        if done.code or again.code or (wrong := remains.broken(place, ended=True)):
            raise RuntimeError(f"{COMMANDS[name]} does not work: {done.err or again.err or wrong}")
        nbytes = taken(place) - before
        found = Calm(cold, warm, remains.answer(place), remains.leftovers(place), remains.locks(place), nbytes)
        kept.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
        return found


@dataclass(frozen=True)
class Trials:
    """The trials of one kind with one thing: how many were done, what became of them, and what was found."""

    plan: Plan
    kind: str
    name: str

    @property
    def counts(self) -> Counter[str]:
        """What became of the trials."""
        return self.plan.record.of(f"{self.kind} {self.name}")

    @property
    def number(self) -> int:
        """The number of the present trial: how many were done before."""
        return self.counts["trials"]

    def draw(self) -> np.random.Generator:
        """Return the randomness of the present trial."""
        return np.random.default_rng(
            [self.plan.record.seed, zlib.crc32(f"{self.kind} {self.name}".encode()), self.number]
        )

    def count(self, what: str) -> None:
        """End the trial: count it, and what became of it."""
        self.counts.update(("trials", what))
        self.plan.record.save()

    def find(self, *what: str) -> None:
        """Note findings of the present trial."""
        told = {"kind": self.kind, "name": self.name, "number": self.number}
        self.plan.record.findings += [{**told, "what": one} for one in what]

    def expect(self, holds: bool, what: str, done: Done | None = None) -> bool:
        """Note a finding unless something holds, with the output of a command. Return whether it holds."""
        if not holds:
            self.find(what if done is None else f"{what}: exit code {done.code}, {done.err[-1500:]!r}")
        return holds

    def find_lost(self, before: set[str], place: Place) -> set[str]:
        """Note what was finished before and is lost. Return what is finished now."""
        after = remains.finished(place)
        self.find(*(f"lost: {one}" for one in remains.lost(before, after, place)))
        return after

    def go_on(self, name: str, place: Place, before: set[str] | None = None) -> None:
        """Run a command to its end, and judge it; nothing of what was finished before may be lost."""
        done = place.whole(COMMANDS[name])
        self.find_lost(before or set(), place)
        self.judge(done, place, name)

    def judge(self, done: Done, place: Place, name: str, stored: bool = True) -> None:
        """Judge a command that was let finish: same answer as undisturbed, and nothing beside it.

        Stages of the answer may be missing unless all had to be `stored`: results that were there need no stage.
        """
        if not self.expect(done.code == 0, "it does not go on", done):
            return
        self.find(*remains.broken(place, ended=True))
        calm, answer = self.plan.calm(name), remains.answer(place)
        asked = {
            key: one for key, one in calm.answer.items() if stored or key in answer or not key.startswith(remains.STAGE)
        }
        other = sorted(key for key in asked.keys() | answer if asked.get(key) != answer.get(key))
        self.expect(not other, f"another answer: {', '.join(other)}")
        left = [name for name in remains.leftovers(place) if name not in calm.leftovers]
        self.expect(not left, f"left behind: {', '.join(left)}")
        self.expect(remains.locks(place) <= calm.locks, "more locks than stages")
