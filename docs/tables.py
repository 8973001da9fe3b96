#!/usr/bin/env python3
"""The tables of docs/tuning.md (tunable options) and of docs/plugins.md (refused combinations of components).

Options come from their models. The last cell of a row, the effect of a larger value, is written by hand in the page.
Combinations come from the rules and the components' declarations. Run this script to renew the tables.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tactile_loc.io.options import TUNABLE, HypothesisOptions, SearchOptions, TrackerOptions
from tactile_loc.slots.compatibility import INCOMPATIBILITIES, Declared
from tactile_loc.slots.registry import BUILT_IN, registry

TUNING, PLUGINS = (Path(__file__).parent / f"{name}.md" for name in ("tuning", "plugins"))
MODELS: dict[str, type[BaseModel]] = dict(zip(TUNABLE, (SearchOptions, HypothesisOptions, TrackerOptions), strict=True))
MARKER = re.compile(r"<!-- options: (\w+) -->\n(.*?)<!-- /options -->\n", re.DOTALL)
ROW = re.compile(r"^\| `(?P<option>[\w.]+)` \|.*\| (?P<effect>[^|]*) \|$", re.MULTILINE)
HEAD = "| option | default | range | meaning | effect of a larger value |\n|---|---|---|---|---|\n"
REFUSED = re.compile(r"(?<=<!-- combinations -->\n).*?(?=<!-- /combinations -->)", re.DOTALL)
REFUSED_HEAD = "| declared | and declared | why it is refused | what to do |\n|---|---|---|---|\n"


def with_tables(page: str) -> str:
    """Return the page with the tables of the models. Raises KeyError if a table names an unknown model."""
    effects = read_effects(page)
    return MARKER.sub(lambda m: f"<!-- options: {m[1]} -->\n{tabulate_options(m[1], effects)}<!-- /options -->\n", page)


def read_effects(page: str) -> dict[str, str]:
    """Return the effect of each option of the page."""
    return {match["option"]: match["effect"].strip() for match in ROW.finditer(page)}


def tabulate_options(kind: str, effects: dict[str, str]) -> str:
    """Return the table of a model: a row for each option."""
    rows = []
    for name, field in MODELS[kind].model_fields.items():
        option = f"{kind}.{name}"
        cells = (f"`{option}`", f"{field.default:g}", _describe_range(field), str(field.description))
        rows.append(f"| {' | '.join(cells)} | {effects.get(option, '')} |\n")
    return HEAD + "".join(rows)


def _describe_range(field: FieldInfo) -> str:
    """Return the bounds of an option, such as ">= 1"."""
    signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
    bounds = ((signs[name], getattr(one, name, None)) for one in field.metadata for name in signs)
    return ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)


def options() -> set[str]:
    """Return the names of all options."""
    return {f"{kind}.{name}" for kind, model in MODELS.items() for name in model.model_fields}


def tabulate_combinations() -> str:
    """Return the table of refused combinations. Each rule has a row with the built-in components that it applies to."""
    rows = (
        f"| {_describe_side(r.first)} | {_describe_side(r.second)} | {r.reason} | {r.advice} |\n"
        for r in INCOMPATIBILITIES
    )
    return REFUSED_HEAD + "".join(rows)


def _describe_side(declared: Declared) -> str:
    names = ", ".join(f"`{name}`" for name in find_declaring(declared)) or "no built-in one"
    return f"{declared.slot}: `{declared}` ({names})"


def find_declaring(declared: Declared) -> Iterator[str]:
    """Yield the built-in components that declare this, with the option if the declaration depends on an option."""
    for found in registry().components:
        if found.distribution == BUILT_IN and found.spec.slot == declared.slot:
            kind = registry().load(found.spec.slot, found.spec.name)
            holding = [options for options in _list_choices(kind) if declared.holds(kind(kind.Options(**options)))]
            if {} in holding:
                yield found.spec.name
            else:
                yield from (f"{found.spec.name} {key}={value}" for one in holding for key, value in one.items())


def _list_choices(kind: Any) -> Iterator[dict[str, Any]]:
    """Yield the default options, and then each other choice of an option with named values."""
    yield {}
    for name, field in kind.Options.model_fields.items():
        yield from ({name: value} for value in get_args(field.annotation) if isinstance(value, str))


def main() -> None:
    """Renew the tables. Raises SystemExit if a page describes an option that no longer exists."""
    tuning, plugins = TUNING.read_text(encoding="utf-8"), PLUGINS.read_text(encoding="utf-8")
    if gone := sorted(set(read_effects(tuning)) - options()):
        sys.exit(f"{TUNING} describes options that are gone: {', '.join(gone)}; rename or delete their rows")
    TUNING.write_text(with_tables(tuning), encoding="utf-8")
    PLUGINS.write_text(REFUSED.sub(lambda _: tabulate_combinations(), plugins), encoding="utf-8")


if __name__ == "__main__":
    main()
