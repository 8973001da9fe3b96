#!/usr/bin/env python3
"""The tables of the tunable options in docs/tuning.md.

Options come from their models. The last cell of a row, the effect of a larger value, is written by hand in the page.
Run this script to renew the tables.
"""

import re
import sys
from pathlib import Path

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from tactile_loc.io.options import TUNABLE, HypothesisOptions, SearchOptions, TrackerOptions

TUNING = Path(__file__).parent / "tuning.md"
MODELS: dict[str, type[BaseModel]] = dict(zip(TUNABLE, (SearchOptions, HypothesisOptions, TrackerOptions), strict=True))
MARKER = re.compile(r"<!-- options: (\w+) -->\n(.*?)<!-- /options -->\n", re.DOTALL)
ROW = re.compile(r"^\| `(?P<option>[\w.]+)` \|.*\| (?P<effect>[^|]*) \|$", re.MULTILINE)
HEAD = "| option | default | range | meaning | effect of a larger value |\n|---|---|---|---|---|\n"


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


def main() -> None:
    """Renew the tables. Raises SystemExit if a page describes an option that no longer exists."""
    tuning = TUNING.read_text(encoding="utf-8")
    if gone := sorted(set(read_effects(tuning)) - options()):
        sys.exit(f"{TUNING} describes options that are gone: {', '.join(gone)}; rename or delete their rows")
    TUNING.write_text(with_tables(tuning), encoding="utf-8")


if __name__ == "__main__":
    main()
