"""Files and folders that are whole or not there: written beside their place, synced, and renamed."""

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
    """Give a temporary path near `path`, of the same name; when the block ends well, sync it and rename it.

    Whatever goes wrong, an older file at `path` is still whole and nothing is left beside it; what a process that was
    killed has left there is removed by the next replacement. Raises OSError.
    """
    with _make_folder_beside(path) as folder:
        temporary = folder / path.name
        yield temporary
        _sync_file(temporary)
        temporary.replace(path)


@contextmanager
def replace_folder(path: Path, fresh: bool = False) -> Iterator[Path]:
    """Give an empty folder near `path`; when the block ends well, sync all it holds and put it in `path`'s place.

    A process that is killed at any moment leaves the old folder whole or the new one, and what it leaves beside them is
    removed by the next replacement; whatever else goes wrong, nothing is left. Where the file system cannot exchange
    two folders at once, the old one may be left set aside: `recover_folder` before reading puts it back. With `fresh`
    nothing may stand at `path` but an empty folder. Raises OSError.
    """
    path = path.resolve()  # where `path` is a link, what it points to is replaced
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
                delete(_name_aside(path))  # what was set aside for what stands there now


def recover_folder(path: Path) -> None:
    """Put back the folder that a killed `replace_folder` had set aside, if nothing stands in its place."""
    with suppress(OSError, ValueError):  # there is none, none can be called so, or another process was faster
        path = path.resolve()
        aside = _name_aside(path)
        if not os.path.lexists(path) and aside.is_dir():
            aside.rename(path)


def remove_abandoned(folder: Path, names: str = "*") -> None:
    """Remove from a folder what killed processes were writing there, or had just written, of the names of a pattern.

    Nobody holds the locks of that any more; what others are at work on stays.
    """
    for pattern in (f"{_TEMPORARY}new-{names}", f"{_TEMPORARY}{'[0-9a-f]' * 32}-{names}"):
        for left in folder.glob(pattern):
            with suppress(OSError), _open_folder(left) as descriptor:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused: another holds it, or there are none
                if _is_at(left, descriptor):
                    delete(left)  # while it is locked: nobody can begin to use it


def is_unfinished(path: Path) -> bool:
    """Whether by its name something is being written beside its place, or was when a process was killed."""
    return path.name.startswith(_TEMPORARY)


def read_json(path: Path) -> Any:
    """Return what a JSON file holds. Raises OSError, and ValueError when it holds none, or is nested without end."""
    return parse_json(path.read_bytes())


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text. Raises ValueError when it is none, or is nested without end."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def delete(path: Path) -> None:
    """Delete a file or a folder with all it holds. Raises OSError."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def sync_folder(folder: Path) -> None:
    """Have a folder's entries written to the disk, where the file system knows how to."""
    with suppress(OSError), _open_folder(folder) as descriptor:
        os.fsync(descriptor)


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
    with guard_output(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as temporary:
            write(temporary)
    return path


@contextmanager
def guard_output(path: Path) -> Iterator[None]:
    """Turn an OSError of the block, in which `path` is written, into an OutputError that says so."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another --out") from error


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Have others who ask for the same folder wait until the block ends: files that belong together stay together.

    The folder is made if needed, and nothing is put there. Where the file system has no locks, nobody waits. Raises
    OutputError when there can be no such folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise OutputError(f"{folder} cannot be written to ({error.strerror or error}); choose another --out") from error
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write_json(path: Path, value: Any) -> Path:
    """Write JSON values for people to read too, atomically, and return the path. Raises OutputError."""
    text = json.dumps(value, indent=1) + "\n"
    return write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


@contextmanager
def _make_folder_beside(path: Path) -> Iterator[Path]:
    """Give an empty folder beside `path`, locked as long as the block lasts; at its end what is left of it is removed.

    The folder's name is always the same: so what a killed process left is found again without listing all that there
    is, which would take long where many files are written into one folder.
    """
    folder = path.with_name(f"{_TEMPORARY}new-{path.name}")
    descriptor = _claim(folder)
    while descriptor is None:  # it is there already: another process is at work on it, or was
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
    """Raise as an OSError what libraries in Rust say of the system in words only, as "... (os error 28)"."""
    try:
        yield
    except Exception as error:
        said = None if isinstance(error, OSError) else _OS_ERROR.search(str(error))
        if said is None:
            raise
        raise OSError(int(said[1]), os.strerror(int(said[1]))) from error


def _claim(folder: Path) -> int | None:
    """Make a folder and lock it; None if it is there already, or somebody who took it for abandoned was faster."""
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
    """Whether an open folder has not been removed, another of its name perhaps made since."""
    try:
        return os.path.samestat(folder.stat(), os.fstat(descriptor))
    except OSError:
        return False


def _name_aside(path: Path) -> Path:
    return path.with_name(f"{_TEMPORARY}old-{path.name}")


def _swap(new: Path, path: Path) -> None:
    """Exchange two folders: at once where the kernel and the file system can, else by way of a third place."""
    if _exchange(new, path):
        return
    aside = _name_aside(path)
    if aside.exists():  # a leftover, as there is a folder at `path`
        delete(aside)
    path.rename(aside)
    new.rename(path)
    aside.rename(new)


def _exchange(one: Path, other: Path) -> bool:
    """Let two paths change places in one step, as Linux can on most file systems, and tell whether that was done."""
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
