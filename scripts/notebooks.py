#!/usr/bin/env python3
"""Executes the notebooks of docs/notebooks and writes them, with their outputs, to out/notebooks.

A notebook is executed only if it or the package has changed since the last time, or with `--again`. An error in a cell
ends the program with exit code 1, after the other notebooks. Give names to execute only some: `scripts/notebooks.py
first-touch`.
"""

import argparse
import hashlib
import platform
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

ROOT = Path(__file__).parents[1]
SOURCES, EXECUTED = ROOT / "docs" / "notebooks", ROOT / "out" / "notebooks"
# what the outputs depend on, besides the notebook
USED = ("tactile_loc", "cli/tactile_loc_cli", "plugins_contrib", "constraints.txt")
KEY = "executed_with"  # the metadata of an executed notebook that holds its key
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
        place = {"metadata": {"path": folder}}
        client = NotebookClient(notebook, timeout=CELL_TIMEOUT_S, coalesce_streams=True, resources=place)
        kernel = client.create_kernel_manager()
        kernel.transport, kernel.ip = "ipc", f"{folder}/kernel"  # over TCP, any user of the computer could listen
        client.execute()
    return notebook


def compute_key(path: Path) -> str:
    """Return a hash of a notebook and of all that its outputs depend on: package, libraries and Python."""
    return hashlib.sha256(f"{_hash_package(ROOT)} {platform.python_version()}".encode() + path.read_bytes()).hexdigest()


@cache
def _hash_package(root: Path) -> str:
    found = hashlib.sha256()
    for path in (path for name in USED for path in [root / name, *sorted((root / name).rglob("*"))]):
        if path.is_file() and "__pycache__" not in path.parts:
            found.update(f"{path.relative_to(root)} {path.stat().st_size}\n".encode() + path.read_bytes())
    return found.hexdigest()


def read_executed(path: Path) -> nbformat.NotebookNode | None:
    """Return the executed copy of a notebook. It is None if there is no copy, or if it is out of date."""
    written = EXECUTED / path.name
    if not written.exists():
        return None
    executed = nbformat.read(written, as_version=4)
    return executed if executed.metadata.get(KEY) == compute_key(path) else None


def write_executed(path: Path) -> Path:
    """Execute a notebook, write the copy, and return its path. Raises CellExecutionError as `execute` does."""
    notebook = execute(path)
    notebook.metadata[KEY] = compute_key(path)
    EXECUTED.mkdir(parents=True, exist_ok=True)
    written = EXECUTED / path.name
    nbformat.write(notebook, written)
    return written


def main() -> int:
    """Execute the notebooks, and return the exit code."""
    notebooks = {path.stem: path for path in list_notebooks()}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="notebooks to execute; by default, all")
    parser.add_argument("--again", action="store_true", help="execute also those that have not changed")
    arguments = parser.parse_args()
    names = arguments.names or list(notebooks)
    if unknown := set(names) - set(notebooks):
        parser.error(f"there is no notebook {', '.join(sorted(unknown))}; choose {', '.join(notebooks)}")
    failed = False
    for name in names:
        if not arguments.again and read_executed(notebooks[name]) is not None:
            print(f"notebooks: {name} has not changed")
            continue
        start = time.perf_counter()
        try:
            written = write_executed(notebooks[name])
        except CellExecutionError as error:
            failed = True
            print(f"notebooks: {name} failed:\n{error}", file=sys.stderr)
            continue
        print(f"notebooks: {time.perf_counter() - start:4.0f} s {written.relative_to(ROOT)}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
