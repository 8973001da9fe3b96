"""The choices of a slot: components with all their options, each once, and which of the options tell them apart."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from tactile_loc.core.registry import registry, validate_options
from tactile_loc.io.config import SlotConfig
from tactile_loc.store.keys import canonical_json


def expand(slot: str, named: Sequence[SlotConfig], options: Mapping[str, Sequence[Any]]) -> tuple[SlotConfig, ...]:
    """Return every component with every combination of the option values, all options resolved, each choice once.

    An option goes to the components that have it; one that none has is refused. Raises PluginError or ConfigError.
    """
    known = {chosen.name: set(registry().load(slot, chosen.name).Options.model_fields) for chosen in named}
    foreign = [option for option in options if not any(option in fields for fields in known.values())]
    if foreign:  # of the first component, whose error names the options that it has
        _resolved(slot, named[0].name, {foreign[0]: options[foreign[0]][0]})
    found: dict[str, SlotConfig] = {}
    for chosen in named:
        own = {option: values for option, values in options.items() if option in known[chosen.name]}
        for values in itertools.product(*own.values()):
            choice = _resolved(slot, chosen.name, {**chosen.options, **dict(zip(own, values, strict=True))})
            found.setdefault(canonical_json(choice.model_dump()), choice)
    return tuple(found.values())


def varied_options(choices: Sequence[SlotConfig]) -> list[str]:
    """Return the options that tell choices of the same component apart, in the order of its options."""
    varied: dict[str, None] = {}
    for chosen in choices:
        twins = [other for other in choices if other.name == chosen.name]
        for option, value in chosen.options.items():
            if any(other.options[option] != value for other in twins):
                varied[option] = None
    return list(varied)


def label(chosen: SlotConfig, varied: Sequence[str]) -> str:
    """Name a choice: its component, and those of its options that vary."""
    shown = [f"{option}={_short(chosen.options[option])}" for option in varied if option in chosen.options]
    return " ".join([chosen.name, *shown])


def _resolved(slot: str, name: str, options: Mapping[str, Any]) -> SlotConfig:
    complete = validate_options(registry().load(slot, name).Options, options, f"{slot} {name!r}")
    return SlotConfig(name=name, options=complete.model_dump(mode="json"))


def _short(value: Any) -> str:
    if isinstance(value, str):
        return PurePath(value).name if "/" in value else value
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)
