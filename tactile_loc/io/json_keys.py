"""The keys of JSON documents: each has a type and a meaning, which the documentation lists. Nouns give the values."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

OR_NULL = " or null"


@dataclass(frozen=True)
class Key:
    """A key of a document: the type of its value, a key of TYPES with or without " or null", and its meaning."""

    type: str
    meaning: str


Keys = Mapping[str, Key]


def write_keys(keys: Keys, noun: object, **others: Any) -> dict[str, Any]:
    """Return a document with the values of `keys`: those in `others`, or else the attributes of these names."""
    return {name: make_json(others[name] if name in others else getattr(noun, name)) for name in keys}


def make_json(value: Any) -> Any:
    """Return a value as plain JSON: arrays and tuples as lists, numbers that are not finite as null, others as text."""
    if isinstance(value, (np.ndarray, np.generic)):
        if value.dtype.kind in "fiub" and np.isfinite(value).all():
            return value.tolist()
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(name): make_json(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [make_json(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else str(value)


def read_keys(keys: Keys, document: Any, where: str = "") -> dict[str, Any]:
    """Return the values of `keys` in a document; `where` is the document's place in the file.

    Raises ValueError, which names the place, if a key is missing or unknown, or a value has another type.
    """
    prefix = f"{where}." if where else ""
    if not isinstance(document, dict):
        raise ValueError(f"{where or 'the document'} must be an object")
    if unknown := sorted(document.keys() - keys.keys()):
        raise ValueError(f"{prefix}{unknown[0]} is unknown")
    found = {}
    for name, key in keys.items():
        if name not in document:
            raise ValueError(f"{prefix}{name} is missing")
        value, kind = document[name], key.type.removesuffix(OR_NULL)
        if not (value is None and kind != key.type) and not TYPES[kind](value):
            raise ValueError(f"{prefix}{name} must be {key.type}")
        found[name] = value
    return found


def describe_keys(keys: Keys) -> str:
    """Return a table of keys in Markdown: names, types and meanings."""
    rows = [f"| `{name}` | {key.type} | {key.meaning} |" for name, key in keys.items()]
    return "\n".join(["| key | type | meaning |", "|---|---|---|", *rows, ""])


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, float) and math.isfinite(value))


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_number, value))


def _has_rows(count: int) -> Callable[[Any], bool]:
    """Return a check of whether a value is a list of `count` lists of `count` numbers."""
    return lambda value: (
        isinstance(value, list) and len(value) == count and all(_is_numbers(row) and len(row) == count for row in value)
    )


TYPES: dict[str, Callable[[Any], bool]] = {
    "integer": _is_integer,
    "number": _is_number,
    "numbers": _is_numbers,
    "4 x 4 numbers": _has_rows(4),
    "6 x 6 numbers": _has_rows(6),
    "text": lambda value: isinstance(value, str),
    "texts": lambda value: isinstance(value, list) and all(isinstance(one, str) for one in value),
    "true or false": lambda value: isinstance(value, bool),
    "list": lambda value: isinstance(value, list),
    "object": lambda value: isinstance(value, dict),
}
