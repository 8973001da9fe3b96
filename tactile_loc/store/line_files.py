"""Files that grow by whole lines: whenever the program ends, what is there can be read line by line."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from tactile_loc.core.errors import OutputError
from tactile_loc.store.files import guard_output

LONGEST = 1_000_000  # bytes of a line


def open_locked(path: Path) -> IO[bytes]:
    """Open a file to read it and to add to it, alone. Raises OutputError when that is impossible."""
    with guard_output(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        raise OutputError(f"another process is at work on {path}; wait for it, or choose another --out") from error
    return file


def add_line(file: IO[bytes], line: str) -> None:
    """Add a line to a file of `open_locked`, all of it or nothing. Raises OutputError when the disk refuses."""
    descriptor, text = file.fileno(), line.encode() + b"\n"
    size = os.fstat(descriptor).st_size
    try:
        written = os.write(descriptor, text)
        while written < len(text):
            written += os.write(descriptor, text[written:])
    except OSError as error:
        os.ftruncate(descriptor, size)
        raise OutputError(
            f"{file.name} cannot be written any more ({error.strerror}); its lines so far are whole; free some "
            "space, or choose another --out"
        ) from error


@contextmanager
def open_json_lines(path: Path) -> Iterator[Callable[[str], None]]:
    """Give what adds a value, as JSON without line breaks, to a file of JSON lines; what is in it already stays.

    A last line that a killed process left half-written is removed. Raises OutputError when it cannot be written, or
    another process is at work on it.
    """
    with open_locked(path) as file:
        _end_last_line(file.fileno())
        yield partial(add_line, file)


def _end_last_line(descriptor: int) -> None:
    """Give the last line its end; remove it if it is no JSON."""
    size = os.fstat(descriptor).st_size
    start = max(0, size - LONGEST)
    last = os.pread(descriptor, size - start, start).rpartition(b"\n")[2]
    if not last:
        return
    try:
        json.loads(last)
    except ValueError:
        os.ftruncate(descriptor, size - len(last))
    else:
        os.write(descriptor, b"\n")
