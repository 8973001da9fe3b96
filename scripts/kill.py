#!/usr/bin/env python3
"""Commands killed and starved: nothing may be lost, broken or left behind, and the answer must stay the same.

Commands are killed with all their processes at random moments and begun again. They get full disks and read-only
stores, run eight at once on one store, and meet clocks that go back and locks of dead processes. The seed draws the
moments, but what they hit depends on the machine. OUT/record.json keeps what happened: the same command goes on there.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / name) for name in ("scripts", ".", "cli")]

from killing.clocks import CASES, clock  # noqa: E402
from killing.commands import COMMANDS, make_inputs  # noqa: E402
from killing.trials import Plan, at_once, full, kill, read_only  # noqa: E402
from record import Record  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402
from rich.table import Table  # noqa: E402

KINDS = {"kill": kill, "full": full, "read-only": read_only, "at-once": at_once, "clock": clock}
NUMBERS = dict(zip(KINDS, (200, 50, 20, 12, len(CASES)), strict=True))
NOT_AMOUNTS = ("trials", "most left beside")


def table(record: Record) -> Table:
    """Return what happened: a row for each kind of trial and command."""
    found = Table("kind", "of what", "trials", "came to", "most left beside", "findings")
    for key, counts in record.counts.items():
        kind, _, name = key.partition(" ")
        came = ", ".join(f"{count} {what}" for what, count in counts.items() if what not in NOT_AMOUNTS)
        findings = sum((one["kind"], one["name"]) == (kind, name) for one in record.findings)
        found.add_row(kind, name, str(counts["trials"]), came, str(counts["most left beside"]), str(findings))
    return found


def main(words: list[str] | None = None) -> int:
    """Kill and starve what is asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(KINDS)}; by default all")
    parser.add_argument("--command", action="append", metavar="NAME", choices=list(COMMANDS),
                        help="of these commands alone; may be repeated")  # fmt: skip
    for kind, number in NUMBERS.items():
        parser.add_argument(f"--{kind}", type=int, default=number, metavar="N", help=f"so many of this kind ({number})")
    parser.add_argument("--seed", type=int, default=0, help="another seed draws other moments (0)")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "kill", help="where all is kept (out/kill)")
    given = parser.parse_args(words)
    if unknown := sorted(set(given.kinds) - set(KINDS)):
        parser.error(f"there is no kind {unknown[0]!r}; there are {', '.join(KINDS)}")
    out = given.out.absolute()
    record = Record.open(out / "record.json", given.seed)
    wanted = {kind: getattr(given, kind.replace("-", "_")) for kind in KINDS}
    chosen = [name for name in COMMANDS if name in (given.command or COMMANDS)]
    plan = Plan(out, make_inputs(out / "inputs"), record, chosen, wanted)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        for kind in given.kinds or KINDS:
            task = progress.add_task(kind, total=wanted[kind])
            for done in KINDS[kind](plan):
                progress.advance(task, done)
            record.save()
    Console().print(table(record))
    for one in record.findings:
        print("{kind} {name} {number}: {what}".format(**one), flush=True)
    return int(bool(record.findings))


if __name__ == "__main__":
    sys.exit(main())
