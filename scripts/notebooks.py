#!/usr/bin/env python3
"""Executes the notebooks of docs/notebooks and writes them, with their outputs, to out/notebooks.

An error in a cell ends the program with exit code 1, after the other notebooks. Give names to execute only some:
`scripts/notebooks.py first-touch`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

ROOT = Path(__file__).parents[1]
SOURCES, EXECUTED = ROOT / "docs" / "notebooks", ROOT / "out" / "notebooks"
CELL_TIMEOUT_S = 600


def list_notebooks() -> list[Path]:
    """Return the paths of all notebooks."""
    return sorted(SOURCES.glob("*.ipynb"))


def execute(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with its outputs. It runs in an empty folder, which is deleted afterwards.

    Raises CellExecutionError at the first cell with an error.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=CELL_TIMEOUT_S, resources={"metadata": {"path": folder}}).execute()
    return notebook


def main() -> int:
    """Execute the notebooks, and return the exit code."""
    notebooks = {path.stem: path for path in list_notebooks()}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="notebooks to execute; by default, all")
    names = parser.parse_args().names or list(notebooks)
    if unknown := set(names) - set(notebooks):
        parser.error(f"there is no notebook {', '.join(sorted(unknown))}; choose {', '.join(notebooks)}")
    EXECUTED.mkdir(parents=True, exist_ok=True)
    failed = False
    for name in names:
        start = time.perf_counter()
        try:
            notebook = execute(notebooks[name])
        except CellExecutionError as error:
            failed = True
            print(f"notebooks: {name} failed:\n{error}", file=sys.stderr)
            continue
        written = EXECUTED / f"{name}.ipynb"
        nbformat.write(notebook, written)
        print(f"notebooks: {time.perf_counter() - start:4.0f} s {written.relative_to(ROOT)}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
