"""A suite: objects, sources of touches, methods, and how many touches of each example are located together."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from tactile_loc import DEMO_OBJECTS, TactileLocError, Units
from tactile_loc.plugin import ConfigError, MissingLibraryError, registry
from tactile_loc.plugin.helpers import did_you_mean

SUITES, SPLITS = "suites", "objects.toml"
OWN = __name__.partition(".")[0]
MOST_TOUCHES = 20  # that are located together
HERE = "data:"  # a path of a mesh or of recordings that begins with this word is in the folder `data` of a suite


class SuiteEntry(BaseModel):
    """A touch source or a method of a suite: a component with its options, and a `label` for tables."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    label: str
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _unfold(cls, value: Any) -> Any:
        """Accept "icp" and {name = "icp", label = "ICP", starts = 30} as well as the full form."""
        table = {"name": value} if isinstance(value, str) else dict(value) if isinstance(value, Mapping) else value
        if isinstance(table, dict) and "options" not in table:
            label = table.pop("label", table.get("name"))
            name = table.pop("name", None)
            return {"name": name, "label": label, "options": table}
        return table


class SuiteObject(BaseModel):
    """An object of a suite: the name of a demo object or a mesh file, with its units and its symmetry."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str
    units: Units = "auto"
    symmetry: str = "auto"


class Suite(BaseModel):
    """What a benchmark measures.

    Each source draws `examples` examples of each object, with as many touches as the largest number of `touches`. Every
    method locates an example from its first n touches, for each n of `touches`. Presses are drawn uniformly between the
    shares `press` of the sensor's deepest press. `seed` fixes all random choices. `data` is the folder of recordings
    and further meshes.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(description="a text")
    summary: str = Field(default="", description="a text")
    objects: tuple[SuiteObject, ...] = Field(min_length=1, description="a list of objects, or the name of a split")
    touches: tuple[int, ...] = Field(min_length=1, description=f"a list of whole numbers, 1 to {MOST_TOUCHES}")
    examples: int = Field(ge=1, description="a whole number, 1 or more")
    seed: int = Field(ge=0, description="a whole number, 0 or more")
    press: tuple[float, float] = Field(default=(0.3, 0.9), description="two shares of the deepest press, 0 to 1")
    data: Path | None = Field(default=None, description="a folder")
    source: tuple[SuiteEntry, ...] = Field(min_length=1, description="one or more tables [[source]]")
    method: tuple[SuiteEntry, ...] = Field(min_length=1, description="one or more tables [[method]]")

    @classmethod
    def from_toml(cls, suite: str | Path, data: Path | None = None) -> Self:
        """Read a suite by its name, or from a TOML file. `data` is the folder of paths that begin with `HERE`.

        Raises ConfigError for a file that is missing or wrong, and PluginError for a component that cannot be used. A
        component whose library is missing is no error.
        """
        path = _find_suite(suite)
        return cls.from_values(_read_toml(path), str(path), data)

    @classmethod
    def from_values(cls, values: Mapping[str, Any], source: str, data: Path | None = None) -> Self:
        """Make a suite from the values of a TOML file. `source` names the file in messages."""
        values = {**values, "data": data}
        try:
            values["objects"] = _read_objects(values.get("objects"), data)
            suite = cls(**values)
        except ValidationError as error:
            raise ConfigError(f"{source}: {_explain(error, values)}") from error
        except ConfigError as error:
            raise ConfigError(f"{source}: {error}") from error
        if not all(1 <= n <= MOST_TOUCHES for n in suite.touches):
            numbers = list(suite.touches)
            raise ConfigError(f"{source}: touches = {numbers} is wrong; give numbers from 1 to {MOST_TOUCHES}")
        if not 0 < suite.press[0] <= suite.press[1] <= 1:
            raise ConfigError(f"{source}: press = {list(suite.press)} is wrong; give two shares, 0 to 1, in order")
        for kind, entries in (("touch-source", suite.source), ("method", suite.method)):
            _require_entries(kind, entries, source)
        return suite

    def select(self, sources: Iterable[str] | None = None, methods: Iterable[str] | None = None) -> Suite:
        """Return the suite with only some sources and methods, by label. A component's name adds that component.

        Raises UnknownPluginError if a word is neither a label nor a component's name, and ConfigError if an added
        component needs options.
        """
        return self.model_copy(
            update={
                "source": self.source if sources is None else _choose("touch-source", self.source, sources),
                "method": self.method if methods is None else _choose("method", self.method, methods),
            }
        )

    def describe_protocol(self) -> dict[str, Any]:
        """Return what determines the touches of a source, besides the source and the objects, as JSON values."""
        return self.model_dump(mode="json", include={"touches", "examples", "seed", "press"})


def list_suites() -> list[str]:
    """Return the names of the suites that come with tactile-loc."""
    folder = files(__package__) / SUITES
    names = [file.name for file in folder.iterdir() if file.name.endswith(".toml") and file.name != SPLITS]
    return sorted(name.removesuffix(".toml") for name in names)


def read_split(name: str) -> list[Any]:
    """Return the objects of a split, as written in the file of splits. Raises ConfigError for another name."""
    splits = _read_toml(Path(str(files(__package__) / SUITES / SPLITS)))
    if name not in splits:
        raise ConfigError(f"there is no split {name!r}.{did_you_mean(name, splits)} Known: {', '.join(splits)}")
    return list(splits[name])


def _find_suite(suite: str | Path) -> Path:
    known = list_suites()
    if str(suite) in known:
        return Path(str(files(__package__) / SUITES / f"{suite}.toml"))
    if "/" in str(suite) or str(suite).endswith(".toml"):
        return Path(suite)
    raise ConfigError(f"there is no suite {str(suite)!r}.{did_you_mean(str(suite), known)} Known: {', '.join(known)}")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror}); check the path") from error
    except ValueError as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error


def _explain(error: ValidationError, values: Mapping[str, Any]) -> str:
    """Return a sentence about the first wrong key of a suite; unknown keys come before wrong values."""
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    key, known = str(problems[0]["loc"][0]), Suite.model_fields
    if key not in known:
        return f"a suite has no key {key!r}.{did_you_mean(key, known)} Known: {', '.join(known)}"
    fault = f"{key} = {values[key]!r} is wrong" if key in values else f"{key} is missing"
    return f"{fault}; it must be {known[key].description}"


def _read_objects(entries: Any, data: Path | None) -> Any:
    """Return the tables of objects, given a list or the name of a split. Objects need `data` if they are in it."""
    listed = read_split(entries) if isinstance(entries, str) else entries
    if not isinstance(listed, list):
        return listed
    return [_locate_object(entry if isinstance(entry, Mapping) else {"path": entry}, data) for entry in listed]


def _locate_object(table: Mapping[str, Any], data: Path | None) -> dict[str, Any]:
    path = str(table.get("path", ""))
    if path.startswith(HERE):
        path = find_in_data(path, data)
    elif path and path not in DEMO_OBJECTS:
        own = files(__package__) / SUITES / path
        path = str(own) if own.is_file() else str(Path(path).expanduser().absolute())
    return {**table, "path": path}


def find_in_data(path: str, data: Path | None) -> str:
    """Return the absolute path of a path that begins with `HERE`. Raises ConfigError without a folder `data`."""
    if data is None:
        raise ConfigError(f"{path} is in the folder `data` of the benchmark; give this folder")
    return str(data.expanduser().absolute() / path.removeprefix(HERE))


def _require_entries(kind: str, entries: Iterable[SuiteEntry], source: str) -> None:
    """Raise TactileLocError if a component is unknown or an option is wrong; a missing library is no error."""
    labels: set[str] = set()
    for entry in entries:
        if entry.label in labels:
            raise ConfigError(f"{source}: two entries are called {entry.label!r}; give each {kind} a label of its own")
        labels.add(entry.label)
        try:
            with suppress(MissingLibraryError):
                create(kind, entry)
        except TactileLocError as error:
            raise type(error)(f"{source}: {error}") from error


def _choose(kind: str, entries: Iterable[SuiteEntry], words: Iterable[str]) -> tuple[SuiteEntry, ...]:
    known = {entry.label: entry for entry in entries}
    chosen = []
    for word in words:
        entry = known.get(word) or SuiteEntry(name=word, label=word)
        try:
            _require_entries(kind, [entry], "the benchmark")
        except TactileLocError as error:
            raise type(error)(f"{error}. Labels in the suite: {', '.join(known)}") from error
        chosen.append(entry)
    return tuple({entry.label: entry for entry in chosen}.values())


def hash_shortly(values: Mapping[str, Any]) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of JSON values."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def create(kind: str, entry: SuiteEntry) -> Any:
    """Return the component of an entry. Raises TactileLocError if it cannot be made."""
    return registry().create(kind, entry.name, entry.options)
