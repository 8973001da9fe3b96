"""The rows of finished jobs, kept in files, so that an interrupted sweep or benchmark resumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tactile_loc.store.files import read_json, remove_abandoned, write_json, write_text
from tactile_loc.sweeps.workers import Outcome

ROWS, ERRORS = "rows", "errors"  # folders


class FinishedRows:
    """The finished rows in the files OUT/rows/KEY.json, and tracebacks, in OUT/errors/KEY.txt."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def read(self, key: str) -> Outcome | None:
        """Return the outcome of this key; None if its file is missing or damaged."""
        try:
            found = read_json(self._locate_row(key))
            return Outcome(found["key"], found["measured"], tuple(found["built"]), found["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def read_successful(self, key: str) -> Outcome | None:
        """Return the outcome of this key; None if its file is missing or damaged, or if the job failed."""
        outcome = self.read(key)
        return None if outcome is None or outcome.error else outcome

    def write(self, outcome: Outcome, about: Mapping[str, Any]) -> None:
        """Write an outcome, with JSON values `about` its job, atomically. Raises OutputError."""
        trace = self.out / ERRORS / f"{outcome.key}.txt"
        if outcome.trace:
            write_text(trace, outcome.trace)
        elif not outcome.error:
            trace.unlink(missing_ok=True)
        values = {name: value for name, value in asdict(outcome).items() if name != "trace"}
        write_json(self._locate_row(outcome.key), {**values, **about})

    def tidy(self) -> None:
        """Remove unfinished files of a process that was killed."""
        for name in (ROWS, ERRORS):
            remove_abandoned(self.out / name)

    def _locate_row(self, key: str) -> Path:
        return self.out / ROWS / f"{key}.json"
