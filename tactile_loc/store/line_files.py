"""Files that grow by whole lines, so that they stay readable if the program is killed."""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.store.files import guard_output
from tactile_loc.store.locks import lock

LONGEST = 1_000_000  # largest length of a line, bytes


def open_locked(path: Path) -> IO[bytes]:
    """Open a file for reading and appending, and lock it. Raises OutputError if that fails."""
    with guard_output(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b")
    try:
        free = lock(file.fileno(), wait=False)
    except OSError:  # a file system without locks
        free = True
    if not free:
        file.close()
        raise OutputError(f"{path} is used by another process; wait for it, or choose another `out`")
    return file


def add_line(file: IO[bytes], line: str) -> None:
    """Append a line to a file of `open_locked`, completely or not at all. Raises OutputError if this fails."""
    descriptor, text = file.fileno(), line.encode() + b"\n"
    size = os.fstat(descriptor).st_size
    try:
        written = os.write(descriptor, text)
        while written < len(text):
            written += os.write(descriptor, text[written:])
    except OSError as error:
        os.ftruncate(descriptor, size)
        advice = "its lines so far are kept; free some space, or choose another `out`"
        raise OutputError(f"{file.name} cannot be written ({error.strerror}); {advice}") from error


@contextmanager
def open_json_lines(path: Path) -> Iterator[Callable[[str], None]]:
    """Open a file of JSON lines, and yield a function that appends a JSON text without line breaks.

    An incomplete last line, left by a killed process, is removed. Raises OutputError when the file cannot be written,
    or when another process uses the file.
    """
    with open_locked(path) as file:
        _end_last_line(file.fileno())
        yield partial(add_line, file)


def _end_last_line(descriptor: int) -> None:
    """End the last line with a line break, or remove the line if it is not JSON."""
    size = os.fstat(descriptor).st_size
    start = max(0, size - LONGEST)
    os.lseek(descriptor, start, os.SEEK_SET)
    last = os.read(descriptor, size - start).rpartition(b"\n")[2]
    if not last:
        return
    try:
        json.loads(last)
    except ValueError:
        os.ftruncate(descriptor, size - len(last))
    else:
        os.write(descriptor, b"\n")
