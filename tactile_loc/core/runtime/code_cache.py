"""The cache of compiled code on disk. It is valid for one state of all kernel modules.

numba checks only the file of a function. But a function's compiled code contains other functions and constants, which
may come from other files. So one hash over all kernel modules is part of the cache's folder. A kernel module is a file
with a line `@njit`. It takes compiled functions and constants from kernel modules of its own package or of tactile_loc.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core import config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from tactile_loc.core.runtime.caches import find_user_cache
from tactile_loc.core.runtime.lazy import pause_collection

logger = logging.getLogger(__name__)

HOUSE = Path(__file__).parents[2]
_KERNEL = re.compile(rb"^@njit\b", re.MULTILINE)


def keep_code(dispatcher: Any) -> Any:
    """Return a function compiled by numba that keeps its code on disk and reuses it.

    The folder is under NUMBA_CACHE_DIR. If that is not set, the folder is in `__pycache__` beside the function's file,
    or else in the user's cache. If the function is not in a file, or if no folder is writable, the code is not kept.
    """
    if _Locator.from_function(dispatcher.py_func, "") is not None:
        dispatcher._cache = _CodeCache(dispatcher.py_func)
    return dispatcher


def hash_kernels(path: Path) -> str:
    """Return a hash of numba's version and of all kernel modules of tactile_loc and of the package of a file.

    A file outside a package counts alone.
    """
    package = path
    while (package.parent / "__init__.py").exists():
        package = package.parent
    found = sha256("\n".join([numba.__version__, _hash_folder(HOUSE), _hash_folder(package)]).encode())
    return found.hexdigest()[:16]


@cache
def _hash_folder(root: Path) -> str:
    return sha256("\n".join(sha256(path.read_bytes()).hexdigest() for path in list_kernels(root)).encode()).hexdigest()


def list_kernels(root: Path) -> list[Path]:
    """Return the kernel modules in a folder and its subfolders, or the one file `root`, sorted."""
    files = sorted(root.rglob("*.py")) if root.is_dir() else [root]
    return [path for path in files if _KERNEL.search(path.read_bytes())]


@cache
def find_code_folder(source: Path, digest: str, chosen: str) -> Path | None:
    """Return the folder for the code compiled from files of the folder `source`, or None. Create it if necessary.

    Folders of other digests are deleted, except the one used last, which another process may use.
    """
    for root in _list_roots(source, chosen):
        folder = root / digest
        known = folder.is_dir()
        if _can_write(folder):
            if not known:
                _delete_older(root, folder)
            return folder
    logger.warning("code compiled from %s cannot be saved; set NUMBA_CACHE_DIR to a folder that can be written", source)
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


def _delete_older(root: Path, folder: Path) -> None:
    with suppress(OSError):  # another process may delete them at the same time
        others = sorted((one.stat().st_mtime_ns, one) for one in root.iterdir() if one != folder)
        for _, other in others[:-1]:
            shutil.rmtree(other, ignore_errors=True)


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Tells numba the folder and the digest of a function's code."""

    def __init__(self, folder: Path, digest: str, line: int) -> None:
        self._folder, self._digest, self._line = folder, digest, line

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the digest. numba ignores code with another one."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return the function's line, for functions of one name in one file."""
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator | None:
        """Return the locator of a function, or None if the function is not in a file or no folder is writable."""
        path = Path(py_func.__code__.co_filename).absolute()
        if not path.is_file():
            return None
        digest = hash_kernels(path)
        folder = find_code_folder(path.parent, digest, config.CACHE_DIR)  # type: ignore[attr-defined]
        return None if folder is None else cls(folder, digest, py_func.__code__.co_firstlineno)


class _Storage(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _CodeCache(FunctionCache):  # type: ignore[misc]
    """numba's cache, which compiles again if a file is damaged, and continues if a file cannot be written."""

    _impl_class = _Storage

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Return the key of compiled code, which depends on the fields of named tuples, too."""
        return *super()._index_key(sig, codegen), tuple(map(_list_fields, sig))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature, or None."""
        try:
            with pause_collection():
                return super().load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 - unpickling a damaged file may raise anything
            logger.debug("The compiled code of %s is damaged.", self._name)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            logger.warning("the compiled code of %s cannot be saved: %s", self._name, error)


def _list_fields(kind: Any) -> tuple[Any, ...]:
    """Return the names of a named tuple's fields, and those of the named tuples in it. Other types have none."""
    if not isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        return ()
    return *getattr(kind, "fields", ()), *map(_list_fields, kind)
