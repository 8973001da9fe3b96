"""Files that grow by whole lines: whenever the program ends, what is there can be read line by line."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import IO

from tactile_loc.core.errors import OutputError

LONGEST = 1_000_000  # bytes of a line


def open_locked(path: Path) -> IO[bytes]:
    """Open a file to read it and to add to it, alone. Raises OutputError when that is impossible."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b")
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror}); choose another --out") from error
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


class JsonLines:
    """A file of JSON values, one a line, that is open for more; a context. What is in it already stays.

    A last line that a killed process left half-written is removed. Raises OutputError when it cannot be written, or
    another process is at work on it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, open_locked(path)
        self._descriptor = self._file.fileno()
        self._end_last_line()

    def __enter__(self) -> JsonLines:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, line: str) -> None:
        """Add a value, as JSON without line breaks, all of it or nothing. Raises OutputError when the disk refuses."""
        add_line(self._file, line)

    def _end_last_line(self) -> None:
        """Give the last line its end; remove it if it is no JSON."""
        size = os.fstat(self._descriptor).st_size
        start = max(0, size - LONGEST)
        last = os.pread(self._descriptor, size - start, start).rpartition(b"\n")[2]
        if not last:
            return
        try:
            json.loads(last)
        except ValueError:
            os.ftruncate(self._descriptor, size - len(last))
        else:
            os.write(self._descriptor, b"\n")
