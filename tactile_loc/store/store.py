"""The stage store: the result of a stage is in a folder that is named by the hash of the stage's inputs.

`<root>/<stage>/<16 hex digits>/` holds a finished artifact. `<16 hex digits>.partial/` holds the pieces of an
unfinished artifact. `<16 hex digits>.lock` prevents two processes from building the same artifact.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_loc.core.runtime.caches import find_user_cache
from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.core.runtime.formatting import format_bytes
from tactile_loc.store.artifact import MANIFEST, Artifact, DamagedError, Signature, read_artifact
from tactile_loc.store.files import delete, sync_folder
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace, guard_store

if TYPE_CHECKING:
    from filelock import FileLock

logger = logging.getLogger(__name__)

_ENTRY = re.compile(r"([0-9a-f]{16})(\.partial)?")
_SETTLED_NS = 2_000_000_000  # the coarsest clock of common file systems ticks every 2 s


@dataclass(frozen=True)
class Entry:
    """One folder of the store. If not `complete`, it holds the pieces of an unfinished build."""

    stage: str
    digest: str
    """The first 16 digits of the key's digest."""
    nbytes: int
    created: datetime
    """Time of the end of the build or, if incomplete, of its last saved piece, UTC."""
    complete: bool
    path: Path


class StageStore:
    """Results of stages on disk. A result is found by its `StageKey`, and built again only if an input changes.

    The folder is created at the first build. `built` lists the keys that this instance built, in order.
    """

    def __init__(self, root: Path | str | None = None) -> None:
        self.root = find_root() if root is None else Path(root).expanduser().absolute()
        self.built: list[StageKey] = []
        self._verified: dict[str, Signature] = {}  # of artifacts whose checksums were right, by the keys' digests

    def get(self, key: StageKey) -> Artifact | None:
        """Return the artifact of this key, or None if there is none.

        An incomplete or altered artifact is removed, with a warning. Checksums are verified once per instance, and
        again when a file's time or size has changed. Raises StoreError if a damaged artifact cannot be removed.
        """
        try:
            return self._open(key)
        except DamagedError:
            lock = self._try_lock(self._find_folder(key))
        if lock is None:
            return None  # another process is rebuilding it
        with lock:
            return self._open_or_remove(key)

    def build(self, key: StageKey, make: Callable[[Workspace], object]) -> Artifact:
        """Return the artifact of this key. If there is none, call `make` to build it in a workspace.

        If another process is building the artifact, wait for that process. After an interruption or an exception, the
        pieces that `make` saved stay in the workspace for the next build. Raises StoreError if the artifact cannot be
        stored, for instance on a full disk. Errors of `make` are raised unchanged.
        """
        artifact = self.get(key)
        if artifact is None:
            with self._lock(key):
                artifact = self._open_or_remove(key) or self._make(key, make)
        else:
            logger.debug("stage %s is in the store already", key)
        return artifact

    def entries(self) -> list[Entry]:
        """Return the folders of the store, finished or not, ordered by stage and digest. No checksum is verified."""
        folders = [path for path in sorted(self.root.glob("*/*")) if _ENTRY.fullmatch(path.name) and path.is_dir()]
        return [_read_entry(folder) for folder in folders]

    def remove(self, digest: str) -> int:
        """Remove the folders of this digest (all or the first 16 digits), and return their total size, bytes.

        Raises StoreError if a process is building the artifact, or if a folder cannot be removed.
        """
        found = [entry for entry in self.entries() if entry.digest == digest[:16]]
        for entry in found:
            lock = self._try_lock(entry.path.with_suffix(""))
            if lock is None:
                raise StoreError(f"{entry.path} is being built by another process; try again when it has ended")
            with lock:
                _remove(entry.path)
        return sum(entry.nbytes for entry in found)

    def is_being_built(self, entry: Entry) -> bool:
        """Return whether a process is building or removing this entry now. Raises StoreError if the lock fails."""
        lock = self._try_lock(entry.path.with_suffix(""))
        if lock is None:
            return True
        with lock:
            return False

    def _find_folder(self, key: StageKey) -> Path:
        return self.root / key.stage / key.short

    def _open(self, key: StageKey) -> Artifact | None:
        """Return the verified artifact, or None if there is none. Raises DamagedError if the artifact is damaged."""
        folder = self._find_folder(key)
        if not os.path.lexists(folder):
            return None
        artifact = read_artifact(folder)
        if artifact.key != key:
            raise DamagedError("it was made from other inputs")
        signature = artifact.read_signature()
        if self._verified.get(key.digest) != signature:
            artifact.verify()
            # A second write within one tick of the clock would leave the time unchanged, so only older times count.
            if time.time_ns() - max(mtime_ns for mtime_ns, _ in signature) > _SETTLED_NS:
                self._verified[key.digest] = signature
        return artifact

    def _open_or_remove(self, key: StageKey) -> Artifact | None:
        """Do the same as `_open`, but remove a damaged artifact. The caller holds the lock."""
        try:
            return self._open(key)
        except DamagedError as damage:
            logger.warning("the stage %s in %s is damaged and is removed: %s", key, self._find_folder(key), damage)
        _remove(self._find_folder(key))
        return None

    def _make(self, key: StageKey, make: Callable[[Workspace], object]) -> Artifact:
        folder = self._find_folder(key)
        partial = folder.with_suffix(".partial")
        logger.info("stage %s is being built", key.explain())
        start_s = time.monotonic()
        with guard_store(f"stage {key}", partial):
            partial.mkdir(exist_ok=True)
        workspace = Workspace(partial, key)
        if not workspace.is_finished():
            make(workspace)
            workspace.finish()
        workspace.tidy()
        with guard_store(f"stage {key}", folder):
            os.rename(partial, folder)
            self.built.append(key)
            sync_folder(folder.parent)
        artifact = read_artifact(folder)
        size, seconds = format_bytes(artifact.nbytes), time.monotonic() - start_s
        logger.info("stage %s is built: %s in %.1f s", key.explain(), size, seconds)
        return artifact

    def _lock(self, key: StageKey) -> AbstractContextManager[object]:
        """Acquire the lock of a key and return it, as a context manager that releases it. Wait if it is taken."""
        lock = self._try_lock(self._find_folder(key))
        if lock is None:
            logger.info("stage %s is being built by another process; waiting for it", key)
            with guard_store(f"stage {key}", self.root):
                lock = _make_lock(self._find_folder(key)).acquire()
        return lock

    def _try_lock(self, folder: Path) -> AbstractContextManager[object] | None:
        """Acquire the lock of an artifact's folder and return it, as a context manager, or None if it is taken."""
        from filelock import Timeout

        with guard_store(f"stage {folder.parent.name} {folder.name}", folder.parent):
            folder.parent.mkdir(parents=True, exist_ok=True)
            try:
                return _make_lock(folder).acquire(timeout=0)
            except Timeout:
                return None


def find_root() -> Path:
    """Return the store's folder: `$TACTILE_LOC_STORE`, or else `tactile-loc` in the user's cache.

    The user's cache is `$XDG_CACHE_HOME`, or else `~/.cache`.
    """
    if chosen := os.environ.get("TACTILE_LOC_STORE"):
        return Path(chosen).expanduser().absolute()
    return find_user_cache() / "tactile-loc"


def _make_lock(folder: Path) -> FileLock:
    """Make the lock of an artifact's folder. The lock is not acquired.

    The operating system releases the locks of a process that ends. The lock's file is never deleted, because two
    processes could then hold the lock at the same time.
    """
    from filelock import FileLock

    return FileLock(folder.with_suffix(".lock"))


def _remove(path: Path) -> None:
    try:
        delete(path)
    except FileNotFoundError:
        return  # another process was faster
    except OSError as error:
        raise StoreError(f"{path} cannot be removed ({error.strerror}); delete it or choose another `store`") from error


def _read_entry(folder: Path) -> Entry:
    digest, _, suffix = folder.name.partition(".")
    manifest = folder / MANIFEST
    complete = not suffix and manifest.is_file()
    created = datetime.fromtimestamp((manifest if complete else folder).stat().st_mtime, UTC)
    return Entry(folder.parent.name, digest, _measure_size(folder), created, complete, folder)


def _measure_size(folder: Path) -> int:
    """Return the total size, bytes, of the files in a folder and its subfolders. Files that vanish do not count."""
    nbytes = 0
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            nbytes += path.lstat().st_size if path.is_file() else 0
    return nbytes
