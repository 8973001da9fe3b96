"""The records of finished methods: kept as JSON lines, summarised as a table."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from experiment import Record
from methods import METHODS
from scipy.stats import binomtest
from trials import Trial

from tactile_loc import TactileLocError

NAME = "trials.jsonl"


class RecordsError(TactileLocError):
    """A file of records cannot be used."""


def read_records(path: Path, trials: Sequence[Trial]) -> dict[int, list[Record]]:
    """Return the records of each finished trial. A line that was being written when a run was killed is left out.

    Raises RecordsError if the file has records of another trial with the same number.
    """
    kept: dict[int, list[Record]] = {}
    if not path.exists():
        return kept
    wanted = {trial.number: trial for trial in trials}
    text = path.read_text()
    for number, line in enumerate(text[: text.rfind("\n") + 1].splitlines(), 1):
        try:
            records = [Record(**one) for one in json.loads(line)]
            key = records[0].trial
        except (ValueError, TypeError, IndexError) as error:
            raise RecordsError(f"line {number} of {path} is damaged: {error}; delete this line") from error
        trial = wanted.get(key)
        if trial is None:
            continue
        if {(r.part, r.clearance_mm, r.seed) for r in records} != {(trial.part, trial.clearance_mm, trial.seed)}:
            raise RecordsError(f"line {number} of {path} is of another seed or scene; choose another --out")
        kept[key] = records
    return kept


def append_records(path: Path, records: Sequence[Record]) -> None:
    """Append the records of one trial as one line, and cut off a line that a killed run left unfinished."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        file.seek(0)
        text = file.read()
        file.truncate(text.rfind(b"\n") + 1)
        file.write(json.dumps([asdict(record) for record in records]).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def compute_interval(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share, 0 to 1."""
    return binomtest(successes, count).proportion_ci(method="wilson")[:2]


def format_table(records: Sequence[Record]) -> str:
    """Return a Markdown table with one row for each method."""
    rows = [
        "| method | success | 95 % interval | peg | plug | bolt | time, s | touches | peak force, N | largest |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        some = [record for record in records if record.method == method]
        if some:
            rows.append("| " + " | ".join(_summarize(method, some)) + " |")
    return "\n".join(rows)


def _summarize(method: str, some: Sequence[Record]) -> list[str]:
    won = sum(record.success for record in some)
    low, high = compute_interval(won, len(some))
    parts = [[record for record in some if record.part == name] for name in ("peg", "plug", "bolt")]
    forces = [record.peak_force_n for record in some]
    return [
        method, f"{won} of {len(some)}", f"{100 * low:.0f} to {100 * high:.0f} %",
        *(f"{sum(r.success for r in few)} of {len(few)}" for few in parts),
        f"{np.mean([r.time_s for r in some]):.1f}", f"{np.mean([r.touches for r in some]):.1f}",
        f"{np.median(forces):.1f}", f"{max(forces):.1f}",
    ]  # fmt: skip
