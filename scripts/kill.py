#!/usr/bin/env python3
"""Commands killed and starved: nothing may be lost, broken or left behind, and the answer must stay the same.

Commands are killed with all their processes at random moments and begun again, given disks that are full or can only be
read, run eight at once on one store, and find clocks that go back and locks of the dead. What is drawn by chance is
drawn from the seed, but when a moment comes depends on the machine. OUT/record.json keeps what happened: the same
command goes on there.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / name) for name in ("scripts", ".", "cli")]

from killing.clocks import CASES, disturb  # noqa: E402
from killing.commands import COMMANDS, Command, Place, command, make_inputs  # noqa: E402
from killing.company import at_once  # noqa: E402
from killing.disks import can_mount  # noqa: E402
from killing.kills import Undisturbed, kill, undisturbed  # noqa: E402
from killing.record import Record  # noqa: E402
from killing.starving import read_only, starve  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402
from rich.table import Table  # noqa: E402

KINDS = ("kill", "full", "read-only", "at-once", "clock")
TOGETHER = "build"  # the command that is run several times at once
NOT_AMOUNTS = ("trials", "most left beside")

Advance = Callable[[int], object]


@dataclass(frozen=True)
class Plan:
    """What is to be done, and where."""

    out: Path
    inputs: Path
    record: Record
    commands: list[Command]
    wanted: Mapping[str, int]
    """How many trials of each kind, all commands together."""

    def share(self, kind: str, one: Command) -> int:
        """How many of a kind's trials are of one command."""
        every, more = divmod(self.wanted[kind], len(self.commands))
        return every + (self.commands.index(one) < more)

    def calm(self, name: str) -> Undisturbed:
        """What a command comes to when nobody disturbs it."""
        return undisturbed(command(name), self.out / "calm", self.inputs)


def killings(plan: Plan, advance: Advance) -> None:
    """Kill commands."""
    for one in plan.commands:
        trials, wanted = plan.record.trials("kill", one.name), plan.share("kill", one)
        advance(min(wanted, trials.counts["killed"]))
        if trials.counts["killed"] < wanted:
            kill(one, wanted, trials, Place(plan.out / "kill" / one.name), plan.inputs, plan.calm(one.name), advance)


def full_disks(plan: Plan, advance: Advance) -> None:
    """Starve commands of room on the disk."""
    for one in plan.commands:
        trials = plan.record.trials("full", one.name)
        advance(trials.number)
        folder = plan.out / "full" / one.name
        _counted(starve(one, plan.share("full", one), trials, folder, plan.inputs, plan.calm(one.name)), advance)


def read_only_stores(plan: Plan, advance: Advance) -> None:
    """Give commands stores that can only be read."""
    trials = plan.record.trials("read-only", "stores")
    advance(trials.number)
    if not can_mount():
        trials.counts["left out: no disk may be mounted"] = 1
        return
    calm = {one.name: plan.calm(one.name) for one in plan.commands}
    _counted(read_only(plan.wanted["read-only"], trials, plan.out / "read-only", plan.inputs, calm), advance)


def together(plan: Plan, advance: Advance) -> None:
    """Run a command eight times at once."""
    for name in ("build", "run"):
        trials = plan.record.trials("at-once", name)
        advance(trials.number)
        folder = plan.out / "at-once" / name
        wanted = plan.wanted["at-once"] // 6
        _counted(at_once(command(name), wanted, trials, folder, plan.inputs, plan.calm(name)), advance)


def clocks_and_locks(plan: Plan, advance: Advance) -> None:
    """Turn clocks back, and leave locks of the dead."""
    calm = {one.name: plan.calm(one.name) for one in COMMANDS}
    for name in list(CASES)[: plan.wanted["clock"]]:
        disturb(name, plan.record.trials("clock", name), plan.out / "clock", plan.inputs, calm)
        advance(1)


def _counted(trials: Iterator[None], advance: Advance) -> None:
    for _ in trials:
        advance(1)


DO = dict(zip(KINDS, (killings, full_disks, read_only_stores, together, clocks_and_locks), strict=True))


def table(record: Record) -> Table:
    """Return what happened: a row for each kind of trial and command."""
    found = Table("kind", "of what", "trials", "came to", "most left beside", "findings")
    for key, counts in record.counts.items():
        kind, _, name = key.partition(" ")
        came = ", ".join(f"{count} {what}" for what, count in counts.items() if what not in NOT_AMOUNTS)
        findings = sum((one.kind, one.name) == (kind, name) for one in record.findings)
        found.add_row(kind, name, str(counts["trials"]), came, str(counts["most left beside"]), str(findings))
    return found


def main(words: list[str] | None = None) -> int:
    """Kill and starve what is asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(KINDS)}; by default all")
    parser.add_argument("--command", action="append", metavar="NAME", choices=[one.name for one in COMMANDS],
                        help="of these commands alone; may be repeated")  # fmt: skip
    for kind, number in zip(KINDS, (200, 50, 20, 12, len(CASES)), strict=True):
        parser.add_argument(f"--{kind}", type=int, default=number, metavar="N", help=f"so many of this kind ({number})")
    parser.add_argument("--seed", type=int, default=0, help="another seed draws other moments (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "kill", help="where all is kept (out/kill)")
    given = parser.parse_args(words)
    if unknown := sorted(set(given.kinds) - set(KINDS)):
        parser.error(f"there is no kind {unknown[0]!r}; there are {', '.join(KINDS)}")
    out = given.out.absolute()
    record = Record.open(out / "record.json", given.seed)
    wanted = {kind: getattr(given, kind.replace("-", "_")) for kind in KINDS}
    chosen = [one for one in COMMANDS if one.name in (given.command or [each.name for each in COMMANDS])]
    plan = Plan(out, make_inputs(out / "inputs"), record, chosen, wanted)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        for kind in given.kinds or KINDS:
            task = progress.add_task(kind, total=wanted[kind])
            DO[kind](plan, lambda count, task=task: progress.advance(task, count))
            record.save()
    Console().print(table(record))
    for one in record.findings:
        print(f"{one.kind} {one.name} {one.number}: {one.what}", flush=True)
    return int(bool(record.findings))


if __name__ == "__main__":
    sys.exit(main())
