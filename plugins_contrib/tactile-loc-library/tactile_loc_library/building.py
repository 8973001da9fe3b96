"""The records of parts, made from mesh files by one job a part, and the libraries that they are put into.

A finished record waits in the folder WAITING of the library, in a file that is named by a hash of everything that the
record was made from. So a killed build continues where it ended, and the order of the jobs does not matter.
"""

import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc import StageStore, TactileLocError, load_object
from tactile_loc.commands import list_mesh_files, remove_abandoned, replace_file
from tactile_loc.plugin import ConfigError, Progress
from tactile_loc.plugin.helpers import show_name

from tactile_loc_library.descriptor import load_descriptor
from tactile_loc_library.library import MANIFEST, Library, add_items, lock_library, write_library
from tactile_loc_library.record import (
    PLACES_VERSION,
    VERSION,
    LibraryError,
    PlaceGrid,
    guard_output,
    hash_bytes,
    hash_file,
    make_record,
    require_pyarrow,
    write_canonical_json,
)
from tactile_loc_library.shards import FOLDER, Item

WAITING = ".records"  # the folder of finished records that are in no shard yet
LOG = "workers.log"  # of local workers, in this folder
WHOLE = PlaceGrid()


@dataclass(frozen=True)
class MeshSource:
    """A part to build: its name, its mesh file, and the file's checksum. `units` and `symmetry`: see `load_object`."""

    name: str
    path: Path
    sha256: str
    units: str = "auto"
    symmetry: str = "auto"


@dataclass(frozen=True)
class PartJob:
    """The job that makes the record of one part, and puts it into the folder `store`. All workers share the folder.

    `key` is a hash of everything that the record is made from.
    """

    key: str
    store: Path
    grid: PlaceGrid

    def measure(self, source: MeshSource, store: StageStore) -> dict[str, Any]:
        """Make the record. Return why it cannot be written, as `unwritten`, if so: this is no fault of the mesh.

        Raises TactileLocError if the mesh cannot be used, or if this machine has other software.
        """
        if make_part_key(source, self.grid) != self.key:
            raise ConfigError(
                "the worker's tactile-loc differs from that which started the build; install the same there"
            )
        if _hash_mesh(source.path) != source.sha256:
            raise LibraryError(f"{source.path} has changed since the build began; build again")
        obj = load_object(source.path, source.units, source.symmetry, source.name)  # type: ignore[arg-type]
        packed = make_record(obj, self.grid, source.units, source.sha256).pack()
        try:
            with replace_file(self.store / self.key) as temporary:
                temporary.write_bytes(packed)
        except OSError as error:
            return {"unwritten": f"{self.store / self.key} cannot be written ({error.strerror or error})"}
        return {}


@dataclass(frozen=True)
class Ended:
    """The end of a job in this process."""

    key: str
    measured: dict[str, Any] | None = None
    error: str = ""


def run_here(jobs: Sequence[PartJob], sources: Mapping[str, MeshSource]) -> Generator[Ended, None, None]:
    """Run jobs one after another in this process, and yield each one's end."""
    for job in jobs:
        try:
            ended = Ended(job.key, job.measure(sources[job.key], StageStore(job.store)))
        except TactileLocError as raised:
            ended = Ended(job.key, error=str(raised))
        except Exception as raised:  # noqa: BLE001 - a mesh may break anything
            ended = Ended(job.key, error=f"{type(raised).__name__}: {raised}")
        yield ended


RunJobs = Callable[[Sequence[PartJob], Mapping[str, MeshSource]], Generator[Any, None, None]]
"""Runs jobs, and yields each one's end, such as `Ended`. The mapping has the mesh of each job, by the job's key."""


@dataclass(frozen=True, eq=False)
class Built:
    """A library after a change: the names of the parts that were `made` now or `kept` as they were.

    `failed` maps the names of other parts to the reasons why they could not be made.
    """

    library: Library
    made: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]


def list_meshes(meshes: Iterable[str | Path], units: str = "auto", symmetry: str = "auto") -> list[MeshSource]:
    """Return the parts of mesh files and of folders of mesh files, sorted by name. A part is named like its file.

    Raises TactileLocError if there is no such file, no mesh in a folder, or if two files give parts of the same name.
    """
    files: list[Path] = []
    for path in map(Path, meshes):
        found = list_mesh_files(path) if path.is_dir() else [path]
        if not os.path.isfile(found[0]):
            raise LibraryError(f"there is no file {found[0]}; give mesh files, or folders of mesh files")
        files += found
    by_name: dict[str, Path] = {}
    for path in files:
        other = by_name.setdefault(show_name(path.stem), path)
        if other != path:
            raise LibraryError(f"{other} and {path} would both be called {show_name(path.stem)}; rename one of them")
    return [
        MeshSource(name, path.absolute(), _hash_mesh(path), units, symmetry) for name, path in sorted(by_name.items())
    ]


def _hash_mesh(path: Path) -> str:
    try:
        return hash_file(path)
    except OSError as error:
        raise LibraryError(f"{path} cannot be read ({error.strerror or error}); check its permissions") from error


def build_library(
    path: Path,
    sources: Sequence[MeshSource],
    grid: PlaceGrid = WHOLE,
    run_jobs: RunJobs = run_here,
    progress: Progress | None = None,
) -> Built:
    """Build a library at `path` that has exactly the parts of `sources`, except parts that cannot be made.

    Parts of a library that is there already are kept if they were made from the same file and options. After an
    interruption, the same call continues. Equal sources and options give equal files. Raises TactileLocError if `path`
    cannot be written, or if no part can be made.
    """
    require_pyarrow()
    _require_place(path)
    old = _open_or_none(path)
    pending = PendingParts(path / WAITING, {make_part_key(source, grid): source for source in sources}, grid)
    items, failed = pending.make(old, run_jobs, progress or Progress())
    if not items:
        pending.tidy(failed)
        name, reason = next(iter(failed.items()), ("", "there is no mesh"))
        raise LibraryError(f"no part could be made{f'; {name}' if name else ''}: {reason}")
    with lock_library(path):
        library = write_library(path, items, grid.describe(), load_descriptor().digest, _open_or_none(path))
    pending.tidy(failed)
    return _conclude(library, items, failed)


def add_parts(
    path: Path, sources: Sequence[MeshSource], run_jobs: RunJobs = run_here, progress: Progress | None = None
) -> Built:
    """Add parts to the library at `path`, or replace parts of the same name. Parts that would be equal are kept.

    Raises LibraryError if there is no library, if it was made by another version, or if no part can be made.
    """
    old = Library.open(path)
    grid = PlaceGrid(old.manifest.grid["name"], old.manifest.grid["options"])
    if grid.describe() != old.manifest.grid or load_descriptor().digest != old.manifest.descriptor:
        raise LibraryError(f"{path} was made by another version of tactile-loc; build it again from its meshes")
    pending = PendingParts(path / WAITING, {make_part_key(source, grid): source for source in sources}, grid)
    items, failed = pending.make(old, run_jobs, progress or Progress())
    new = [item for item in items if not item.row.shard]
    library = add_items(path, new) if new else old
    pending.tidy(failed)
    return _conclude(library, items, failed)


def make_part_key(source: MeshSource, grid: PlaceGrid) -> str:
    """Return the hash of everything that the record of a part is made from."""
    made_from = {
        "version": VERSION,
        "places": PLACES_VERSION,
        "descriptor": load_descriptor().digest,
        "grid": grid.make_sampler().describe(),
        "name": source.name,
        "file": show_name(source.path.name),
        "sha256": source.sha256,
        "units": source.units,
        "symmetry": source.symmetry,
    }
    return hash_bytes(write_canonical_json(made_from))


@dataclass(frozen=True, eq=False)
class PendingParts:
    """The parts of `keys`, which maps the keys of their records to their meshes. Finished records wait in a folder."""

    waiting: Path
    keys: Mapping[str, MeshSource]
    grid: PlaceGrid

    def make(self, old: Library | None, run_jobs: RunJobs, progress: Progress) -> tuple[list[Item], dict[str, str]]:
        """Return the parts, sorted by name, and the reasons why others failed, by name. Only missing parts are made.

        Raises LibraryError if the folder cannot be written.
        """
        rows = {} if old is None else old.rows
        items, missing = [], []
        for key, source in self.keys.items():
            row = rows.get(source.name)
            if old is not None and row is not None and row.key == key and old.is_intact(row):
                items.append(old.item(row))
            elif _read_item(self.waiting / key) is None:
                missing.append(PartJob(key, self.waiting.absolute(), self.grid))
        if missing:
            with guard_output(self.waiting.parent):
                self.waiting.mkdir(parents=True, exist_ok=True)
        errors: dict[str, str] = {}
        with (
            progress.task("building parts", len(self.keys)) as advance,
            closing(run_jobs(missing, self.keys)) as running,
        ):
            advance(len(self.keys) - len(missing))
            for ended in running:
                if ended.error:
                    errors[ended.key] = ended.error
                elif unwritten := (ended.measured or {}).get("unwritten"):
                    raise LibraryError(unwritten)
                advance(1)
        kept = {item.row.key for item in items}
        items += [Item.of_file(self.waiting / key) for key in self.keys.keys() - kept - errors.keys()]
        failed = {self.keys[key].name: error for key, error in errors.items()}
        return sorted(items, key=lambda item: item.row.name), dict(sorted(failed.items()))

    def tidy(self, failed: Mapping[str, str]) -> None:
        """Delete the records, which are in the library now, and the log of workers unless a part failed."""
        remove_abandoned(self.waiting)
        with suppress(OSError):
            for name in [*self.keys, *([] if failed else [LOG])]:
                (self.waiting / name).unlink(missing_ok=True)
            self.waiting.rmdir()


def _read_item(path: Path) -> Item | None:
    """Return a finished record that waits; None if there is none, or if it is damaged."""
    try:
        return Item.of_file(path)
    except (OSError, LibraryError):
        return None


def _open_or_none(path: Path) -> Library | None:
    """Open a library; return None if there is none, or if it is damaged."""
    try:
        return Library.open(path)
    except LibraryError:
        return None


def _require_place(path: Path) -> None:
    """Raise LibraryError if there are other files at `path` than those of a library, finished or not."""
    if not path.is_dir() or (path / MANIFEST).exists():
        return
    strange = [one.name for one in path.iterdir() if not one.name.startswith((".", "parts-")) and one.name != FOLDER]
    if strange:
        raise LibraryError(f"{path} holds other files, such as {min(strange)}; choose a new folder for the library")


def _conclude(library: Library, items: Sequence[Item], failed: Mapping[str, str]) -> Built:
    made = tuple(item.row.name for item in items if not item.row.shard)
    return Built(library, made, tuple(item.row.name for item in items if item.row.shard), failed)
