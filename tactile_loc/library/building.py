"""The records of parts, made from mesh files by one job a part, and the libraries that they are put into.

A finished record waits in the folder WAITING of the library, in a file that is named by a hash of everything that the
record was made from. So a killed build continues where it ended, and the order of the jobs does not matter.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tactile_loc.core.descriptor.descriptor import load_descriptor
from tactile_loc.core.runtime.errors import (
    ConfigError,
    LibraryError,
    ObjectError,
    OutputError,
    TactileLocError,
    fold_line,
)
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.io.config import SlotConfig
from tactile_loc.io.meshes.mesh_files import Units, load_object
from tactile_loc.library.folder import MANIFEST, LibraryFolder, add_items, lock_library, write_library
from tactile_loc.library.record import (
    PLACES_VERSION,
    VERSION,
    choose_grid,
    describe_grid,
    make_record,
    require_pyarrow,
)
from tactile_loc.library.shards import FOLDER, Item
from tactile_loc.library.table import PartRow
from tactile_loc.locate.stored_object import list_mesh_files
from tactile_loc.slots.grid import GridSampler
from tactile_loc.slots.registry import registry
from tactile_loc.store.files import remove_abandoned, require_writable, write_atomically
from tactile_loc.store.keys import hash_file, hash_json
from tactile_loc.store.store import StageStore

WAITING = ".records"  # the folder of finished records that are in no shard yet
LOG = "workers.log"  # of local workers, in this folder
DIRECTIONS = 800  # of the places of a part
WHOLE = SlotConfig(name="whole", options={"directions": DIRECTIONS})


@dataclass(frozen=True)
class MeshSource:
    """A part to build: its name, its mesh file, and the file's checksum. `units` and `symmetry`: see `load_object`."""

    name: str
    path: Path
    sha256: str
    units: Units = "auto"
    symmetry: str = "auto"


@dataclass(frozen=True)
class PartJob:
    """The job that makes the record of one part, and puts it into the folder `store`. All workers share the folder.

    `key` is a hash of everything that the record is made from.
    """

    key: str
    store: Path
    grid: SlotConfig

    def measure(self, source: MeshSource, store: StageStore) -> dict[str, Any]:
        """Make the record. Return why it cannot be written, as `unwritten`, if so: this is no fault of the mesh.

        Raises TactileLocError if the mesh cannot be used, or if this machine has other software.
        """
        sampler = _make_sampler(self.grid)
        if make_part_key(source, sampler) != self.key:
            raise ConfigError(
                "the worker's tactile-loc differs from that which started the build; install the same there"
            )
        if hash_file(source.path) != source.sha256:
            raise ObjectError(f"{source.path} has changed since the build began; build again")
        obj = load_object(source.path, source.units, source.symmetry, source.name)
        packed = make_record(obj, sampler, self.grid.name, source.units, source.sha256).pack()
        try:
            write_atomically(self.store / self.key, lambda temporary: temporary.write_bytes(packed))
        except OutputError as error:
            return {"unwritten": str(error)}
        return {}


class Finished(Protocol):
    """The end of a job: its key, the result of `PartJob.measure`, or an error in one sentence. See `Outcome`."""

    @property
    def key(self) -> str:
        """The job's key."""
        ...

    @property
    def measured(self) -> dict[str, Any] | None:
        """The result; None after an error."""
        ...

    @property
    def error(self) -> str:
        """The error, or ""."""
        ...


class RunJobs(Protocol):
    """Runs jobs, and yields each one's end. `sources` maps the jobs' keys to their meshes. See `LocalWorkers`."""

    def __call__(
        self, jobs: Sequence[PartJob], sources: Mapping[str, MeshSource], /
    ) -> Generator[Finished, None, None]:
        """Run jobs."""
        ...


@dataclass(frozen=True)
class Ended:
    """The end of a job in this process."""

    key: str
    measured: dict[str, Any] | None = None
    error: str = ""


def run_here(jobs: Sequence[PartJob], sources: Mapping[str, MeshSource]) -> Generator[Finished, None, None]:
    """Run jobs one after another in this process, and yield each one's end."""
    for job in jobs:
        try:
            ended = Ended(job.key, job.measure(sources[job.key], StageStore(job.store)))
        except TactileLocError as raised:
            ended = Ended(job.key, error=str(raised))
        except Exception as raised:  # noqa: BLE001 - a mesh may break anything
            ended = Ended(job.key, error=fold_line(f"{type(raised).__name__}: {raised}"))
        yield ended


@dataclass(frozen=True, eq=False)
class Built:
    """A library after a change: the names of the parts that were `made` now or `kept` as they were.

    `failed` maps the names of other parts to the reasons why they could not be made.
    """

    library: LibraryFolder
    made: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]


def list_meshes(meshes: Iterable[str | Path], units: Units = "auto", symmetry: str = "auto") -> list[MeshSource]:
    """Return the parts of mesh files and of folders of mesh files, sorted by name. A part is named like its file.

    Raises ObjectError if there is no such file, no mesh in a folder, or if two files give parts of the same name.
    """
    files: list[Path] = []
    for path in map(Path, meshes):
        found = list_mesh_files(path) if path.is_dir() else [path]
        if not os.path.isfile(found[0]):
            raise ObjectError(f"there is no file {found[0]}; give mesh files, or folders of mesh files")
        files += found
    by_name: dict[str, Path] = {}
    for path in files:
        other = by_name.setdefault(show_name(path.stem), path)
        if other != path:
            raise ObjectError(f"{other} and {path} would both be called {show_name(path.stem)}; rename one of them")
    return [
        MeshSource(name, path.absolute(), hash_file(path), units, symmetry) for name, path in sorted(by_name.items())
    ]


def build_library(
    path: Path, sources: Sequence[MeshSource], grid: SlotConfig = WHOLE, run_jobs: RunJobs = run_here,
    progress: Progress | None = None,
) -> Built:  # fmt: skip
    """Build a library at `path` that has exactly the parts of `sources`, except parts that cannot be made.

    Parts of a library that is there already are kept if they were made from the same file and options. After an
    interruption, the same call continues. Equal sources and options give equal files. Raises TactileLocError if `path`
    cannot be written, or if no part can be made.
    """
    require_pyarrow()
    require_writable(path)
    _require_place(path)
    old = _open_or_none(path)
    sampler = _make_sampler(grid)
    keys = {make_part_key(source, sampler): source for source in sources}
    items, failed = _make_items(path / WAITING, keys, grid, old, run_jobs, progress or Progress())
    if not items:
        name, reason = next(iter(failed.items()), ("", "there is no mesh"))
        raise LibraryError(f"no part could be made{f'; {name}' if name else ''}: {reason}")
    with lock_library(path):
        now = _open_or_none(path)
        library = write_library(path, items, describe_grid(grid.name, sampler), load_descriptor().digest, now)
    _tidy(path / WAITING, keys, failed)
    return _conclude(library, items, failed)


def add_parts(
    path: Path, sources: Sequence[MeshSource], run_jobs: RunJobs = run_here, progress: Progress | None = None
) -> Built:
    """Add parts to the library at `path`, or replace parts of the same name. Parts that would be equal are kept.

    Raises LibraryError if there is no library, if it was made by another version, or if no part can be made.
    """
    old = LibraryFolder.open(path)
    require_writable(path)
    grid = choose_grid(old.manifest.grid)
    sampler = _make_sampler(grid)
    if describe_grid(grid.name, sampler) != old.manifest.grid or (load_descriptor().digest != old.manifest.descriptor):
        raise LibraryError(f"{path} was made by another version of tactile-loc; build it again from its meshes")
    keys = {make_part_key(source, sampler): source for source in sources}
    items, failed = _make_items(path / WAITING, keys, grid, old, run_jobs, progress or Progress())
    new = [item for item in items if not item.row.shard]
    library = add_items(path, new) if new else old
    _tidy(path / WAITING, keys, failed)
    return _conclude(library, items, failed)


def make_part_key(source: MeshSource, sampler: GridSampler) -> str:
    """Return the hash of everything that the record of a part is made from."""
    return hash_json({
        "version": VERSION, "places": PLACES_VERSION, "descriptor": load_descriptor().digest,
        "grid": sampler.describe(), "name": source.name, "file": show_name(source.path.name), "sha256": source.sha256,
        "units": str(source.units), "symmetry": source.symmetry,
    })  # fmt: skip


def _make_items(
    waiting: Path, keys: Mapping[str, MeshSource], grid: SlotConfig, old: LibraryFolder | None, run_jobs: RunJobs,
    progress: Progress,
) -> tuple[list[Item], dict[str, str]]:  # fmt: skip
    """Return the parts, sorted by name, and the reasons why others failed, by name. Only missing parts are made."""
    rows = {} if old is None else old.rows
    items, missing = [], []
    for key, source in keys.items():
        row = rows.get(source.name)
        if old is not None and row is not None and row.key == key and old.is_intact(row):
            items.append(old.item(row))
        elif not _is_record(waiting / key):
            missing.append(PartJob(key, waiting.absolute(), grid))
    errors: dict[str, str] = {}
    done = len(keys) - len(missing)
    with progress.task("building parts", len(keys)) as advance:
        advance(done)
        with closing(run_jobs(missing, keys)) as running:
            for ended in running:
                if ended.error:
                    errors[ended.key] = ended.error
                elif unwritten := (ended.measured or {}).get("unwritten"):
                    raise OutputError(unwritten)
                advance(1)
    kept = {item.row.key for item in items}
    for key in keys.keys() - kept - errors.keys():
        path = waiting / key
        items.append(Item(PartRow.of(path.read_bytes(), key), path.read_bytes))
    failed = {keys[key].name: error for key, error in errors.items()}
    return sorted(items, key=lambda item: item.row.name), dict(sorted(failed.items()))


def _is_record(path: Path) -> bool:
    """Return whether a finished record waits in a file."""
    try:
        PartRow.of(path.read_bytes(), path.name)
    except (OSError, LibraryError):
        return False
    return True


def _make_sampler(grid: SlotConfig) -> GridSampler:
    sampler: GridSampler = registry().create("grid", grid.name, grid.options)
    if not sampler.capabilities.places:
        raise ConfigError(f"the grid {grid.name!r} lists poses, but a library needs places; choose the grid whole")
    return sampler


def _open_or_none(path: Path) -> LibraryFolder | None:
    """Open a library; return None if there is none, or if it is damaged."""
    try:
        return LibraryFolder.open(path)
    except LibraryError:
        return None


def _require_place(path: Path) -> None:
    """Raise LibraryError if there are other files at `path` than those of a library, finished or not."""
    if not path.is_dir() or (path / MANIFEST).exists():
        return
    strange = [one.name for one in path.iterdir() if not one.name.startswith((".", "parts-")) and one.name != FOLDER]
    if strange:
        raise LibraryError(f"{path} holds other files, such as {min(strange)}; choose a new folder for the library")


def _tidy(waiting: Path, keys: Iterable[str], failed: Mapping[str, str]) -> None:
    """Delete the records that are in the library now, and the log of workers unless a part failed."""
    remove_abandoned(waiting)
    with suppress(OSError):
        for name in [*keys, *([] if failed else [LOG])]:
            (waiting / name).unlink(missing_ok=True)
        waiting.rmdir()


def _conclude(library: LibraryFolder, items: Sequence[Item], failed: Mapping[str, str]) -> Built:
    made = tuple(item.row.name for item in items if not item.row.shard)
    return Built(library, made, tuple(item.row.name for item in items if item.row.shard), failed)
