"""A process that reads damaged inputs of one reader, and prints a line of JSON for each.

Its arguments: READER SEED FIRST LAST PRISTINE SANDBOX. PRISTINE holds the reader's files as they should be, SANDBOX is
a folder of its own. The process may die of an input; whoever started it knows from the lines which one that was.
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

from fuzzing.readers import reader
from fuzzing.trial import judged, limit_memory, make_input, watch_writes


def main(name: str, seed: int, first: int, last: int, pristine: Path, sandbox: Path) -> None:
    """Read inputs `first` to `last` - 1."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)  # libraries complain there
    logging.disable()
    warnings.simplefilter("ignore")
    chosen, folder = reader(name), sandbox / "input"
    shutil.copytree(pristine, folder)
    before = judged(chosen, folder)  # compiles, imports, fills caches
    print(json.dumps({"number": None, **asdict(before)}), file=out, flush=True)
    watch_writes()
    limit_memory()
    for number in range(first, last):
        shutil.rmtree(folder, ignore_errors=True)
        make_input(chosen, pristine, folder, seed, number)
        verdict = judged(chosen, folder)
        print(json.dumps({"number": number, **asdict(verdict)}), file=out, flush=True)


if __name__ == "__main__":
    name, seed, first, last, pristine, sandbox = sys.argv[1:]
    main(name, int(seed), int(first), int(last), Path(pristine), Path(sandbox))
