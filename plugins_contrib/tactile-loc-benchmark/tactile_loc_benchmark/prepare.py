"""What a benchmark prepares before its jobs: objects, sources with their sensors, and methods."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import FileLock
from tactile_loc import load_object
from tactile_loc.plugin import ConfigError, MissingLibraryError, ObjectModel, TactileLocError, registry

from tactile_loc_benchmark.examples import describe_libraries, make_sensor
from tactile_loc_benchmark.interfaces import Method, RecordedSource, TouchSource
from tactile_loc_benchmark.results import UsedMethod, UsedSource
from tactile_loc_benchmark.suite import HERE, Suite, SuiteEntry, SuiteObject, create, find_in_data, hash_shortly

SENSOR_VERSION = 1  # increase it if the same source gets another sensor
SENSORS = "benchmark-sensors"  # a folder of the store


@dataclass(frozen=True, eq=False)
class PreparedMethod:
    """A method that can be used, or the problem why not. `described` identifies its output."""

    entry: SuiteEntry
    used: UsedMethod
    described: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PreparedSource:
    """A source with its prepared sensor and its objects, or the problem why it cannot be used.

    `described` identifies the source's output, and `table` is its sensor's table.
    """

    entry: SuiteEntry
    used: UsedSource
    described: Mapping[str, Any] = field(default_factory=dict)
    table: Mapping[str, Any] = field(default_factory=dict)
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)


def load_objects(configs: Sequence[SuiteObject]) -> dict[str, ObjectModel]:
    """Return the objects by name. Raises TactileLocError if an object cannot be read, or if two have one name."""
    found: dict[str, ObjectModel] = {}
    for config in configs:
        obj = load_object(config.path, config.units, config.symmetry)
        if obj.name in found:
            raise ConfigError(f"two objects of the suite are called {obj.name!r}; rename one of their files")
        found[obj.name] = obj
    return found


def prepare_method(entry: SuiteEntry) -> PreparedMethod:
    """Return a method, or the problem that prevents its use."""
    try:
        with _name_library("method", entry):
            method: Method = create("method", entry)
    except TactileLocError as error:
        return PreparedMethod(entry, UsedMethod(entry.label, entry.name, entry.options, problem=str(error)))
    libraries = {**_find_version("method", entry), **describe_libraries(method.libraries)}
    used = UsedMethod(entry.label, entry.name, entry.options, method.paper, libraries)
    return PreparedMethod(entry, used, method.describe())


def prepare_source(entry: SuiteEntry, objects: Mapping[str, ObjectModel], suite: Suite, store: Path) -> PreparedSource:
    """Return a source with its sensor, calibrated now or by an earlier call, or with the problem that prevents this.

    Options that begin with HERE are paths in the folder `data` of the suite.
    """
    try:
        with _name_library("touch-source", entry):
            entry = _find_recordings(entry, suite.data)
            source: TouchSource = create("touch-source", entry)
            own = source.find_objects() if isinstance(source, RecordedSource) else objects
            table = _prepare_sensor(source, store)
            make_sensor(table)
    except TactileLocError as error:
        return PreparedSource(entry, UsedSource(entry.label, entry.name, problem=str(error)))
    used = UsedSource(
        entry.label,
        entry.name,
        protocol=hash_protocol(suite, entry, source, own),
        licence=source.licence,
        libraries={**_find_version("touch-source", entry), **describe_libraries(source.libraries)},
        objects=list(own),
        recorded=isinstance(source, RecordedSource),
    )
    return PreparedSource(entry, used, source.describe(), table, own)


def hash_protocol(suite: Suite, entry: SuiteEntry, source: TouchSource, objects: Mapping[str, ObjectModel]) -> str:
    """Return a hash of everything that determines the touches, whatever the method and the libraries' versions.

    Results with the same hash can be compared.
    """
    options = {k: v for k, v in entry.options.items() if not (isinstance(v, str) and Path(v).is_absolute())}
    return hash_shortly(
        {
            "suite": suite.describe_protocol(),
            "source": entry.name,
            "options": options,
            "version": source.version,
            "objects": {name: obj.describe() for name, obj in objects.items()},
        }
    )


def _find_recordings(entry: SuiteEntry, data: Path | None) -> SuiteEntry:
    """Return the entry of a source with absolute paths in place of paths that begin with HERE."""
    fields = registry().load("touch-source", entry.name).Options.model_fields
    options = {**{name: field.default for name, field in fields.items()}, **entry.options}
    found = {k: find_in_data(v, data) for k, v in options.items() if isinstance(v, str) and v.startswith(HERE)}
    return entry.model_copy(update={"options": {**entry.options, **found}})


@contextmanager
def _name_library(kind: str, entry: SuiteEntry) -> Iterator[None]:
    """Turn the error of an import in the block into a MissingLibraryError with the line that installs the library."""
    try:
        yield
    except ImportError as error:
        library = registry().find(kind, entry.name).spec.requires or error.name
        raise MissingLibraryError(
            f"the {kind} {entry.name!r} needs {error.name}, which is not installed: pip install {library}"
        ) from error


def _find_version(kind: str, entry: SuiteEntry) -> dict[str, str]:
    """Return the name and version of the distribution that offers a component."""
    return describe_libraries([registry().find(kind, entry.name).distribution])


def _prepare_sensor(source: TouchSource, store: Path) -> dict[str, Any]:
    """Return the sensor's table, from the store or prepared now. Its files are complete when its table is written."""
    described = {
        "version": SENSOR_VERSION,
        "source": source.describe(),
        "libraries": describe_libraries(source.libraries),
    }
    folder = store / SENSORS / hash_shortly(described)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_suffix(".lock")):
        try:
            return dict(json.loads((folder / "sensor.json").read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            table = dict(source.prepare_sensor(folder))
            (written := folder / "sensor.json.new").write_text(json.dumps(table), encoding="utf-8")
            written.replace(folder / "sensor.json")
            return table
