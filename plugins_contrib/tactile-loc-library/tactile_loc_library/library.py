"""A library of parts in a folder: opened at once whatever its size, read part by part, and changed atomically.

`library.json` is the manifest. It names the table of parts and the shards, with their checksums. A change writes new
files first, and then replaces the manifest. A killed change thus leaves the old library, and a reader keeps the files
that it has opened. Files that no manifest names any more are deleted by a later change, GRACE_S after the last use.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError
from tactile_loc.commands import remove_abandoned, replace_file
from tactile_loc.plugin.helpers import did_you_mean

from tactile_loc_library.record import (
    SHORT_DIGITS,
    LibraryError,
    PartRecord,
    guard_output,
    hash_bytes,
    write_canonical_json,
)
from tactile_loc_library.shards import (
    FOLDER,
    SHARD_BYTES,
    FileEntry,
    Item,
    Shard,
    ShardEntry,
    count_bytes,
    describe_file,
    write_shards,
)
from tactile_loc_library.table import PartRow, read_table, write_table

MANIFEST, LOCK = "library.json", ".lock"
SCHEMA_VERSION = 1
GRACE_S = 3600.0  # for which files stay after the manifest has stopped naming them
MOST_NAMED = 20  # of a library's parts, in a message


class Manifest(BaseModel, frozen=True, extra="forbid"):
    """The whole `library.json`."""

    schema_version: int = Field(description="raised when a key is removed or changes its meaning")
    grid: dict[str, Any] = Field(description="the grid of the places: its name, and what identifies its places")
    descriptor: str = Field(description="digest of the weights that computed the vectors")
    parts: int = Field(ge=0, description="number of parts")
    table: str = Field(
        pattern=r"^parts-[0-9a-f]{16}\.parquet$", description="name of the file with a row for each part"
    )
    table_file: FileEntry = Field(description="size and checksum of this file")
    shards: list[ShardEntry] = Field(description="the folders of the records")
    sha256: str = Field(default="", description="checksum of the other values, as canonical JSON")

    def compute_checksum(self) -> str:
        """Return the SHA-256 (hex) of all values except `sha256`."""
        return hash_bytes(write_canonical_json(self.model_dump(mode="json", exclude={"sha256"})))


@dataclass(frozen=True, eq=False)
class Library:
    """An opened library in the folder `path`. It shows the library as it was when it was opened.

    `rows` are the parts' rows by name, sorted. No record is read before it is used. A library that another process
    changes stays readable for GRACE_S seconds. After that, open it again.
    """

    path: Path
    manifest: Manifest
    rows: Mapping[str, PartRow]

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a library: read its manifest and its table. Raises LibraryError or MissingLibraryError."""
        path = Path(path)
        manifest = _read_manifest(path)
        if not (path / manifest.table).exists():  # another process has changed the library meanwhile
            manifest = _read_manifest(path)
        content = _read_table_file(path / manifest.table)
        if hash_bytes(content) != manifest.table_file.sha256:
            raise LibraryError(f"{path / manifest.table} does not match its checksum; build the library again")
        try:
            rows = read_table(content)
        except ValueError as error:
            raise LibraryError(f"{path / manifest.table} is damaged ({error}); build the library again") from error
        return cls(path, manifest, {row.name: row for row in rows})

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parts, sorted."""
        return tuple(self.rows)

    @property
    def nbytes(self) -> int:
        """The size of the library's files, bytes, without the manifest."""
        files = [file for shard in self.manifest.shards for file in shard.files.values()]
        return sum(file.bytes for file in (self.manifest.table_file, *files))

    @cached_property
    def shards(self) -> tuple[Shard, ...]:
        """The shards, for a search over the vectors of all parts."""
        parts: defaultdict[str, list[PartRow]] = defaultdict(list)
        for row in sorted(self.rows.values(), key=lambda row: row.first):
            parts[row.shard].append(row)
        entries = self.manifest.shards
        return tuple(Shard(self.path / FOLDER / one.name, one, tuple(parts[one.name])) for one in entries)

    @cached_property
    def _shards_by_name(self) -> dict[str, Shard]:
        return {shard.entry.name: shard for shard in self.shards}

    def read(self, name: str) -> PartRecord:
        """Return the record of a part, after comparing its checksum. Raises LibraryError if it cannot be read."""
        return PartRecord.unpack(self.read_packed(self._find(name)))

    def read_packed(self, row: PartRow) -> bytes:
        """Return the packed record of a part, after comparing its checksum. Raises LibraryError."""
        packed = self._read_unverified(row)
        if hash_bytes(packed) != row.sha256:
            raise LibraryError(
                f"the record of {row.name} in {self.path} does not match its checksum; list all damage with "
                "`tactile-loc library check`, and build the library again from its meshes"
            )
        return packed

    def map_arrays(self, row: PartRow) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
        """Return the vectors (N, D) and placements (N, 6) of a part, mapped from the disk: see `PartRecord`.

        They are not compared with a checksum. Raises LibraryError if they cannot be read.
        """
        shard, some = self._find_shard(row), slice(row.first, row.first + row.places)
        return shard.vectors[some], shard.placements[some]

    def is_intact(self, row: PartRow) -> bool:
        """Return whether the record of a part can be read and matches its checksum."""
        try:
            self.read_packed(row)
        except LibraryError:
            return False
        return True

    def find_damage(self, advance: Callable[[int], None] = lambda shards: None) -> LibraryDamage:
        """Verify all checksums, and return what is damaged. Calls `advance` with 1 after each shard."""
        files: dict[str, str] = {}
        parts: list[str] = []
        for shard in self.shards:
            found = {str(path.relative_to(self.path)): reason for path, reason in shard.find_damage()}
            if found:
                files |= found
                parts += [row.name for row in shard.parts if not self.is_intact(row)]
            advance(1)
        known = {shard.entry.name for shard in self.shards}
        parts += [row.name for row in self.rows.values() if row.shard not in known]
        return LibraryDamage(tuple(sorted(parts)), files)

    def add(self, records: Iterable[PartRecord]) -> Library:
        """Add parts to the library, or replace parts of the same name. Return the changed library, opened.

        Raises LibraryError if a record has other places or vectors than the library, and if the library
        cannot be written.
        """
        items = []
        for record in records:
            if record.grid != self.manifest.grid or record.descriptor != self.manifest.descriptor:
                raise LibraryError(f"the record of {record.name} has other places or vectors; build it again")
            packed = record.pack()
            items.append(Item(PartRow.of(packed, ""), partial(bytes, packed)))
        return add_items(self.path, items)

    def remove(self, names: Iterable[str]) -> Library:
        """Remove parts. Return the changed library, opened. Raises LibraryError if a part is not in the library."""
        gone = set(names)
        with lock_library(self.path):
            now = Library.open(self.path)
            for name in sorted(gone):
                now._find(name)
            kept = [row for row in now.rows.values() if row.name not in gone]
            return _change(now, kept, [])

    def _find(self, name: str) -> PartRow:
        if name not in self.rows:
            some = ", ".join(self.names[:MOST_NAMED])
            advice = f"choose {some}" if 0 < len(self) <= MOST_NAMED else "list the parts with `library list`"
            near = f".{found}" if (found := did_you_mean(name, self.names)) else ""
            raise LibraryError(f"there is no part {name!r} in {self.path}; {advice}{near}")
        return self.rows[name]

    def _find_shard(self, row: PartRow) -> Shard:
        shard = self._shards_by_name.get(row.shard)
        if shard is None:
            raise LibraryError(f"the shard of {row.name} is not in {self.path / MANIFEST}; build the library again")
        return shard

    def _read_unverified(self, row: PartRow) -> bytes:
        return self._find_shard(row).read_packed(row)

    def item(self, row: PartRow) -> Item:
        """Return a part of the library as an item to write."""
        return Item(row, lambda: self._read_unverified(row))


@dataclass(frozen=True)
class LibraryDamage:
    """The names of damaged `parts`, and damaged `files` with reasons. A file may be damaged where it holds no part."""

    parts: tuple[str, ...]
    files: Mapping[str, str]

    def __bool__(self) -> bool:
        return bool(self.parts or self.files)


@contextmanager
def lock_library(path: Path) -> Iterator[None]:
    """Lock a library for a change; other processes that change it wait. Raises LibraryError if there can be no lock."""
    from filelock import FileLock

    lock = FileLock(path / LOCK)
    with guard_output(path):
        path.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def add_items(path: Path, items: Sequence[Item]) -> Library:
    """Add items to the library at `path`, or replace parts of the same name. Return the changed library, opened."""
    with lock_library(path):
        now = Library.open(path)
        new = {item.row.name for item in items}
        return _change(now, [row for row in now.rows.values() if row.name not in new], items)


def _change(now: Library, kept: Sequence[PartRow], new: Sequence[Item]) -> Library:
    """Replace the parts of a library by the rows `kept` of it and new items. The caller holds the lock.

    Parts of shards that are less than half full are written again, so that shards stay few and hold few removed parts.
    """
    used: defaultdict[str, int] = defaultdict(int)
    for row in kept:
        used[row.shard] += count_bytes(row)
    full = {name for name, size in used.items() if size >= SHARD_BYTES / 2}
    moved = [now.item(row) for row in kept if row.shard not in full]
    items = sorted([*moved, *new], key=lambda item: item.row.name)
    stays = [row for row in kept if row.shard in full]
    return write_library(now.path, items, now.manifest.grid, now.manifest.descriptor, now, stays)


def write_library(
    path: Path,
    items: Sequence[Item],
    grid: Mapping[str, Any],
    descriptor: str,
    old: Library | None = None,
    stays: Sequence[PartRow] = (),
) -> Library:
    """Write a library of `items`, in order of name, and of the rows `stays` of the `old` library at the same path.

    Return the new library, opened. The caller holds the lock. Raises LibraryError if the library cannot be written.
    """
    known = {} if old is None else {shard.name: shard for shard in old.manifest.shards}
    with guard_output(path):
        written = write_shards(path, items, known)
        shards = {row.shard: known[row.shard] for row in stays} | {entry.name: entry for entry, _ in written}
        rows = sorted([*stays, *(row for _, some in written for row in some)], key=lambda row: row.name)
        content = write_table(rows)
        digest = hash_bytes(content)
        table = f"parts-{digest[:SHORT_DIGITS]}.parquet"
        with replace_file(path / table) as temporary:
            temporary.write_bytes(content)
        manifest = Manifest(
            schema_version=SCHEMA_VERSION,
            grid=dict(grid),
            descriptor=descriptor,
            parts=len(rows),
            table=table,
            table_file=describe_file(path / table),
            shards=[shards[name] for name in sorted(shards)],
        )
        manifest = manifest.model_copy(update={"sha256": manifest.compute_checksum()})
        with replace_file(path / MANIFEST) as temporary:
            temporary.write_text(manifest.model_dump_json(indent=1) + "\n", "utf-8")
        _delete_unused(path, manifest, old)
    return Library(path, manifest, {row.name: row for row in rows})


def _delete_unused(path: Path, manifest: Manifest, old: Library | None) -> None:
    """Delete tables and shards that no manifest has named for GRACE_S. A reader may still use newer ones.

    Temporary files of killed processes are deleted, too.
    """
    remove_abandoned(path)
    remove_abandoned(path / FOLDER)
    used = {manifest.table, *(shard.name for shard in manifest.shards)}
    before = set() if old is None else {old.manifest.table, *(shard.name for shard in old.manifest.shards)}
    for left in [*path.glob("parts-*.parquet"), *(path / FOLDER).glob("[0-9a-f]*")]:
        with suppress(OSError):
            if left.name in before - used:
                os.utime(left)  # the time from which it is unused
            elif left.name not in used and time.time() - left.stat().st_mtime > GRACE_S:
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def _read_manifest(path: Path) -> Manifest:
    try:
        found = json.loads((path / MANIFEST).read_bytes())
        version = found["schema_version"]
        if version == SCHEMA_VERSION:
            manifest = Manifest.model_validate(found)
            if manifest.compute_checksum() != manifest.sha256:
                raise ValueError("its values do not match their checksum")
            return manifest
    except FileNotFoundError as error:
        raise LibraryError(f"there is no library in {path}; make one with `tactile-loc library build`") from error
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = f"{error.error_count()} wrong entries" if isinstance(error, ValidationError) else error
        raise LibraryError(f"{path / MANIFEST} is damaged ({reason}); build the library again") from error
    raise LibraryError(f"{path} has format {version}, not {SCHEMA_VERSION}; build the library again")


def _read_table_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LibraryError(f"{path} cannot be read ({error.strerror}); build the library again") from error
