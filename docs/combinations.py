#!/usr/bin/env python3
"""The table of refused combinations of components in docs/plugins.md, from the rules and the components' declarations.

Run it to renew the table.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from tactile_loc.slots.compatibility import INCOMPATIBILITIES, Declared
from tactile_loc.slots.registry import BUILT_IN, registry

PAGE = Path(__file__).parent / "plugins.md"
TABLE = re.compile(r"(?<=<!-- combinations -->\n).*?(?=<!-- /combinations -->)", re.DOTALL)
HEAD = "| declared | and declared | why it is refused | what to do |\n|---|---|---|---|\n"


def table() -> str:
    """Return the table. Each rule has a row with the built-in components to which the rule applies."""
    rows = [f"| {_side(r.first)} | {_side(r.second)} | {r.reason} | {r.advice} |\n" for r in INCOMPATIBILITIES]
    return HEAD + "".join(rows)


def _side(declared: Declared) -> str:
    names = ", ".join(f"`{name}`" for name in _declaring(declared)) or "no built-in one"
    return f"{declared.slot}: `{declared}` ({names})"


def _declaring(declared: Declared) -> Iterator[str]:
    """Yield the built-in components that declare this, with the option if the declaration depends on an option."""
    for found in registry().components:
        if found.distribution == BUILT_IN and found.spec.slot == declared.slot:
            kind = registry().load(found.spec.slot, found.spec.name)
            holding = [options for options in _choices(kind) if declared.holds(kind(kind.Options(**options)))]
            if {} in holding:
                yield found.spec.name
            else:
                yield from (f"{found.spec.name} {key}={value}" for one in holding for key, value in one.items())


def _choices(kind: Any) -> Iterator[dict[str, Any]]:
    """Yield the default options, and then each other choice of an option with named values."""
    yield {}
    for name, field in kind.Options.model_fields.items():
        yield from ({name: value} for value in get_args(field.annotation) if isinstance(value, str))


def main() -> None:
    """Write the table into the page."""
    text = PAGE.read_text(encoding="utf-8")
    if not TABLE.search(text):
        sys.exit(f"{PAGE} has no place for the table")
    PAGE.write_text(TABLE.sub(lambda _: table(), text), encoding="utf-8")


if __name__ == "__main__":
    main()
