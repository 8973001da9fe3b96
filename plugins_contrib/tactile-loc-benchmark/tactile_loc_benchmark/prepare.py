"""What a benchmark prepares before its jobs: objects, sources with their sensors, and methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import ConfigError, MissingLibraryError, TactileLocError
from tactile_loc.io.config import ObjectConfig
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.slots.registry import registry
from tactile_loc.store.files import lock_folder, read_json, write_json
from tactile_loc.store.keys import hash_shortly
from tactile_loc.store.store import StageStore

from tactile_loc_benchmark.examples import describe_libraries, make_sensor
from tactile_loc_benchmark.interfaces import Method, RecordedSource, TouchSource
from tactile_loc_benchmark.results import UsedMethod, UsedSource
from tactile_loc_benchmark.suite import HERE, Entry, Suite, create, find_in_data, hash_component_code

SENSOR_VERSION = 1  # increase it if the same source gets another sensor
SENSORS = "benchmark-sensors"  # a folder of the store


@dataclass(frozen=True, eq=False)
class PreparedMethod:
    """A method that can be used, or the `problem` why not. `described` identifies its output."""

    entry: Entry
    described: Mapping[str, Any] = field(default_factory=dict)
    problem: str = ""
    paper: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)

    def describe_use(self) -> UsedMethod:
        """Return what the files of a benchmark state about the method."""
        entry = self.entry
        return UsedMethod(entry.label, entry.name, entry.options, self.paper, self.libraries, self.problem)


@dataclass(frozen=True, eq=False)
class PreparedSource:
    """A source with its prepared sensor and its objects, or the `problem` why it cannot be used.

    `described` identifies the source's output, and `table` is its sensor's table.
    """

    entry: Entry
    described: Mapping[str, Any] = field(default_factory=dict)
    table: Mapping[str, Any] = field(default_factory=dict)
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    problem: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)
    licence: str = ""
    recorded: bool = False

    def describe_use(self, suite: Suite) -> UsedSource:
        """Return what the files of a benchmark state about the source."""
        return UsedSource(
            self.entry.label, self.entry.name, "" if self.problem else self.hash_protocol(suite), self.licence,
            self.libraries, list(self.objects), self.recorded, self.problem,
        )  # fmt: skip

    def hash_protocol(self, suite: Suite) -> str:
        """Return a hash of everything that determines the touches, whatever the method and the libraries' versions.

        Results with the same hash can be compared.
        """
        options = {k: v for k, v in self.entry.options.items() if not (isinstance(v, str) and Path(v).is_absolute())}
        objects = {name: obj.describe() for name, obj in self.objects.items()}
        return hash_shortly({
            "suite": suite.describe_protocol(), "source": self.entry.name, "options": options,
            "version": self.described.get("version"), "objects": objects,
        })  # fmt: skip


def load_objects(configs: Sequence[ObjectConfig], store: Path) -> dict[str, ObjectModel]:
    """Return the objects by name. Raises TactileLocError if an object cannot be read, or if two have one name."""
    found: dict[str, ObjectModel] = {}
    for config in configs:
        obj = load_stored_object(config.path, config.units, config.symmetry, StageStore(store))
        if obj.name in found:
            raise ConfigError(f"two objects of the suite are called {obj.name!r}; rename one of their files")
        found[obj.name] = obj
    return found


def prepare_method(entry: Entry) -> PreparedMethod:
    """Return a method, or the problem that prevents its use."""
    try:
        with _name_library("method", entry):
            method: Method = create("method", entry)
    except TactileLocError as error:
        return PreparedMethod(entry, problem=str(error))
    libraries = {**_find_version("method", entry), **describe_libraries(method.libraries)}
    return PreparedMethod(entry, method.describe(), "", method.paper, libraries)


def prepare_source(
    entry: Entry, objects: Mapping[str, ObjectModel], store: Path, data: Path | None = None
) -> PreparedSource:
    """Return a source with its sensor, calibrated now or by an earlier call, or with the problem that prevents this.

    Options that begin with HERE are paths in the folder `data`.
    """
    try:
        with _name_library("touch-source", entry):
            entry = _find_recordings(entry, data)
            source: TouchSource = create("touch-source", entry)
            own = source.find_objects() if isinstance(source, RecordedSource) else objects
            table = _prepare_sensor(source, entry, store)
            make_sensor(table)
    except TactileLocError as error:
        return PreparedSource(entry, problem=str(error))
    libraries = {**_find_version("touch-source", entry), **describe_libraries(source.libraries)}
    recorded = isinstance(source, RecordedSource)
    return PreparedSource(entry, source.describe(), table, own, "", libraries, source.licence, recorded)


def _find_recordings(entry: Entry, data: Path | None) -> Entry:
    """Return the entry of a source with absolute paths in place of paths that begin with HERE."""
    fields = registry().load("touch-source", entry.name).Options.model_fields
    options = {**{name: field.default for name, field in fields.items()}, **entry.options}
    found = {k: find_in_data(v, data) for k, v in options.items() if isinstance(v, str) and v.startswith(HERE)}
    return entry.model_copy(update={"options": {**entry.options, **found}})


@contextmanager
def _name_library(kind: str, entry: Entry) -> Iterator[None]:
    """Turn the error of an import in the block into a MissingLibraryError with the line that installs the library."""
    try:
        yield
    except ImportError as error:
        library = registry().find(kind, entry.name).spec.requires or error.name
        raise MissingLibraryError(
            f"the {kind} {entry.name!r} needs {error.name}, which is not installed: pip install {library}"
        ) from error


def _find_version(kind: str, entry: Entry) -> dict[str, str]:
    """Return the name and version of the distribution that offers a component."""
    return describe_libraries([registry().find(kind, entry.name).distribution])


def _prepare_sensor(source: TouchSource, entry: Entry, store: Path) -> dict[str, Any]:
    """Return the sensor's table, from the store or prepared now. Its files are complete when its table is written."""
    key = hash_shortly({
        "version": SENSOR_VERSION, "source": source.describe(), "libraries": describe_libraries(source.libraries),
        "code": hash_component_code("touch-source", entry),
    })  # fmt: skip
    folder = store / SENSORS / key
    with lock_folder(folder):
        try:
            return dict(read_json(folder / "sensor.json"))
        except (OSError, ValueError, TypeError):
            table = dict(source.prepare_sensor(folder))
            write_json(folder / "sensor.json", table)
            return table
