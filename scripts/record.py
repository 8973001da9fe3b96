"""What a long program has done with a seed, in a JSON file; and the commands that it runs."""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_loc.store.files import write_json

PROGRAM = (sys.executable, "-m", "tactile_loc_cli.main")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass
class Record:
    """Counts by what was tried, and findings. The same command continues from the file."""

    path: Path
    seed: int
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    findings: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path, seed: int) -> Record:
        """Read what was done with this seed; nothing, if the file is of another seed."""
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            kept = {}
        kept = kept if kept.get("seed") == seed else {}
        counts = {name: Counter(values) for name, values in kept.get("counts", {}).items()}
        return cls(path, seed, counts, kept.get("findings", []))

    def of(self, name: str) -> Counter[str]:
        """Return the counts of what was tried."""
        return self.counts.setdefault(name, Counter())

    def save(self) -> None:
        """Write the file, whole. Raises OutputError."""
        write_json(self.path, {"seed": self.seed, "counts": self.counts, "findings": self.findings})


@dataclass(frozen=True)
class Done:
    """What a command came to: its exit code, minus the signal that killed it, and its output."""

    code: int
    out: str
    err: str

    @property
    def is_refusal(self) -> bool:
        """Whether it ended with one error sentence, warnings aside, and the exit code of bad input."""
        lines = [line for line in self.err.splitlines() if not line.startswith("warning: ")]
        return self.code == 2 and len(lines) == 1 and lines[0].startswith("error: ") and lines[0].isprintable()
