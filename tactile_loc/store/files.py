"""Atomic writing of files and folders: they are written beside their final place, synced, and renamed."""

from __future__ import annotations

import ctypes
import fcntl
import glob
import json
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import OutputError

_TEMPORARY = ".tmp-"
_OS_ERROR = re.compile(r"\(os error (\d+)\)")


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path of the same name near `path`; sync it and rename it if the block succeeds.

    If anything fails, an older file at `path` stays intact and nothing is left beside it. Files left by a killed
    process are removed by the next replacement. Raises OSError.
    """
    with _make_folder_beside(path) as folder:
        temporary = folder / path.name
        yield temporary
        _sync_file(temporary)
        temporary.replace(path)


@contextmanager
def replace_folder(path: Path, fresh: bool = False) -> Iterator[Path]:
    """Yield an empty folder near `path`; sync it and put it in place of `path` if the block succeeds.

    If the process is killed at any time, either the old or the new folder is complete, and the next replacement removes
    the rest. If the file system cannot exchange two folders in one step, the old one may be left aside:
    `recover_folder`, called before reading, puts it back. With `fresh`, only an empty folder may be at `path`. Raises
    OSError.
    """
    path = path.resolve()  # of a link, its target is replaced
    recover_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with _make_folder_beside(path) as folder:
            temporary = folder / path.name
            temporary.mkdir()
            yield temporary
            _sync_tree(temporary)
            if fresh or not os.path.lexists(path):
                temporary.rename(path)
            else:
                _swap(temporary, path)
            sync_folder(path.parent)
    finally:
        recover_folder(path)
        if os.path.lexists(path):
            with suppress(OSError):
                delete(_name_aside(path))  # the old folder, now replaced


def recover_folder(path: Path) -> None:
    """Put back the folder that a killed `replace_folder` had set aside, if its place is empty."""
    with suppress(OSError, ValueError):  # there is none, its name is invalid, or another process was faster
        path = path.resolve()
        aside = _name_aside(path)
        if not os.path.lexists(path) and aside.is_dir():
            aside.rename(path)


def remove_abandoned(folder: Path, names: str = "*") -> None:
    """Remove temporary folders of killed processes from a folder, for files whose names match a pattern.

    Their locks are free; folders that are still in use stay.
    """
    for pattern in (f"{_TEMPORARY}new-{names}", f"{_TEMPORARY}{'[0-9a-f]' * 32}-{names}"):
        for left in folder.glob(pattern):
            with suppress(OSError), _open_folder(left) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails if in use, or without locks
                if _is_at(left, descriptor):
                    delete(left)  # while it is locked, so that no process begins to use it


def is_unfinished(path: Path) -> bool:
    """Return whether a name is that of a temporary folder of this module."""
    return path.name.startswith(_TEMPORARY)


def read_json(path: Path) -> Any:
    """Return the value in a JSON file. Raises OSError, and ValueError if it is not JSON or nested too deeply."""
    return parse_json(path.read_bytes())


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text. Raises ValueError if it is not JSON or nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def delete(path: Path) -> None:
    """Delete a file, or a folder with its contents. Raises OSError."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def sync_folder(folder: Path) -> None:
    """Write a folder's entries to the disk, if the file system can."""
    with suppress(OSError), _open_folder(folder) as descriptor:
        os.fsync(descriptor)


def require_writable(folder: Path) -> None:
    """Check that files can be written to `folder`, which need not exist yet, without leaving any.

    Raises OutputError if a file is in its way or the nearest existing folder is not writable.
    """
    existing = folder.absolute()
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"{folder} cannot be written ({existing} is not a folder); choose another --out")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        reason = error.strerror or "refused"
        raise OutputError(f"{folder} cannot be written ({reason} in {existing}); choose another --out") from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Call `write` with a temporary path of the same suffix, rename the file to `path`, and return `path`.

    Its folder is made if needed. Raises OutputError if writing fails; an older file at `path` then stays intact.
    """
    with guard_output(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as temporary:
            write(temporary)
    return path


@contextmanager
def guard_output(path: Path) -> Iterator[None]:
    """Convert an OSError of the block, which writes `path`, to an OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another --out") from error


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder, so that other processes wait until the block ends, and files that belong together are written
    together.

    The folder is made if needed, and no file is put there. Without locks in the file system, processes do not wait.
    Raises OutputError if the folder cannot be made.
    """
    with guard_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write_json(path: Path, value: Any) -> Path:
    """Write a value as indented JSON, atomically, and return the path. Raises OutputError."""
    text = json.dumps(value, indent=1) + "\n"
    return write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


@contextmanager
def _make_folder_beside(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside `path`, locked until the block ends, and then removed.

    The folder's name is always the same, so the rest of a killed process is found without listing all files. Listing
    would be slow in a folder of many files.
    """
    folder = path.with_name(f"{_TEMPORARY}new-{path.name}")
    descriptor = _claim(folder)
    while descriptor is None:  # another process uses it, or was killed
        remove_abandoned(path.parent, glob.escape(path.name))
        folder = path.with_name(f"{_TEMPORARY}{uuid.uuid4().hex}-{path.name}") if os.path.lexists(folder) else folder
        descriptor = _claim(folder)
    try:
        with _raise_by_number():
            yield folder
    finally:
        with suppress(OSError):
            delete(folder)
        os.close(descriptor)


@contextmanager
def _raise_by_number() -> Iterator[None]:
    """Raise OSError for errors of Rust libraries that name a system error only in words: "... (os error 28)"."""
    try:
        yield
    except Exception as error:
        named = None if isinstance(error, OSError) else _OS_ERROR.search(str(error))
        if named is None:
            raise
        raise OSError(int(named[1]), os.strerror(int(named[1]))) from error


def _claim(folder: Path) -> int | None:
    """Make a folder and lock it; None if it exists, or another process has just removed it as abandoned."""
    try:
        folder.mkdir()
    except FileExistsError:
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:
        return None
    with suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    if _is_at(folder, descriptor):
        return descriptor
    os.close(descriptor)
    return None


def _is_at(folder: Path, descriptor: int) -> bool:
    """Return whether a path still leads to an open folder."""
    try:
        return os.path.samestat(folder.stat(), os.fstat(descriptor))
    except OSError:
        return False


def _name_aside(path: Path) -> Path:
    return path.with_name(f"{_TEMPORARY}old-{path.name}")


def _swap(new: Path, path: Path) -> None:
    """Exchange two folders: in one step if the kernel and the file system can, otherwise through a third path."""
    if _exchange(new, path):
        return
    aside = _name_aside(path)
    if aside.exists():  # obsolete, because there is a folder at `path`
        delete(aside)
    path.rename(aside)
    new.rename(path)
    aside.rename(new)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two paths in one step, as Linux can on most file systems, and return whether that succeeded."""
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of renameat2(2)
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    return renameat2(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0


@contextmanager
def _open_folder(folder: Path) -> Iterator[int]:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _sync_tree(folder: Path) -> None:
    for place, _, names in os.walk(folder, topdown=False):
        for name in names:
            _sync_file(Path(place, name))
        sync_folder(Path(place))


def _sync_file(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())
