"""The page of a report: one HTML file that works offline and contacts no server. If it has plots, it includes plotly.

The page of a live run is the only exception: it contacts the server that sent it.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.runtime.formatting import show_bytes

if TYPE_CHECKING:
    from jinja2 import Environment

OWN = "tactile_loc.reports"
JSON_OPTIONS: dict[str, Any] = {"separators": (",", ":"), "allow_nan": False}


@dataclass(frozen=True)
class Section:
    """A part of a page. Both its anchor and the template's macro that shows `values` are called `name`."""

    name: str
    heading: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Page:
    """The content of a report.

    `title` and `about` are plain text. `scripts` are names of assets that draw plots with plotly; `data` are
    JSON values for these scripts.
    The template in templates/`template`.html.j2 has a macro for each section. The template and the scripts are in the
    folders `templates` and `assets` of the `package`, or in those of this package. If `connects` is true, the page may
    contact its server.
    """

    template: str
    title: str
    about: str
    sections: Sequence[Section]
    data: Any
    scripts: Sequence[str]
    connects: bool = False
    package: str = OWN


def render(page: Page) -> str:
    """Return the page as HTML. Raises ValueError if a number in the page's data is not finite."""
    drawing = ["plotly.min.js"] if page.scripts else []
    scripts = [read_asset(name, page.package) for name in (*drawing, "page.js", *page.scripts)]
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    template = load_templates(page.package).get_template("page.html.j2")
    return show_bytes(template.render(page=page, style=read_asset("page.css"), scripts=scripts, hashes=hashes))


@cache
def load_templates(package: str = OWN) -> Environment:
    """Return the templates of this package and of another one. They escape all texts from files and users."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((OWN, package))])
    found = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True)
    found.policies["json.dumps_kwargs"] = JSON_OPTIONS
    return found


def read_asset(name: str, package: str = OWN) -> str:
    """Return the text of a script or style sheet of a package, or of this package if the other has none."""
    file = resources.files(package).joinpath("assets", name)
    return (file if file.is_file() else resources.files(OWN).joinpath("assets", name)).read_text(encoding="utf-8")


@contextmanager
def name_damage(path: Path) -> Iterator[None]:
    """Turn the errors that a damaged document causes into a ResultError."""
    try:
        yield
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, StopIteration) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise ResultError(f"{path} is damaged or incomplete: {reason}; make the result again") from error
