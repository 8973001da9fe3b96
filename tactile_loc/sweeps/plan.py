"""What a sweep is to try: several values for each key, from a TOML file, the command line, or both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import ConfigError, did_you_mean
from tactile_loc.core.noise import noise_level
from tactile_loc.core.registry import SLOTS, validate_options
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.io.config import ObjectConfig, RunConfig, SlotConfig, kind_of_sensor
from tactile_loc.io.toml import read_toml
from tactile_loc.sweeps.choices import expand
from tactile_loc.sweeps.words import as_list, read_options, whole_numbers

KEYS = ("object", *SLOTS, "noise", "seed", "count", "option", "shape_px", "temperature")
DEFAULT_COUNT, DEFAULT_NOISE = 150, "strong"


@dataclass(frozen=True)
class Plan:
    """The values of everything that a sweep varies; it evaluates their full product.

    `slots` holds the choices of each slot with all their options; `count` simulated touches are asked about for each
    combination. `shape_px` and `temperature` are RunConfig's, for all of them.
    """

    objects: tuple[ObjectConfig, ...]
    slots: Mapping[str, tuple[SlotConfig, ...]]
    noises: tuple[str, ...] = (DEFAULT_NOISE,)
    seeds: tuple[int, ...] = (0,)
    count: int = DEFAULT_COUNT
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, path: str | Path) -> Plan:
        """Read a plan's file; see `from_values`."""
        return cls.from_values(read_toml(path), str(path))

    @classmethod
    def from_values(cls, values: Mapping[str, Any], source: str = "the plan") -> Plan:
        """Make a plan of KEYS and one value or a list of values for each.

        What is left out is as in an evaluation: all demo objects, each slot's default, strong noise, seed 0. Raises
        ConfigError that names `source`, or PluginError, in one sentence, for whatever is unknown or ill-typed.
        """
        for key in values:
            if key not in KEYS:
                near = did_you_mean(key, KEYS)
                raise ConfigError(f"{source} has an unknown entry {key!r}.{near} Known: {', '.join(KEYS)}")
        options = read_options(values.get("option", []), source)
        return cls(
            objects=_objects(as_list(values.get("object", list(DEMO_OBJECTS)), "object", source), source),
            slots={slot: _choices(slot, values, options.get(slot, {}), source) for slot in SLOTS},
            noises=_noises(as_list(values.get("noise", DEFAULT_NOISE), "noise", source)),
            seeds=whole_numbers(values.get("seed", 0), "seed", source, least=0),
            count=_one(whole_numbers(values.get("count", DEFAULT_COUNT), "count", source, least=1), source),
            settings=_settings(values, source),
        )

    def describe(self) -> dict[str, Any]:
        """Return the plan as JSON values: every choice with all its options."""
        return {
            "object": [chosen.model_dump(mode="json") for chosen in self.objects],
            **{slot: [chosen.model_dump(mode="json") for chosen in choices] for slot, choices in self.slots.items()},
            "noise": list(self.noises), "seed": list(self.seeds), "count": self.count, **self.settings,
        }  # fmt: skip


def _objects(entries: Sequence[Any], source: str) -> tuple[ObjectConfig, ...]:
    """Objects without repetitions; paths are absolute, since workers may run elsewhere."""
    found = []
    for entry in entries:
        table = entry if isinstance(entry, dict) else {"path": entry}
        if not table.get("path"):
            raise ConfigError(f"{source} has an object without a path: {entry!r}; write a name or {{path = ...}}")
        chosen: ObjectConfig = validate_options(ObjectConfig, table, f"object of {source}")
        if chosen.path not in DEMO_OBJECTS or Path(chosen.path).is_file():
            chosen = chosen.model_copy(update={"path": str(Path(chosen.path).expanduser().absolute())})
        found.append(chosen)
    return tuple(dict.fromkeys(found))


def _choices(slot: str, values: Mapping[str, Any], options: Mapping[str, list[Any]], source: str) -> Any:
    default = RunConfig.model_fields[slot].default.name
    named = [_component(slot, entry, source) for entry in as_list(values.get(slot, default), slot, source)]
    return expand(slot, named, options)


def _component(slot: str, entry: Any, source: str) -> SlotConfig:
    if isinstance(entry, str):
        entry = {"name": entry}
    if not (isinstance(entry, dict) and isinstance(entry.get("name"), str)):
        raise ConfigError(f"{source} has the {slot} {entry!r}; write a name, or a table with name and options")
    chosen = SlotConfig(name=entry["name"], options={k: v for k, v in entry.items() if k != "name"})
    return _sensor(chosen) if slot == "sensor" else chosen


def _sensor(chosen: SlotConfig) -> SlotConfig:
    """A sensor by its name, or by the path of its description or calibration, which becomes absolute."""
    path = chosen.options.get("path")
    if kind := kind_of_sensor(chosen.name):
        path = chosen.name
        chosen = SlotConfig(name=kind, options=chosen.options)
    if isinstance(path, str):
        absolute = str(Path(path).expanduser().absolute())
        chosen = SlotConfig(name=chosen.name, options={**chosen.options, "path": absolute})
    return chosen


def _noises(values: Sequence[Any]) -> tuple[str, ...]:
    for value in values:
        noise_level(str(value))
    return tuple(dict.fromkeys(map(str, values)))


def _one(values: tuple[int, ...], source: str) -> int:
    if len(values) > 1:
        raise ConfigError(f"{source} has several counts; give one, so that all combinations are asked about the same")
    return values[0]


def _settings(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """The other settings of a run, as they are after validation."""
    given = {key: values[key] for key in ("shape_px", "temperature") if key in values}
    config = RunConfig.from_dict(given, source)
    return {"shape_px": config.shape_px, "temperature": config.temperature}
