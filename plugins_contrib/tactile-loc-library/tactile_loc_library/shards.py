"""The shards of a library: folders with the records of some parts, and arrays that a search maps into memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field
from tactile_loc.commands import replace_folder

from tactile_loc_library.record import PLACED, SHORT_DIGITS, LibraryError, hash_bytes, hash_file, read_header
from tactile_loc_library.table import PartRow

FOLDER = "shards"
FileName = Literal["records.bin", "placements.npy", "vectors.npy"]
RECORDS, PLACEMENTS, VECTORS = get_args(FileName)
SHARD_BYTES = 64 * 2**20  # a shard is closed before it grows larger, unless it has a single part
CHANGED = "the library has changed since it was opened; open it again, or run `tactile-loc library check`"


class FileEntry(BaseModel, frozen=True, extra="forbid"):
    """A file of a library."""

    bytes: int = Field(ge=0, description="its size")
    sha256: str = Field(description="its checksum, hexadecimal")


class ShardEntry(BaseModel, frozen=True, extra="forbid"):
    """A shard of a library."""

    name: str = Field(pattern=r"^[0-9a-f]{16}$", description="its folder: a hash of the records' checksums")
    parts: int = Field(ge=0, description="number of records, including those of parts that were removed")
    files: dict[FileName, FileEntry] = Field(description="its files, by name")


class Item(NamedTuple):
    """A part to write: its row, whose place in a shard may be unknown, and a function that reads its packed record."""

    row: PartRow
    read: Callable[[], bytes]

    @classmethod
    def of_file(cls, path: Path) -> Item:
        """Return the item of a finished record, in a file that is named by its key. Raises OSError or LibraryError."""
        return cls(PartRow.of(path.read_bytes(), path.name), path.read_bytes)


@dataclass(frozen=True, eq=False)
class Shard:
    """A shard of an opened library: its `folder`, its `entry` in the manifest, and the rows of its parts.

    The parts are in the order of their rows in the arrays. Rows between parts belong to removed parts.
    """

    folder: Path
    entry: ShardEntry
    parts: tuple[PartRow, ...]

    @cached_property
    def vectors(self) -> NDArray[np.int8]:
        """The vectors (N, D) of all places, mapped from the disk: see `PartRecord`. Raises LibraryError."""
        return self._map(VECTORS, np.dtype("i1"))

    @cached_property
    def placements(self) -> NDArray[np.float32]:
        """The placements (N, 6) of all places, mapped from the disk: see `PartRecord`. Raises LibraryError."""
        return self._map(PLACEMENTS, np.dtype("<f4"))

    def read_packed(self, row: PartRow) -> bytes:
        """Return the packed record of a part, without verifying it. Raises LibraryError if a file cannot be read."""
        some = slice(row.first, row.first + row.places)
        try:
            with (self.folder / RECORDS).open("rb") as file:
                file.seek(row.offset)
                body = file.read(row.length)
        except OSError as error:
            raise LibraryError(f"{error.filename} cannot be read ({error.strerror}); {CHANGED}") from error
        return body + self.placements[some].tobytes() + self.vectors[some].tobytes()

    def find_damage(self) -> Iterator[tuple[Path, str]]:
        """Yield each damaged file, and the reason."""
        for name, entry in self.entry.files.items():
            path = self.folder / name
            try:
                if path.stat().st_size != entry.bytes:
                    yield path, f"it has {path.stat().st_size} bytes instead of {entry.bytes}"
                elif hash_file(path) != entry.sha256:
                    yield path, "its content does not match its checksum"
            except OSError:
                yield path, "it cannot be read"

    def _map(self, name: str, kind: np.dtype[Any]) -> NDArray[Any]:
        path = self.folder / name
        try:
            array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise LibraryError(f"{path} cannot be read ({error}); {CHANGED}") from error
        if array.ndim != 2 or array.dtype != kind:
            raise LibraryError(f"{path} holds another array; run `tactile-loc library check`")
        return array


def write_shards(
    root: Path, items: Iterable[Item], known: dict[str, ShardEntry]
) -> list[tuple[ShardEntry, list[PartRow]]]:
    """Write items, in their order, to shards in the library `root`. Return each shard with its new rows.

    A shard of `known` that already has exactly the items of a group is kept. Raises OSError if a shard cannot be
    written.
    """
    written = []
    for group in _split(items):
        name = hash_bytes("".join(item.row.sha256 for item in group).encode())[:SHORT_DIGITS]
        if name in known and all(item.row.shard == name for item in group):
            written.append((known[name], [item.row for item in group]))
        else:
            written.append(_write_shard(root / FOLDER / name, [item.read() for item in group], group))
    return written


def _split(items: Iterable[Item]) -> Iterator[list[Item]]:
    """Split items into groups of at most SHARD_BYTES."""
    group: list[Item] = []
    size = 0
    for item in items:
        added = count_bytes(item.row)
        if group and size + added > SHARD_BYTES:
            yield group
            group, size = [], 0
        group.append(item)
        size += added
    if group:
        yield group


def count_bytes(row: PartRow) -> int:
    """Return the size, bytes, of a part's packed record, roughly: vectors have at least 128 components."""
    return row.length + row.places * (4 * PLACED + 128)


def _write_shard(folder: Path, packed: Sequence[bytes], group: Sequence[Item]) -> tuple[ShardEntry, list[PartRow]]:
    headers = [read_header(one) for one in packed]
    rows, offset, first = [], 0, 0
    for item in group:
        rows.append(replace(item.row, shard=folder.name, offset=offset, first=first))
        offset, first = offset + item.row.length, first + item.row.places
    ends = [header.body + header.placements for header in headers]
    placements = b"".join(one[h.body : end] for one, h, end in zip(packed, headers, ends, strict=True))
    vectors = b"".join(one[end:] for one, end in zip(packed, ends, strict=True))
    with replace_folder(folder) as new:
        (new / RECORDS).write_bytes(b"".join(one[: h.body] for one, h in zip(packed, headers, strict=True)))
        np.save(new / PLACEMENTS, np.frombuffer(placements, "<f4").reshape(-1, PLACED))
        np.save(new / VECTORS, np.frombuffer(vectors, "i1").reshape(first, -1))
        files = {name: describe_file(new / name) for name in (RECORDS, PLACEMENTS, VECTORS)}
    return ShardEntry(name=folder.name, parts=len(rows), files=files), rows


def describe_file(path: Path) -> FileEntry:
    """Return the size and the checksum of a file. Raises OSError if it cannot be read."""
    return FileEntry(bytes=path.stat().st_size, sha256=hash_file(path))
