"""The folder in which a stage is being built. Pieces that are finished survive an interruption."""

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

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.slots.encoder import Checkpoints
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
    """The folder in which one artifact is being built. `StageStore.build` passes it to the function that builds.

    Every piece is written atomically (temporary file, fsync, rename) and recorded with its checksum. The artifact
    consists of the pieces that this build saved, or loaded from an interrupted build. Pieces with `keep=False` are left
    out. Other files in the folder are deleted when the build ends. Use a workspace from one thread at a time.
    """

    def __init__(self, path: Path, key: StageKey) -> None:
        self.path = path
        self._key = key
        self._kept: set[str] = set()
        self._pieces = self._read_pieces()  # file name -> accepted checksums, newest first

    def load(self, name: str, keep: bool = True) -> NDArray[Any] | None:
        """Return the array that this build or an interrupted build saved under a name; None if missing or damaged."""
        for read, file_name in ((np.load, f"{name}.npy"), (read_packed, f"{name}.npz")):
            path = self.load_file(file_name, keep)
            if path is not None:
                array: NDArray[Any] = read(path)
                return array
        return None

    def load_file(self, file_name: str, keep: bool = True) -> Path | None:
        """Return the path of a file that this build or an interrupted build saved; None if missing or damaged."""
        if file_name not in self._pieces:
            return None
        path = self.path / file_name
        if not path.is_file() or hash_file(path) not in self._pieces[file_name]:
            logger.warning("the piece %s of stage %s is missing or damaged; it is made again", file_name, self._key)
            return None
        self._mark(file_name, keep)
        logger.info("stage %s: the saved piece %s is used", self._key, file_name)
        return path

    def save_array(self, name: str, array: NDArray[Any], keep: bool = True, packed: bool = False) -> None:
        """Save an array of any shape as `<name>.npy` or, if `packed`, compressed as `<name>.npz`.

        A packed array takes longer to read and is never mapped. Contact shapes that are mostly empty take a tenth of
        the space when packed. Raises StoreError when the array holds Python objects, the name cannot be used, or
        writing fails.
        """
        if array.dtype.hasobject:
            raise StoreError(f"the array {name!r} of stage {self._key} holds Python objects; convert it to numbers")
        if packed:
            self.save_file(f"{name}.npz", lambda path: write_packed(path, array), keep)
        else:
            self.save_file(f"{name}.npy", lambda path: np.save(path, array, allow_pickle=False), keep)

    def save_json(self, name: str, value: Any) -> None:
        """Save a value as `<name>.json`, with sorted keys.

        Raises StoreError when the value is not a finite JSON value, the name cannot be used, or writing fails.
        """
        try:
            text = json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n"
        except (TypeError, ValueError) as error:
            raise StoreError(f"{name!r} of stage {self._key} is not a finite JSON value ({error})") from error
        self.save_file(f"{name}.json", lambda path: path.write_text(text))

    def save_file(self, file_name: str, write: Callable[[Path], object], keep: bool = True) -> None:
        """Save a file of any format. `write` gets a temporary path of the same suffix, and writes the file there.

        Raises StoreError when the name cannot be used or writing fails.
        """
        if not _FILE_NAME.fullmatch(file_name) or file_name == MANIFEST:
            raise StoreError(f"{file_name!r} cannot name a file of stage {self._key}; use letters, digits, . - and _")
        with (
            guard_store(f"{file_name} of stage {self._key}", self.path),
            replace_file(self.path / file_name) as temporary,
        ):
            write(temporary)
            # Both checksums, new and previous, are recorded before the rename: a kill in between loses no piece.
            self._pieces[file_name] = [hash_file(temporary), *self._pieces.get(file_name, [])[:1]]
            with replace_file(self.path / _PIECES) as pieces:
                pieces.write_text(json.dumps(self._pieces))
        self._mark(file_name, keep)

    def finish(self) -> None:
        """Write the artifact's manifest. The store calls it when `make` returns."""
        with guard_store(f"the manifest of stage {self._key}", self.path):
            paths = {name: self.path / name for name in self._kept}
            files = {name: FileRecord(path.stat().st_size, hash_file(path)) for name, path in paths.items()}
            with replace_file(self.path / MANIFEST) as temporary:
                write_manifest(temporary, self._key, files)

    def is_finished(self) -> bool:
        """Return whether the artifact is complete. An interrupted build may have completed it just before its end."""
        try:
            artifact = read_artifact(self.path)
            artifact.verify()
        except DamagedError:
            return False
        return artifact.key == self._key

    def tidy(self) -> None:
        """Delete files that are not part of the artifact. Call this after the manifest is written."""
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
    """Keeps the state of a training in the workspace of its stage until the stage is finished."""

    def __init__(self, work: Workspace) -> None:
        self._work = work

    def load(self) -> Path | None:
        """Return the checkpoint of an interrupted build, or None if there is no intact checkpoint."""
        return self._work.load_file(_CHECKPOINT, keep=False)

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the checkpoint atomically. `write` gets a temporary path, and writes the checkpoint there."""
        self._work.save_file(_CHECKPOINT, write, keep=False)


@contextmanager
def guard_store(what: str, folder: Path) -> Iterator[None]:
    """Convert an OSError of the block to a StoreError: `what` cannot be stored in the folder."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else "the write is incomplete, as on a full disk"
        if error.errno in (errno.EEXIST, errno.ENOTDIR):
            reason = "there is a file where a folder is needed"
        advice = "free some space there or choose" if error.errno in _FULL else "choose"
        raise StoreError(
            f"{what} cannot be stored in {folder} ({reason}); {advice} another folder with TACTILE_LOC_STORE or `store`"
        ) from error
