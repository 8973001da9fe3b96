"""What happened: counts and findings, in a file from which the same command goes on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from kept import kept_of, write_kept

from killing.commands import Done


@dataclass(frozen=True)
class Finding:
    """What must not be: in which kind of trial, of what, in which of them, and what it is."""

    kind: str
    name: str
    number: int
    what: str


@dataclass
class Record:
    """What happened with a seed, by the kind of trial and the name of what was tried."""

    path: Path
    seed: int
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path, seed: int) -> Record:
        """Read what happened with this seed; nothing, if it was another."""
        kept = kept_of(path, seed)
        counts = {name: Counter(values) for name, values in kept.get("counts", {}).items()}
        return cls(path, seed, counts, [Finding(**one) for one in kept.get("findings", [])])

    def save(self) -> None:
        """Write the file, whole."""
        write_kept(self.path, self.seed, counts=self.counts, findings=[vars(one) for one in self.findings])

    def trials(self, kind: str, name: str) -> Trials:
        """Return the trials of a kind with something."""
        return Trials(self, kind, name, self.counts.setdefault(f"{kind} {name}", Counter()))


@dataclass
class Trials:
    """The trials of one kind with one thing: how many were done, and what became of them."""

    record: Record
    kind: str
    name: str
    counts: Counter[str]

    @property
    def number(self) -> int:
        """The number of the present trial: how many were done before."""
        return self.counts["trials"]

    def count(self, *what: str) -> None:
        """End the trial: count it, and what became of it."""
        self.counts.update(("trials", *what))
        self.record.save()

    def most(self, what: str, amount: int) -> None:
        """Note an amount if it is the most so far."""
        self.counts[what] = max(self.counts[what], amount)

    def find(self, *what: str) -> None:
        """Note findings of the present trial."""
        self.record.findings += [Finding(self.kind, self.name, self.number, one) for one in what]

    def expect(self, holds: bool, what: str, done: Done | None = None) -> bool:
        """Note a finding unless something holds; with what a command said. Return whether it holds."""
        if not holds:
            self.find(what if done is None else f"{what}: exit code {done.code}, {done.err[-1500:]!r}")
        return holds
