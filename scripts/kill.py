#!/usr/bin/env python3
"""Kill and starve commands: no work may be lost, no file broken or left behind, and the answer must stay the same.

Each command is killed with all its processes at random moments, and started again. Commands also run on full disks, and
eight commands run at once on one store. The seed sets the moments, but the machine's speed decides which step a kill
hits. OUT/record.json keeps the outcomes. The same command continues from this file.
"""

import sys

from killing.commands import COMMANDS, make_inputs
from killing.trials import Plan, run_trials
from record import Record, make_parser
from tactile_loc_cli.console import make_progress

from tactile_loc.evaluation.text_tables import format_markdown

NUMBERS = {"kill": 200, "full": 50, "at-once": 12}
NOT_OUTCOMES = ("trials", "most left beside")


def format_table(record: Record) -> str:
    """Return a table with a row for each kind of trial and command."""
    rows = [["kind", "command", "trials", "outcomes", "most temporary files left", "findings"]]
    for key, counts in record.counts.items():
        kind, _, name = key.partition(" ")
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if outcome not in NOT_OUTCOMES)
        findings = sum((one["kind"], one["name"]) == (kind, name) for one in record.findings)
        rows.append([kind, name, str(counts["trials"]), outcomes, str(counts["most left beside"]), str(findings)])
    return format_markdown(rows)


def main(words: list[str] | None = None) -> int:
    """Kill and starve the chosen commands. Return 1 if there are findings."""
    numbers = {kind: (number, "trials of this kind") for kind, number in NUMBERS.items()}
    parser = make_parser(__doc__, "kind", NUMBERS, "kill", **numbers)
    parser.add_argument("--command", action="append", metavar="NAME", choices=list(COMMANDS),
                        help="kill this command only; may be repeated")  # fmt: skip
    given = parser.parse_args(words)
    record = Record.open(given.out / "record.json", given.seed)
    wanted = {kind: getattr(given, kind.replace("-", "_")) for kind in NUMBERS}
    chosen = [name for name in COMMANDS if name in (given.command or COMMANDS)]
    plan = Plan(given.out, make_inputs(given.out / "inputs"), record, chosen, wanted)
    progress = make_progress()
    for kind in given.names:
        with progress.task(kind, wanted[kind]) as advance:
            for done in run_trials(plan, kind):
                advance(done)
        record.save()
    print(format_table(record), end="")
    for one in record.findings:
        print("{kind} {name} {number}: {what}".format(**one))
    return int(bool(record.findings))


if __name__ == "__main__":
    sys.exit(main())
