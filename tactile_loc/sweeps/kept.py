"""Finished rows, each kept in a file of its own as soon as it is there: OUT/rows/KEY.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tactile_loc.store.files import write_atomically
from tactile_loc.sweeps.combinations import Combination
from tactile_loc.sweeps.work import Outcome


class KeptRows:
    """The rows of a sweep's folder. A traceback lies beside them in OUT/errors/KEY.txt."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def read(self, key: str) -> Outcome | None:
        """Return the outcome of this key; None if there is none, or none that can be read."""
        try:
            found = json.loads(self._row(key).read_text(encoding="utf-8"))
            return Outcome(found["key"], found["measured"], tuple(found["built"]), found["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def keep(self, combination: Combination, outcome: Outcome) -> None:
        """Write an outcome, atomically. Raises OutputError."""
        trace = self.out / "errors" / f"{outcome.key}.txt"
        if outcome.trace:
            write_atomically(trace, lambda path: path.write_text(outcome.trace, encoding="utf-8"))
        elif not outcome.error:
            trace.unlink(missing_ok=True)
        values = {name: value for name, value in asdict(outcome).items() if name != "trace"}
        record = {**values, "object": combination.object, "configuration": configuration(combination)}
        text = json.dumps(record, indent=1) + "\n"
        write_atomically(self._row(outcome.key), lambda path: path.write_text(text, encoding="utf-8"))

    def _row(self, key: str) -> Path:
        return self.out / "rows" / f"{key}.json"


def configuration(combination: Combination) -> Mapping[str, Any]:
    """Return every setting of a combination as JSON values."""
    return {**combination.config.model_dump(mode="json", exclude={"top"}), "count": combination.count}
