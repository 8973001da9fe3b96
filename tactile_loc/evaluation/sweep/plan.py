"""The plan of a sweep: several values for each key, from a TOML file, the command line, or both."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from tactile_loc.core.runtime.errors import ConfigError, did_you_mean, name_source, quote
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.io.config import (
    COMMAND_LINE,
    LISTED,
    ObjectConfig,
    RunConfig,
    SlotConfig,
    choose_component,
    find_sensor_kind,
    parse_overrides,
)
from tactile_loc.io.toml import read_toml
from tactile_loc.slots.options import validate_options
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc.store.keys import write_canonical_json

SETTINGS = ("shape_px", "temperature")  # the same for all combinations of a sweep
KEYS = ("object", *SLOTS, "noise", "seed", "count", "option", *SETTINGS)
DEFAULT_COUNT, DEFAULT_NOISE = 150, "strong"


@dataclass(frozen=True)
class Plan:
    """The values of everything that a sweep varies; the sweep evaluates all their combinations.

    `slots` has the choices of each slot with all their options. Each combination is evaluated on `count` simulated
    touches, with the same `settings` (RunConfig's SETTINGS).
    """

    objects: tuple[ObjectConfig, ...]
    slots: Mapping[str, tuple[SlotConfig, ...]]
    noises: tuple[str, ...] = (DEFAULT_NOISE,)
    seeds: tuple[int, ...] = (0,)
    count: int = DEFAULT_COUNT
    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, path: str | Path) -> Plan:
        """Read a plan from a TOML file; see `from_values`."""
        with name_source(path):
            return cls.from_values(read_toml(path), str(path))

    @classmethod
    def from_values(cls, values: Mapping[str, Any], source: str = "the plan") -> Plan:
        """Make a plan from one value or a list of values for each of KEYS.

        Missing keys have the defaults of an evaluation: all demo objects, each slot's default, strong noise, seed 0.
        Raises ConfigError or PluginError, which name `source`, for unknown entries or values of a wrong type.
        """
        with nullcontext() if source == COMMAND_LINE else name_source(source):
            return cls._read(values, source)

    @classmethod
    def _read(cls, values: Mapping[str, Any], source: str) -> Plan:
        for key in values:
            if key not in KEYS:
                near = did_you_mean(key, KEYS)
                raise ConfigError(f"{source} has an unknown entry {key!r}.{near} Known: {', '.join(KEYS)}")
        options = read_options(values.get("option", []), source)
        noises = list(map(str, list_values(values.get("noise", DEFAULT_NOISE), "noise", source)))
        for noise in noises:
            make_noise(noise)  # raises ConfigError for an unknown noise
        counts = read_whole_numbers(values.get("count", DEFAULT_COUNT), "count", source, least=1)
        if len(counts) > 1:
            raise ConfigError(f"{source} has several values for 'count'; give one for all combinations")
        config = RunConfig.from_dict({key: values[key] for key in SETTINGS if key in values}, source)
        return cls(
            objects=_read_objects(list_values(values.get("object", list(DEMO_OBJECTS)), "object", source), source),
            slots={slot: _read_choices(slot, values, options.get(slot, {}), source) for slot in SLOTS},
            noises=tuple(dict.fromkeys(noises)),
            seeds=read_whole_numbers(values.get("seed", 0), "seed", source, least=0),
            count=counts[0],
            settings={key: getattr(config, key) for key in SETTINGS},
        )

    def describe(self) -> dict[str, Any]:
        """Return the plan as JSON values: every choice with all its options."""
        return {
            "object": [chosen.model_dump(mode="json") for chosen in self.objects],
            **{slot: [chosen.model_dump(mode="json") for chosen in choices] for slot, choices in self.slots.items()},
            "noise": list(self.noises),
            "seed": list(self.seeds),
            "count": self.count,
            **self.settings,
        }


def _read_objects(entries: Sequence[Any], source: str) -> tuple[ObjectConfig, ...]:
    """Return the objects without duplicates; paths become absolute, since workers may run in another folder."""
    found = []
    for entry in entries:
        table = entry if isinstance(entry, dict) else {"path": entry}
        if not table.get("path"):
            raise ConfigError(f"{source} has an object without a path, {entry!r}; write a name or {{path = ...}}")
        chosen: ObjectConfig = validate_options(ObjectConfig, table, f"the object of {source}")
        if chosen.path not in DEMO_OBJECTS or os.path.isfile(chosen.path):
            chosen = chosen.model_copy(update={"path": str(Path(chosen.path).expanduser().absolute())})
        found.append(chosen)
    return tuple(dict.fromkeys(found))


def _read_choices(slot: str, values: Mapping[str, Any], options: Mapping[str, list[Any]], source: str) -> Any:
    default = LISTED.name if slot == "grid" else choose_component(slot, LISTED.name).name
    named = [_read_component(slot, entry, source) for entry in list_values(values.get(slot, default), slot, source)]
    return expand(slot, named, options)


def _read_component(slot: str, entry: Any, source: str) -> SlotConfig:
    if isinstance(entry, str):
        entry = {"name": entry}
    if not (isinstance(entry, dict) and isinstance(entry.get("name"), str)):
        raise ConfigError(f"{source} has {slot} = {entry!r}; write a name, or a table with name and options")
    chosen = SlotConfig(name=entry["name"], options={k: v for k, v in entry.items() if k != "name"})
    return _resolve_sensor(chosen) if slot == "sensor" else chosen


def _resolve_sensor(chosen: SlotConfig) -> SlotConfig:
    """Resolve a sensor's name, or the path of its description or calibration, which becomes absolute."""
    path = chosen.options.get("path")
    if kind := find_sensor_kind(chosen.name):
        path = chosen.name
        chosen = SlotConfig(name=kind, options=chosen.options)
    if isinstance(path, str):
        absolute = str(Path(path).expanduser().absolute())
        chosen = SlotConfig(name=chosen.name, options={**chosen.options, "path": absolute})
    return chosen


def expand(slot: str, named: Sequence[SlotConfig], options: Mapping[str, Sequence[Any]]) -> tuple[SlotConfig, ...]:
    """Return every component with every combination of the option values, without duplicates.

    All options get their full values. An option applies to the components that have it. Raises PluginError or
    ConfigError, also for an option that no component has.
    """
    known = {chosen.name: set(registry().load(slot, chosen.name).Options.model_fields) for chosen in named}
    foreign = [option for option in options if not any(option in fields for fields in known.values())]
    if foreign:
        _resolve(slot, named[0].name, {foreign[0]: options[foreign[0]][0]})  # raises, naming the known options
    found: dict[str, SlotConfig] = {}
    for chosen in named:
        own = {option: values for option, values in options.items() if option in known[chosen.name]}
        for values in itertools.product(*own.values()):
            choice = _resolve(slot, chosen.name, {**chosen.options, **dict(zip(own, values, strict=True))})
            found.setdefault(write_canonical_json(choice.model_dump()), choice)
    return tuple(found.values())


def find_varied_options(choices: Sequence[SlotConfig]) -> list[str]:
    """Return the options that differ between choices of the same component, in the order of its options."""
    varied: dict[str, None] = {}
    for chosen in choices:
        twins = [other for other in choices if other.name == chosen.name]
        for option, value in chosen.options.items():
            if any(other.options[option] != value for other in twins):
                varied[option] = None
    return list(varied)


def name_choice(chosen: SlotConfig, varied: Sequence[str]) -> str:
    """Name a choice by its component and its varied options."""
    shown = [f"{option}={_shorten(chosen.options[option])}" for option in varied if option in chosen.options]
    return " ".join([chosen.name, *shown])


def name_choices(plan: Plan) -> dict[str, list[str]]:
    """Return the name of each choice of each slot, with its varied options."""
    return {
        slot: [name_choice(one, find_varied_options(choices)) for one in choices]
        for slot, choices in plan.slots.items()
    }


def find_varying_slots(plan: Plan) -> list[str]:
    """Return the slots that have several choices."""
    return [slot for slot, choices in plan.slots.items() if len(choices) > 1]


def _resolve(slot: str, name: str, options: Mapping[str, Any]) -> SlotConfig:
    complete = validate_options(registry().load(slot, name).Options, options, f"the {slot} {name!r}")
    return SlotConfig(name=name, options=complete.model_dump(mode="json"))


def _shorten(value: Any) -> str:
    if isinstance(value, str):
        return show_name(PurePath(value).name if "/" in value else value)
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)


Options = dict[str, dict[str, list[Any]]]

_OPENING, _CLOSING = "[{(", "]})"


def split_values(text: str) -> list[str]:
    """Split "a,b" at commas outside brackets and quotes; drop empty parts."""
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        depth += 0 if quote else (character in _OPENING) - (character in _CLOSING)
        if character == "," and depth <= 0 and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def split_all(words: Iterable[str]) -> list[str]:
    """Return the values of a repeatable flag; each word may have several values."""
    return [value for word in words for value in split_values(word)]


def list_values(value: Any, key: str, source: str) -> list[Any]:
    """Return the values of a key as a list. Raises ConfigError for an empty list."""
    values = value if isinstance(value, list) else [value]
    if not values:
        raise ConfigError(f"{source} has no value for {key!r}; give one, or leave the entry out")
    return values


def read_whole_numbers(value: Any, key: str, source: str, least: int) -> tuple[int, ...]:
    """Return whole numbers without duplicates. Raises ConfigError for other values, or numbers below `least`."""
    found = []
    for entry in list_values(value, key, source):
        if not _is_number(entry) or int(entry) < least:
            shown = entry if _is_number(entry) else quote(entry)
            name = f"`{key}`" if source == COMMAND_LINE else f"{source}: {key}"
            raise ConfigError(f"{name} cannot be {shown}; give a whole number, {least} or more")
        found.append(int(entry))
    return tuple(dict.fromkeys(found))


def _is_number(entry: Any) -> bool:
    """Whether an entry is a whole number, or the text of one."""
    if isinstance(entry, str):
        return entry.strip().removeprefix("-").isdecimal()
    return isinstance(entry, int) and not isinstance(entry, bool)


def read_options(given: Any, source: str) -> Options:
    """Return {slot: {option: values}} from words "slot.option=value,value", or from a table of this form.

    The values of repeated options are joined. Raises ConfigError for another form or an unknown slot.
    """
    if isinstance(given, dict):
        return _read_table(given, source)
    found: Options = {}
    for word in list_values(given, "option", source) if given else []:
        target, equals, text = str(word).partition("=")
        values = split_values(text) if equals else []
        read = [parse_overrides([f"{target}={value}"]) for value in values] or [parse_overrides([str(word)])]
        for slot, options in read[0].items():
            for option in options:
                found.setdefault(slot, {}).setdefault(option, []).extend(one[slot][option] for one in read)
    return found


def merge_options(first: Options, second: Options) -> Options:
    """Return the options of both; where both have an option, the values of `second` count."""
    return {slot: {**first.get(slot, {}), **second.get(slot, {})} for slot in {**first, **second}}


def _read_table(table: dict[str, Any], source: str) -> Options:
    found: Options = {}
    for slot, options in table.items():
        if not isinstance(options, dict):
            raise ConfigError(f"{source} has option.{slot} = {options!r}; write it as option.grid.spacing_mm = [3, 4]")
        parse_overrides(f"{slot}.{option}=0" for option in options)  # raises ConfigError for an unknown slot
        found[slot] = {
            option: list_values(values, f"option.{slot}.{option}", source) for option, values in options.items()
        }
    return found
