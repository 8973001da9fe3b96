"""What long programs share: arguments, a JSON file of what they have done with a seed, and how commands are run."""

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
PATHS = os.pathsep.join(str(ROOT / name) for name in (".", "cli", "scripts", "tests"))  # tests write results
OURS = {"PYTHONPATH": PATHS, "TACTILE_LOC_PLUGINS": "", **ONE_THREAD}  # variables of a command


def make_parser(about: str | None, what: str, known: Iterable[str], out: str, **numbers: tuple[int, str]) -> Any:
    """Return a parser of names of `what` to do, by default all that are `known`, of numbers, of a seed and a folder.

    Each number has a default, and a text that says what it is.
    """
    known = list(known)

    def name_of(word: str) -> str:
        if word not in known:
            raise argparse.ArgumentTypeError(f"there is no {what} {word!r}; there are {', '.join(known)}")
        return word

    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = f"of {', '.join(known)}; all by default"
    parser.add_argument("names", nargs="*", type=name_of, default=known, metavar=what.upper(), help=names)
    for name, (number, text) in numbers.items():
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=int, default=number, metavar="N", help=f"{text} ({number})"
        )
    parser.add_argument("--seed", type=int, default=0, help="another seed draws others (0)")
    folder = ROOT / "out" / out
    parser.add_argument(
        "--out", type=lambda path: Path(path).absolute(), default=folder, help=f"where all is kept (out/{out})"
    )
    return parser


def limited(option: str, amount: int) -> tuple[str, ...]:
    """Return what stands before a command whose processes have a limit, such as ("-v", kilobytes of memory)."""
    return "bash", "-c", f'ulimit {option} {amount}; exec "$@"', "-"


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
