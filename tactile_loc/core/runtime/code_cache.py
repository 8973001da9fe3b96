"""Folders for compiled code on disk. Each state of a source file and of the code compiled into it has its own folder.

numba checks only the file of a function. But a function's compiled code contains other functions and constants, which
may come from other files. A folder's name therefore contains a hash of all of these files and constants, so that
outdated code is never used. If numba cannot read an index on disk, it ends the program. Unreadable files are therefore
deleted first.
"""

from __future__ import annotations

import importlib.util
import io
import logging
import os
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

import numba

from tactile_loc.core.runtime.user_cache import find_user_cache

logger = logging.getLogger(__name__)

Folder = Path | None

_HEX = "[0-9a-f]" * 16
_PICKLES = {".nbi": 2, ".nbc": 1}  # number of pickles in numba's index files and code files

_opened: dict[tuple[Path, str], tuple[tuple[int, int], Folder]] = {}  # time and size, and folder, by source file


def open_code_folder(function: Callable[..., Any], chosen: str = "") -> Folder:
    """Return the folder for the compiled code of a function's file. Create it if necessary; delete unreadable files.

    The folder is under `chosen` (NUMBA_CACHE_DIR). If that is empty, the folder is in `__pycache__` beside the file, or
    else in the user's cache. A file has one folder per process. The folder depends on the names that are defined before
    the file's first compiled function, so put imports first. The folders for other states of the file are deleted,
    except the one used last. Returns None if the function is not in a file, or if no folder is writable.
    """
    path = Path(function.__code__.co_filename).absolute()
    if not path.is_file():
        return None
    stat = path.stat()
    stamp = stat.st_mtime_ns, stat.st_size
    known, folder = _opened.get((path, chosen), (None, None))
    if known != stamp:
        folder = _open(path, chosen, *_find_sources(function))
        _opened[path, chosen] = stamp, folder
    return folder


def _open(path: Path, chosen: str, files: set[Path], constants: set[str]) -> Folder:
    try:
        sources = [f"{file.name} {sha256(file.read_bytes()).hexdigest()}" for file in sorted(files)]
    except OSError:  # a called function is not in a file
        return None
    key = sha256("\n".join([numba.__version__, *sources, *sorted(constants)]).encode()).hexdigest()[:16]
    for root in _list_roots(path.parent, chosen):
        folder = root / f"{path.stem}.{key}"
        known = folder.is_dir()
        if _can_write(folder):
            if known:
                _delete_unreadable(folder, files)
            else:
                _delete_older(root, path.stem, folder)
            return folder
    logger.warning("code compiled from %s cannot be saved; set NUMBA_CACHE_DIR to a folder that can be written", path)
    return None


def _list_roots(source: Path, chosen: str) -> Iterator[Path]:
    """Yield the folders that may hold the code compiled from files of the folder `source`, the best one first."""
    name = f"{source.name}_{sha256(str(source).encode()).hexdigest()[:16]}"
    if chosen:
        yield Path(chosen).absolute() / name
        return
    yield source / "__pycache__" / "compiled"
    with suppress(RuntimeError):  # the user has no home
        yield find_user_cache() / "tactile-loc-compiled" / name


def _can_write(folder: Path) -> bool:
    """Create a folder and mark it as used now. Return whether files can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _delete_older(root: Path, stem: str, folder: Path) -> None:
    """Delete the folders for other states of a file, except the one used last, which another process may use."""
    with suppress(OSError):  # another process may delete them at the same time
        others = sorted((one.stat().st_mtime_ns, one) for one in root.glob(f"{stem}.{_HEX}") if one != folder)
        for _, other in others[:-1]:
            shutil.rmtree(other, ignore_errors=True)


def _find_sources(function: Callable[..., Any]) -> tuple[set[Path], set[str]]:
    """Return the files and the constants ("NAME=value") that may be compiled into the code of a function's file.

    These are the function's own file, the files of all compiled functions that it uses, directly or indirectly, and the
    files of their named tuples. Constants are numbers and tuples of numbers with a name in capitals.
    """
    compiled = type(numba.njit(function))
    files, constants, seen = {Path(function.__code__.co_filename).absolute()}, set(), set()
    waiting = [(function.__globals__, _read_cells(function))]
    while waiting:
        names, cells = waiting.pop()
        values = [*names.values(), *cells]
        values += [value for one in values if isinstance(one, ModuleType) for value in vars(one).values()]
        for value in values:
            if isinstance(value, compiled) and id(value) not in seen:
                seen.add(id(value))
                files.add(Path(value.py_func.__code__.co_filename).absolute())
                waiting.append((value.py_func.__globals__, _read_cells(value.py_func)))
        for name, value in list(names.items()):
            if isinstance(value, type) and hasattr(value, "_fields"):
                file = getattr(sys.modules.get(value.__module__), "__file__", None)
                files |= {Path(file).absolute()} if file else set()
            elif name.isupper() and _is_number(value):
                constants.add(f"{name}={value!r}")
    return files, constants


def _read_cells(function: Callable[..., Any]) -> list[Any]:
    """Return the values that a function uses from its enclosing functions."""
    cells = []
    for cell in function.__closure__ or ():
        with suppress(ValueError):  # the value is not set yet
            cells.append(cell.cell_contents)
    return cells


def _is_number(value: object) -> bool:
    return all(map(_is_number, value)) if isinstance(value, tuple) else isinstance(value, bool | int | float)


def _delete_unreadable(folder: Path, files: set[Path]) -> None:
    """Delete damaged files, and indices of code that is missing or may have changed.

    `files` cannot have changed, because their hash is part of the folder's name.
    """
    for path in folder.rglob("*.nb[ic]"):
        try:
            names = _read_names(path)
            fresh = path.suffix != ".nbi" or all(_is_older(*name, path.stat().st_mtime_ns, files) for name in names)
        except Exception:  # noqa: BLE001 - unpickling a damaged file, or importing a package, may raise anything
            fresh = False
        if not fresh:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def _read_names(path: Path) -> set[tuple[str, str]]:
    """Return the modules and names in a numba file. The whole file is read, but nothing is imported or called."""
    stream, names = io.BytesIO(path.read_bytes()), set()
    for _ in range(_PICKLES[path.suffix]):
        reader = _NameReader(stream)
        reader.load()
        names |= reader.names
    return names


def _is_older(module: str, name: str, time_ns: int, files: set[Path]) -> bool:
    """Return whether a module still has a name, and the module's file is in `files` or older than `time_ns`."""
    if module in sys.builtin_module_names:
        return True
    loaded = sys.modules.get(module)
    origin = getattr(loaded, "__file__", None) or getattr(importlib.util.find_spec(module), "origin", None)
    if origin is None:
        return False
    first, path = name.partition(".")[0], Path(origin).absolute()
    if not hasattr(loaded, first) and first.encode() not in path.read_bytes():  # the module's import may be incomplete
        return False
    return path in files or path.stat().st_mtime_ns <= time_ns


class _NameReader(pickle.Unpickler):
    """A reader of pickles that imports and calls nothing."""

    def __init__(self, stream: io.BytesIO) -> None:
        super().__init__(stream)
        self.names: set[tuple[str, str]] = set()

    def find_class(self, module: str, name: str) -> type[_Anything]:
        """Add a name to `names`, and return a substitute for its class, function or object."""
        self.names.add((module, name))
        return _Anything


class _Anything:
    """A substitute for any class, function or object of a pickle."""

    def __new__(cls, *_: object, **__: object) -> _Anything:
        return object.__new__(cls)

    def __init__(self, *_: object, **__: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...

    def __setitem__(self, key: object, value: object) -> None: ...

    def append(self, value: object) -> None:
        """Accept an item of a list."""

    def extend(self, values: object) -> None:
        """Accept items of a list."""
