"""Where a stage is being built: a folder whose finished pieces outlive an interruption."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import StoreError
from tactile_loc.core.slots.encoder import Checkpoints
from tactile_loc.store.artifact import (
    MANIFEST,
    DamagedError,
    FileRecord,
    read_artifact,
    read_packed,
    write_manifest,
    write_packed,
)
from tactile_loc.store.files import delete, read_json, replace_file, sync_folder
from tactile_loc.store.keys import StageKey, hash_file

logger = logging.getLogger(__name__)

_CHECKPOINT = "checkpoint.safetensors"
_PIECES = ".pieces.json"
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, None)  # numpy reports a short write without a number


class Workspace:
    """The folder in which one artifact is being built; `StageStore.build` hands it to the function that builds.

    Every piece is written atomically (temporary file, fsync, rename) and recorded with its checksum. What was saved in
    this build, or loaded from an earlier one that was interrupted, makes up the artifact, unless it was saved with
    `keep=False`; any other file in the folder is deleted when the build ends. One thread at a time.
    """

    def __init__(self, path: Path, key: StageKey) -> None:
        self.path = path
        self._key = key
        self._kept: set[str] = set()
        self._pieces = self._read_pieces()  # file name -> checksums that are accepted, the newest first

    def load_or_make(self, name: str, make: Callable[[], NDArray[Any]], keep: bool = True) -> NDArray[Any]:
        """Return the array that an earlier, interrupted build saved under this name, else make and save it.

        `keep=False` is for intermediate results: they serve the resumption only and are not part of the artifact.

        Raises:
            StoreError: as `save_array`. What `make` raises passes through.
        """
        array = self.load(name, keep)
        if array is None:
            array = np.asarray(make())
            self.save_array(name, array, keep)
        return array

    def load(self, name: str, keep: bool = True) -> NDArray[Any] | None:
        """Return the array saved under this name, now or by an interrupted build; None if absent or damaged."""
        for read, file_name in ((np.load, f"{name}.npy"), (read_packed, f"{name}.npz")):
            path = self.load_file(file_name, keep)
            if path is not None:
                array: NDArray[Any] = read(path)
                return array
        return None

    def load_file(self, file_name: str, keep: bool = True) -> Path | None:
        """Return where the file saved under this name is, now or by an interrupted build; None if absent or damaged."""
        if file_name not in self._pieces:
            return None
        path = self.path / file_name
        if not path.is_file() or hash_file(path) not in self._pieces[file_name]:
            logger.warning("The saved piece %s of stage %s is missing or damaged and not used.", file_name, self._key)
            return None
        self._mark(file_name, keep)
        logger.info("Stage %s: the piece %s is there already.", self._key, file_name)
        return path

    def save_array(self, name: str, array: NDArray[Any], keep: bool = True, packed: bool = False) -> None:
        """Save an array of any shape as `<name>.npy`, or `packed`, deflated, as `<name>.npz`, replacing an earlier one.

        A packed array takes time to read and is never mapped; contact shapes, mostly empty, take a tenth of the space.

        Raises:
            StoreError: if it holds Python objects, the name cannot be used, or the disk refuses it.
        """
        if array.dtype.hasobject:
            raise StoreError(f"Array {name!r} of stage {self._key} holds Python objects; convert it to numbers.")
        if packed:
            self.save_file(f"{name}.npz", lambda path: write_packed(path, array), keep)
        else:
            self.save_file(f"{name}.npy", lambda path: np.save(path, array, allow_pickle=False), keep)

    def save_json(self, name: str, value: Any, keep: bool = True) -> None:
        """Save a value as `<name>.json`, keys sorted.

        Raises:
            StoreError: if it is not a finite JSON value, the name cannot be used, or the disk refuses it.
        """
        try:
            text = json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n"
        except (TypeError, ValueError) as error:
            raise StoreError(f"{name!r} of stage {self._key} is not a finite JSON value: {error}.") from error
        self.save_file(f"{name}.json", lambda path: path.write_text(text), keep)

    def save_file(self, file_name: str, write: Callable[[Path], object], keep: bool = True) -> None:
        """Save a file of any plain format: `write(path)` writes it at a temporary path of the same suffix.

        Raises:
            StoreError: if the name cannot be used or the disk refuses it.
        """
        if not _FILE_NAME.fullmatch(file_name) or file_name == MANIFEST:
            raise StoreError(f"{file_name!r} cannot name a file of stage {self._key}; use letters, digits, . - and _.")
        with (
            guard_store(f"{file_name} of stage {self._key}", self.path),
            replace_file(self.path / file_name) as temporary,
        ):
            write(temporary)
            # Recorded before the rename, beside the checksum it replaces: a kill between the two loses neither.
            self._pieces[file_name] = [hash_file(temporary), *self._pieces.get(file_name, [])[:1]]
            with replace_file(self.path / _PIECES) as pieces:
                pieces.write_text(json.dumps(self._pieces))
        self._mark(file_name, keep)

    def finish(self) -> None:
        """Write the artifact's manifest. Called by the store when `make` returns."""
        with guard_store(f"the manifest of stage {self._key}", self.path):
            paths = {name: self.path / name for name in self._kept}
            files = {name: FileRecord(path.stat().st_size, hash_file(path)) for name, path in paths.items()}
            with replace_file(self.path / MANIFEST) as temporary:
                write_manifest(temporary, self._key, files)

    def is_finished(self) -> bool:
        """Tell whether the artifact is whole, now or by an earlier build that was interrupted just before its end."""
        try:
            artifact = read_artifact(self.path)
            artifact.verify()
        except DamagedError:
            return False
        return artifact.key == self._key

    def tidy(self) -> None:
        """Delete what is not part of the finished artifact: before, the disk could still have refused its manifest."""
        with guard_store(f"the manifest of stage {self._key}", self.path):
            for path in set(self.path.iterdir()) - {self.path / name for name in read_artifact(self.path).files}:
                if path.name != MANIFEST:
                    delete(path)
            sync_folder(self.path)

    def _mark(self, file_name: str, keep: bool) -> None:
        (self._kept.add if keep else self._kept.discard)(file_name)

    def _read_pieces(self) -> dict[str, list[str]]:
        try:
            pieces = read_json(self.path / _PIECES)
        except (OSError, ValueError):
            return {}
        return pieces if isinstance(pieces, dict) else {}


class WorkspaceCheckpoints(Checkpoints):
    """Keeps a training's state in the folder where its stage is being built, until the stage is finished."""

    def __init__(self, work: Workspace) -> None:
        self._work = work

    def load(self) -> Path | None:
        """Return the checkpoint that an interrupted build left, if it is intact."""
        return self._work.load_file(_CHECKPOINT, keep=False)

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the checkpoint atomically."""
        self._work.save_file(_CHECKPOINT, write, keep=False)


@contextmanager
def guard_store(what: str, folder: Path) -> Iterator[None]:
    """Turn an OSError of the block into a StoreError that says what could not be stored, where, why and what to do."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else "the write stopped short, as on a full disk"
        if error.errno in (errno.EEXIST, errno.ENOTDIR):
            reason = "a file stands where a folder is needed"
        advice = "free some space there or choose" if error.errno in _FULL else "choose"
        raise StoreError(
            f"Cannot store {what} in {folder}: {reason}; {advice} another folder with TACTILE_LOC_STORE or --store."
        ) from error
