#!/usr/bin/env python3
"""Commands killed and starved: nothing may be lost, broken or left behind, and the answer must stay the same.

Commands are killed with all their processes at random moments and begun again. They get full disks and read-only
stores, run eight at once on one store, and meet files from other years and locks of dead processes. The seed draws the
moments, but what they hit depends on the machine. OUT/record.json keeps what happened: the same command goes on there.
"""

from __future__ import annotations

import sys

from killing.cases import CASES, cases
from killing.commands import COMMANDS, make_inputs
from killing.trials import Plan, at_once, full, kill, read_only
from record import Record, make_parser
from tactile_loc_cli.console import make_progress

from tactile_loc.evaluation.tabular import format_markdown

KINDS = {"kill": kill, "full": full, "read-only": read_only, "at-once": at_once, "cases": cases}
NUMBERS = dict(zip(KINDS, (200, 50, 20, 12, len(CASES)), strict=True))
NOT_AMOUNTS = ("trials", "most left beside")


def table(record: Record) -> str:
    """Return what happened: a row for each kind of trial and command."""
    rows = [["kind", "of what", "trials", "came to", "most left beside", "findings"]]
    for key, counts in record.counts.items():
        kind, _, name = key.partition(" ")
        came = ", ".join(f"{count} {what}" for what, count in counts.items() if what not in NOT_AMOUNTS)
        findings = sum((one["kind"], one["name"]) == (kind, name) for one in record.findings)
        rows.append([kind, name, str(counts["trials"]), came, str(counts["most left beside"]), str(findings)])
    return format_markdown(rows)


def main(words: list[str] | None = None) -> int:
    """Kill and starve what is asked for; return 1 if there are findings."""
    numbers = {kind: (number, "so many of this kind") for kind, number in NUMBERS.items()}
    parser = make_parser(__doc__, "kind", KINDS, "kill", **numbers)
    parser.add_argument("--command", action="append", metavar="NAME", choices=list(COMMANDS),
                        help="of these commands alone; may be repeated")  # fmt: skip
    given = parser.parse_args(words)
    record = Record.open(given.out / "record.json", given.seed)
    wanted = {kind: getattr(given, kind.replace("-", "_")) for kind in KINDS}
    chosen = [name for name in COMMANDS if name in (given.command or COMMANDS)]
    plan = Plan(given.out, make_inputs(given.out / "inputs"), record, chosen, wanted)
    progress = make_progress()
    for kind in given.names:
        with progress.task(kind, wanted[kind]) as advance:
            for done in KINDS[kind](plan):
                advance(done)
        record.save()
    print(table(record), end="")
    for one in record.findings:
        print("{kind} {name} {number}: {what}".format(**one))
    return int(bool(record.findings))


if __name__ == "__main__":
    sys.exit(main())
