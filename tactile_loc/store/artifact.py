"""A finished stage on disk: a folder of plain files, with a manifest of their checksums."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.arrays import load_npz
from tactile_loc.store.files import read_json
from tactile_loc.store.keys import StageKey, hash_file, hash_json

MANIFEST = "manifest.json"
_FORMAT = 1
_MEMBER = "array"  # name of the array in a packed file, which is an ordinary npz

Signature = tuple[tuple[int, int], ...]  # (mtime_ns, size) of the manifest and of every file


class DamagedError(StoreError):
    """An artifact is incomplete or differs from its manifest. The message contains the reason only."""


@dataclass(frozen=True)
class FileRecord:
    """The size in bytes and the SHA-256 (hex) of one file."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Artifact:
    """The stored result of one stage, read-only, as `StageStore.get` and `StageStore.build` return it."""

    path: Path
    key: StageKey
    files: Mapping[str, FileRecord]
    created: datetime
    """Time of the end of the build, UTC."""

    @property
    def names(self) -> tuple[str, ...]:
        """The sorted names of the files, with suffixes, without the manifest."""
        return tuple(sorted(self.files))

    @property
    def nbytes(self) -> int:
        """The size of all files together, bytes."""
        return sum(record.size for record in self.files.values())

    def find_file(self, name: str) -> Path:
        """Return the path of the file of this name (with its suffix). Raises StoreError when there is none."""
        if name not in self.files:
            raise StoreError(f"stage {self.key} has no file {name!r}; it has {', '.join(self.names) or 'no files'}")
        return self.path / name

    def load_array(self, name: str, mmap: bool = True) -> NDArray[Any]:
        """Return the array stored as `<name>.npy` or, packed, as `<name>.npz`.

        With `mmap`, an .npy file is mapped read-only from the disk. Otherwise, and for packed arrays, the array is read
        into memory. Pickled objects are never loaded. Raises StoreError when the array is missing or cannot be read.
        """
        if f"{name}.npz" in self.files:
            return self._read(f"{name}.npz", read_packed)
        return self._read(f"{name}.npy", lambda path: np.load(path, "r" if mmap else None, allow_pickle=False))

    def load_json(self, name: str) -> Any:
        """Return the value stored as `<name>.json`. Raises StoreError when the file is missing or cannot be read."""
        return self._read(f"{name}.json", read_json)

    def _read(self, name: str, read: Callable[[Path], Any]) -> Any:
        path = self.find_file(name)
        try:
            return read(path)
        except (OSError, ValueError, EOFError) as error:
            raise StoreError(f"{path} cannot be read ({error}); remove {self.path} and run again") from error

    def read_signature(self) -> Signature:
        """Return the times and sizes of the files. Any ordinary write changes these numbers.

        Raises DamagedError when a file is missing or its size differs from the recorded size.
        """
        try:
            stats = [(self.path / name).stat() for name in (MANIFEST, *self.names)]
        except OSError as error:
            raise DamagedError(f"{error.filename} cannot be read ({error.strerror})") from error
        for name, stat in zip(self.names, stats[1:], strict=True):
            if stat.st_size != self.files[name].size:
                raise DamagedError(f"{name} has {stat.st_size} bytes instead of {self.files[name].size}")
        return tuple((stat.st_mtime_ns, stat.st_size) for stat in stats)

    def verify(self) -> None:
        """Compare the checksums of all files with the manifest. Raises DamagedError if one differs."""
        for name, record in self.files.items():
            try:
                found = hash_file(self.path / name)
            except StoreError as error:
                raise DamagedError(f"{name} cannot be read") from error
            if found != record.sha256:
                raise DamagedError(f"the content of {name} does not match its checksum")


def write_packed(path: Path, array: NDArray[Any]) -> None:
    """Write an array of any shape, without Python objects, to a compressed file. Equal arrays give equal files."""
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{_MEMBER: array})


def read_packed(path: Path) -> NDArray[Any]:
    """Return the array that `write_packed` wrote.

    Raises OSError when the file cannot be opened, and ValueError when it holds no packed array, or one that is larger
    than this machine's memory.
    """
    arrays = load_npz(path, (_MEMBER,), psutil.virtual_memory().total)
    if not arrays:
        raise ValueError("it holds no packed array")
    return arrays[_MEMBER]


def write_manifest(path: Path, key: StageKey, files: Mapping[str, FileRecord]) -> None:
    """Write the manifest of an artifact's files, with a checksum of the manifest. Raises OSError if that fails."""
    manifest: dict[str, Any] = {
        "format": _FORMAT,
        "stage": key.stage,
        "version": key.version,
        "inputs": key.inputs,
        "label": key.label,
        "files": {name: {"size": record.size, "sha256": record.sha256} for name, record in files.items()},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    path.write_text(json.dumps({**manifest, "sha256": hash_json(manifest)}, sort_keys=True, indent=1) + "\n", "utf-8")


def read_artifact(folder: Path) -> Artifact:
    """Return the artifact that the manifest in a folder describes, without reading its files.

    Raises DamagedError when the manifest is missing, unreadable or altered.
    """
    try:
        manifest = read_json(folder / MANIFEST)
        if manifest.pop("sha256") != hash_json(manifest) or manifest["format"] != _FORMAT:
            raise DamagedError("its manifest is altered or of another format")
        files = {name: FileRecord(**record) for name, record in manifest["files"].items()}
        key = StageKey(manifest["stage"], manifest["version"], manifest["inputs"], manifest.get("label", ""))
        return Artifact(folder, key, files, datetime.fromisoformat(manifest["created"]))
    except DamagedError:
        raise
    except OSError as error:
        raise DamagedError(f"its manifest cannot be read ({error.strerror})") from error
    except (ValueError, TypeError, KeyError, AttributeError, StoreError) as error:
        raise DamagedError("its manifest is not readable JSON") from error
