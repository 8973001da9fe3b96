"""What long programs share: their command line, their record of outcomes, and the start of commands."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_loc.store.files import write_json

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = (sys.executable, "-m", "tactile_loc_cli.main")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
PATHS = os.pathsep.join(str(ROOT / name) for name in (".", "cli", "scripts", "tests"))  # tests/ has helpers
OURS = {"PYTHONPATH": PATHS, "TACTILE_LOC_PLUGINS": "", **ONE_THREAD}  # environment of a command


def make_parser(about: str | None, what: str, known: Iterable[str], out: str, **numbers: tuple[int, str]) -> Any:
    """Return a parser for names among those `known`, options for `numbers` (default, help), a seed and a folder."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = list(known)

    def check_name(name: str) -> str:
        if name not in known:
            raise argparse.ArgumentTypeError(f"there is no {what} {name}, only {', '.join(known)}")
        return name

    names = f"{', '.join(known)}; all by default"
    # Python 3.11 compares the empty list of no names with `choices`, so a type checks the names.
    parser.add_argument("names", nargs="*", type=check_name, default=known, metavar=what.upper(), help=names)
    for name, (number, text) in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=number, metavar="N", help=f"{text} ({number})")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random draws (0)")
    folder, text = ROOT / "out" / out, f"folder of the results (out/{out})"
    parser.add_argument("--out", type=lambda path: Path(path).absolute(), default=folder, help=text)
    return parser


def limit_memory(nbytes: int) -> tuple[str, ...]:
    """Return the words to put before a command, to limit the address space of its processes to `nbytes`."""
    return "bash", "-c", f'ulimit -v {nbytes // 1024}; exec "$@"', "-"


@dataclass
class Record:
    """Counts of outcomes by name, and findings, kept in a file. The same command continues from this file."""

    path: Path
    seed: int
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    findings: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path, seed: int) -> Record:
        """Read the record. Return an empty record if the file is missing or belongs to another seed."""
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            kept = {}
        kept = kept if kept.get("seed") == seed else {}
        counts = {name: Counter(values) for name, values in kept.get("counts", {}).items()}
        return cls(path, seed, counts, kept.get("findings", []))

    def of(self, name: str) -> Counter[str]:
        """Return the counts of a name."""
        return self.counts.setdefault(name, Counter())

    def save(self) -> None:
        """Write the file. Raises OutputError if it cannot be written."""
        write_json(self.path, {"seed": self.seed, "counts": self.counts, "findings": self.findings})


@dataclass(frozen=True)
class Done:
    """A finished command: its exit code (if a signal killed it, minus the signal's number), and its output."""

    code: int
    out: str
    err: str

    @property
    def is_refusal(self) -> bool:
        """Whether the command ended with the exit code of bad input and, apart from warnings, one error line."""
        lines = [line for line in self.err.splitlines() if not line.startswith("warning: ")]
        return self.code == 2 and len(lines) == 1 and lines[0].startswith("error: ") and lines[0].isprintable()
