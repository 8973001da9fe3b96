"""The page: one HTML file with everything in it, plotly included. It works offline and asks no server for anything."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from tactile_loc.reports.markup import escape, script_json

# What the browser may load: nothing. Scripts run only if they are the ones that were put here.
POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; "
    "base-uri 'none'; form-action 'none'; script-src {hashes}"
)


@dataclass(frozen=True)
class Section:
    """A part of the page: its anchor, its heading, and what is in it, as HTML."""

    name: str
    heading: str
    body: str


@dataclass(frozen=True)
class Page:
    """A report. `title` and `about` are plain text; `data` are JSON values for `scripts`, names of assets."""

    title: str
    about: str
    sections: Sequence[Section]
    data: Any
    scripts: Sequence[str]


def render(page: Page) -> str:
    """Return the page as HTML."""
    from plotly.offline import get_plotlyjs

    scripts = [get_plotlyjs(), *(asset(name) for name in ("page.js", *page.scripts))]
    hashes = " ".join(_hash(script) for script in scripts)
    links = "".join(f'<a href="#part-{escape(s.name)}">{escape(s.heading)}</a>' for s in page.sections if s.heading)
    sections = "".join(_section(section) for section in page.sections)
    return "".join([
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY.format(hashes=hashes)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<title>{escape(page.title)}</title><link rel="icon" href="data:,"><style>{asset("page.css")}</style></head>',
        f'<body><header><div class="bar"><h1>{escape(page.title)}</h1>',
        '<button type="button" id="theme" aria-label="switch between light and dark">◐</button></div>',
        f'<p class="about">{escape(page.about)}</p><nav>{links}</nav></header><main>{sections}</main>',
        "<footer>made by tactile-loc; lengths in mm, angles in degrees</footer>",
        f'<script type="application/json" id="data">{script_json(page.data)}</script>',
        *(f"<script>{script}</script>\n" for script in scripts),
        "</body></html>\n",
    ])  # fmt: skip


def asset(name: str) -> str:
    """Return the text of a file that comes with the package."""
    return resources.files("tactile_loc.reports").joinpath("assets", name).read_text(encoding="utf-8")


def _section(section: Section) -> str:
    heading = f"<h2>{escape(section.heading)}</h2>" if section.heading else ""
    return f'<section id="part-{escape(section.name)}">{heading}{section.body}</section>'


def _hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
