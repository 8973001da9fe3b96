"""Reading what people write: lists, numbers, and `slot.option=value,value`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tactile_loc.core.errors import ConfigError
from tactile_loc.io.config import parse_overrides

Options = dict[str, dict[str, list[Any]]]

_OPENING, _CLOSING = "[{(", "]})"


def split_values(text: str) -> list[str]:
    """Split "a,b" at its commas, but not within brackets or quotes; empty parts are dropped."""
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
    """Return the values of a flag that may be repeated, and hold several values each time."""
    return [value for word in words for value in split_values(word)]


def as_list(value: Any, key: str, source: str) -> list[Any]:
    """Return the values of a key: a list's, or the one that stands alone. Raises ConfigError for an empty list."""
    values = value if isinstance(value, list) else [value]
    if not values:
        raise ConfigError(f"{source} has no value for {key!r}; give one, or leave the entry out")
    return values


def whole_numbers(value: Any, key: str, source: str, least: int) -> tuple[int, ...]:
    """Return whole numbers, each once. Raises ConfigError for anything else, or one below `least`."""
    found = []
    for entry in as_list(value, key, source):
        is_number = isinstance(entry, int) and not isinstance(entry, bool)
        if not (is_number or (isinstance(entry, str) and entry.strip().isdecimal())) or int(entry) < least:
            raise ConfigError(f"{source} has {key} = {entry!r}; it must be a whole number, {least} or more")
        found.append(int(entry))
    return tuple(dict.fromkeys(found))


def read_options(given: Any, source: str) -> Options:
    """Return {slot: {option: values}} from words "slot.option=value,value" or from such a table.

    Words of the same option add up. Raises ConfigError for another form or an unknown slot.
    """
    if isinstance(given, dict):
        return _from_table(given, source)
    found: Options = {}
    for word in as_list(given, "option", source) if given else []:
        target, equals, text = str(word).partition("=")
        values = split_values(text) if equals else []
        read = [parse_overrides([f"{target}={value}"]) for value in values] or [parse_overrides([str(word)])]
        for slot, options in read[0].items():
            for option in options:
                found.setdefault(slot, {}).setdefault(option, []).extend(one[slot][option] for one in read)
    return found


def merge_options(first: Options, second: Options) -> Options:
    """Return the options of both; where both have one, the second's values."""
    return {slot: {**first.get(slot, {}), **second.get(slot, {})} for slot in {**first, **second}}


def _from_table(table: dict[str, Any], source: str) -> Options:
    found: Options = {}
    for slot, options in table.items():
        if not isinstance(options, dict):
            raise ConfigError(f"{source} has option.{slot} = {options!r}; write it as option.grid.spacing_mm = [3, 4]")
        parse_overrides(f"{slot}.{option}=0" for option in options)  # refuses a slot that is none
        found[slot] = {option: as_list(values, f"option.{slot}.{option}", source) for option, values in options.items()}
    return found
