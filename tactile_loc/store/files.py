"""Atomic writing of files and folders: each is written beside its final place, synced, and renamed."""

import ctypes
import glob
import hashlib
import json
import os
import re
import shutil
import sys
import tempfile
import uuid
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.core.runtime.formatting import is_unicode, show_bytes
from tactile_loc.store import locks
from tactile_loc.store.locks import is_at, lock, open_folder

_TEMPORARY = ".tmp-"
LONGEST_NAME = 200  # bytes of a name to which letters are added; file systems allow 255
_OS_ERROR = re.compile(r"\(os error (\d+)\)")


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path of the same name near `path`. If the block succeeds, sync the file and move it to `path`.

    If anything fails, an older file at `path` stays intact, and the temporary file is removed. The next replacement of
    `path` removes temporary files of killed processes. Raises OSError when writing fails.
    """
    with _make_folder_beside(path) as folder:
        temporary = folder / path.name
        yield temporary
        _sync_file(temporary)
        temporary.replace(path)


@contextmanager
def replace_folder(path: Path, fresh: bool = False) -> Iterator[Path]:
    """Yield an empty folder near `path`. If the block succeeds, sync the folder and put it in place of `path`.

    If the process is killed at any time, either the old or the new folder is complete. The next replacement removes the
    other folder. Some file systems cannot exchange two folders in one step. The killed process may then leave the old
    folder under another name: call `recover_folder` before reading. With `fresh`, only an empty folder may be at
    `path`. Raises OSError when writing fails.
    """
    path = path.resolve()  # if it is a link, the link's target is replaced
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
                delete(_name_aside(path))  # the old folder, which has been replaced


def recover_folder(path: Path) -> None:
    """Put back the old folder that a killed `replace_folder` had renamed, if there is no folder at `path`."""
    with suppress(OSError, ValueError):  # no such folder, an invalid name, or another process was faster
        path = path.resolve()
        aside = _name_aside(path)
        if not os.path.lexists(path) and aside.is_dir():
            aside.rename(path)


def remove_abandoned(folder: Path, names: str = "*") -> None:
    """Remove the temporary folders that killed processes left in a folder for files whose names match a pattern.

    A temporary folder that a process still uses is locked, and stays.
    """
    for pattern in (f"{_TEMPORARY}new-{names}", f"{_TEMPORARY}{'[0-9a-f]' * 32}-{names}"):
        for left in folder.glob(pattern):
            with suppress(OSError):
                _delete_abandoned(left)


def _delete_abandoned(folder: Path) -> None:
    """Delete a temporary folder, unless a process uses it. Raises OSError if the file system has no locks."""
    descriptor = open_folder(folder)
    try:
        abandoned = lock(descriptor, wait=False) and is_at(folder, descriptor)
    except OSError:
        os.close(descriptor)
        raise
    if abandoned:
        _delete_locked(folder, descriptor)
    else:
        os.close(descriptor)


def _delete_locked(folder: Path, descriptor: int) -> None:
    """Delete a locked folder, and release its lock afterwards, so that no process begins to use the folder.

    Windows must release it before. There, folders with locks have unique names, so no process makes such a folder anew.
    """
    if not locks.OPENS_FOLDERS:
        os.close(descriptor)
    try:
        delete(folder)
    finally:
        if locks.OPENS_FOLDERS:
            os.close(descriptor)


def is_unfinished(path: Path) -> bool:
    """Return whether a path has the name of a temporary folder of this module."""
    return path.name.startswith(_TEMPORARY)


def list_files(folder: Path, suffixes: Container[str], pattern: str = "*") -> list[Path]:
    """Return the files in a folder with one of some lower-case suffixes, ordered by `order_as_counted`.

    Hidden files, such as the files `._NAME` of macOS, are left out. Raises OSError when the folder cannot be read.
    """
    found = folder.iterdir() if pattern == "*" else folder.glob(pattern)
    usable = (path for path in found if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return sorted(filter(os.path.isfile, usable), key=order_as_counted)


def order_as_counted(path: Path) -> tuple[list[str | int], str]:
    """Return a key that sorts paths by name as people count: frame_2 before frame_10."""
    parts: list[str | int] = [*re.split(r"([0-9]+)", path.stem)]
    parts[1::2] = map(int, parts[1::2])
    return parts, path.name


def read_text(path: Path) -> str:
    r"""Return the text of a file, with `\n` as the end of each line.

    The text is in UTF-8, or in UTF-16 or UTF-32, which its first bytes show. A byte order mark is dropped. Raises
    OSError when the file cannot be read, and UnicodeDecodeError when it is not text.
    """
    data = path.read_bytes()
    return data.decode(json.detect_encoding(data)).replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path) -> Any:
    """Return the value in a JSON file.

    Raises OSError when the file cannot be read, and ValueError when it is not JSON or nested too deeply.
    """
    return parse_json(path.read_bytes())


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text. Raises ValueError when the text is not JSON or nested too deeply."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def shorten_name(name: str) -> str:
    """Return a name to which a few letters can be added: `name`, or its hash if file systems allow no longer name."""
    coded = os.fsencode(name)
    return name if len(coded) <= LONGEST_NAME else hashlib.sha256(coded).hexdigest()


@contextmanager
def link_plainly(path: Path) -> Iterator[Path]:
    """Yield a path that libraries in C++ can open: `path`, or a temporary link to it if its name is not Unicode."""
    if not is_unicode(path):
        with tempfile.TemporaryDirectory(prefix="tactile-loc-") as folder:
            link = Path(folder, f"file{path.suffix}")
            link.symlink_to(path.absolute())
            yield link
    else:
        yield path


def delete(path: Path) -> None:
    """Delete a file, or a folder with its contents. Raises OSError if that fails."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def sync_folder(folder: Path) -> None:
    """Sync a folder's list of files to the disk, if the file system supports this."""
    if not locks.OPENS_FOLDERS:
        return
    with suppress(OSError):
        descriptor = open_folder(folder)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def require_writable(folder: Path) -> None:
    """Check that files can be written to `folder`, which need not exist yet. No file is left behind.

    Raises OutputError when a file is in the way of the folder, or when the nearest existing folder is not writable.
    """
    existing = folder.absolute()
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise OutputError(f"{folder} cannot be written ({existing} is not a folder); choose another `out`")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        reason = error.strerror or "refused"
        raise OutputError(f"{folder} cannot be written ({reason} in {existing}); choose another `out`") from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Call `write` with a temporary path of the same suffix, rename the file to `path`, and return `path`.

    The folder of `path` is made if needed. Raises OutputError when writing fails. An older file at `path` then stays
    intact.
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
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another `out`") from error


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder until the block ends. Other processes that lock the folder wait.

    A process can thus write several files that belong together. The folder is made if needed. No file is put there,
    except on Windows.
    If the file system does not support locks, processes do not wait. Raises OutputError when the folder cannot be made.
    """
    with guard_output(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = open_folder(folder)
    try:
        with suppress(OSError):
            lock(descriptor, wait=True)
        yield
    finally:
        os.close(descriptor)


def write_json(path: Path, value: Any) -> Path:
    """Write a value as indented JSON, atomically, and return the path. Raises OutputError if that fails."""
    return write_text(path, json.dumps(value, indent=1) + "\n")


def write_text(path: Path, text: str) -> Path:
    """Write a text in UTF-8, atomically, and return the path. Raises OutputError if that fails.

    A lone surrogate, which stands for a byte in the name of a file, is escaped.
    """
    return write_atomically(path, lambda temporary: temporary.write_text(show_bytes(text), "utf-8"))


@contextmanager
def _make_folder_beside(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside `path`. The folder is locked until the block ends, and then removed.

    The folder usually has the same name for the same `path`. Leftovers of a killed process are therefore found without
    listing all files, which would be slow in a folder of many files. On Windows, each folder has its own name (see
    `_delete_locked`).
    """
    name = shorten_name(path.name)
    folder = path.with_name(f"{_TEMPORARY}new-{name}")
    descriptor = _claim(folder) if locks.OPENS_FOLDERS else None
    while descriptor is None:  # another process uses the folder, or was killed
        remove_abandoned(path.parent, glob.escape(name))
        if os.path.lexists(folder) or not locks.OPENS_FOLDERS:
            folder = path.with_name(f"{_TEMPORARY}{uuid.uuid4().hex}-{name}")
        descriptor = _claim(folder)
    try:
        with _raise_by_number():
            yield folder
    finally:
        with suppress(OSError):
            _delete_locked(folder, descriptor)


@contextmanager
def _raise_by_number() -> Iterator[None]:
    """Convert errors of Rust libraries that name a system error only in their text, "... (os error 28)", to OSError."""
    try:
        yield
    except Exception as error:
        named = None if isinstance(error, OSError) else _OS_ERROR.search(str(error))
        if named is None:
            raise
        raise OSError(int(named[1]), os.strerror(int(named[1]))) from error


def _claim(folder: Path) -> int | None:
    """Make a folder, lock it and return its descriptor.

    Return None if the folder exists already, or if another process has just removed it as abandoned.
    """
    try:
        folder.mkdir()
    except FileExistsError:
        return None
    try:
        descriptor = open_folder(folder)
    except FileNotFoundError:
        return None
    with suppress(OSError):  # a file system without locks
        lock(descriptor, wait=True)
    if is_at(folder, descriptor):
        return descriptor
    os.close(descriptor)
    return None


def _name_aside(path: Path) -> Path:
    return path.with_name(f"{_TEMPORARY}old-{shorten_name(path.name)}")


def _swap(new: Path, path: Path) -> None:
    """Exchange two folders: in one step if kernel and file system support this, otherwise through a third path."""
    if _exchange(new, path):
        return
    aside = _name_aside(path)
    if aside.exists():  # obsolete, because there is a folder at `path`
        delete(aside)
    path.rename(aside)
    new.rename(path)
    aside.rename(new)


def _exchange(one: Path, other: Path) -> bool:
    """Try to exchange two paths in one step, as Linux can on most file systems. Return whether that succeeded."""
    if sys.platform != "linux":
        return False
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of renameat2(2)
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    return renameat2(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0


def _sync_tree(folder: Path) -> None:
    for place, _, names in os.walk(folder, topdown=False):
        for name in names:
            _sync_file(Path(place, name))
        sync_folder(Path(place))


def _sync_file(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())
