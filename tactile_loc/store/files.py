"""Files and folders that are whole or not there: written beside their place, synced, and renamed."""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tactile_loc.core.errors import OutputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, of the same suffix; when the block ends well, sync it and rename it.

    Whatever goes wrong, an older file at `path` is still whole and nothing is left beside it. Raises OSError.
    """
    temporary = path.with_name(f".tmp-{uuid.uuid4().hex}-{path.name}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def require_writable(folder: Path) -> None:
    """Check that files can be put into `folder`, which need not exist yet, and leave nothing behind.

    Raises OutputError when a file stands in its way or the nearest existing folder refuses.
    """
    existing = folder.absolute()
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"results cannot be written to {folder}: {existing} is not a folder; choose another --out")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        reason = error.strerror or "it is refused"
        raise OutputError(
            f"results cannot be written to {folder}: {reason} in {existing}; choose another --out"
        ) from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Have `write` write a temporary file of the same suffix, then rename it to `path`; make its folder if needed.

    Raises OutputError when the disk refuses; an older file at `path` is then still whole.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            write(temporary)
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another --out") from error
    return path
