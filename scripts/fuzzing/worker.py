"""A process that reads damaged inputs, and prints a line of JSON for each.

Its arguments: SEED, SANDBOX, a folder of its own, and JOBS, JSON lists of a reader's name, the folder of its files as
they should be, and the first and the last number but one of its inputs. The process may die of an input; whoever
started it knows from the lines which one that was.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import IO

from fuzzing.readers import reader
from fuzzing.trial import Verdict, judged, limit_memory, make_input, watch_writes

Job = tuple[str, str, int, int]


def main(seed: int, sandbox: Path, jobs: list[Job]) -> None:
    """Read the inputs of all jobs; before, what is as it should be, which imports and compiles."""
    out = _silenced()
    folder = sandbox / "input"
    for name, pristine, _, _ in jobs:
        shutil.copytree(pristine, folder)
        _say(out, name, None, judged(reader(name), folder))
        shutil.rmtree(folder)
    watch_writes()
    limit_memory()
    for name, pristine, first, last in jobs:
        for number in range(first, last):
            make_input(reader(name), Path(pristine), folder, seed, number)
            _say(out, name, number, judged(reader(name), folder))
            shutil.rmtree(folder)


def _silenced() -> IO[str]:
    """Have libraries write to nowhere; return what was the standard output."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    logging.disable()
    warnings.simplefilter("ignore")
    return out


def _say(out: IO[str], name: str, number: int | None, verdict: Verdict) -> None:
    out.write(json.dumps({"reader": name, "number": number, **asdict(verdict)}) + "\n")
    out.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), json.loads(sys.argv[3]))
