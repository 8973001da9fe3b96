"""A configuration as the TOML that `--config` takes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(configuration: Mapping[str, Any]) -> str:
    """Return a resolved configuration as TOML; what is not set is left out. A slot's options stand beside its name."""
    plain = {key: value for key, value in configuration.items() if not isinstance(value, Mapping)}
    parts = [_lines(plain)] if plain else []
    for name, section in configuration.items():
        if isinstance(section, Mapping):
            options = section.get("options")
            flat = {k: v for k, v in section.items() if k != "options"}
            parts.append(f"[{name}]\n" + _lines({**flat, **(options if isinstance(options, Mapping) else {})}))
    return "\n".join(parts)


def _lines(values: Mapping[str, Any]) -> str:
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in values.items() if value is not None)


def _key(key: str) -> str:
    bare = key.replace("_", "").replace("-", "").isalnum() and key.isascii()
    return key if bare else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)
