"""The page that browsers load: viser's, with the title and the icon of tactile-loc, our style, and a number a visit.

The number is in the page's address. It leads a browser that loads the page again to its session.
"""

from __future__ import annotations

import gzip
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Self
from urllib.parse import parse_qs

_VISIT = re.compile(r"[0-9a-f]{32}")
TITLE = "tactile-loc"
ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E"
    "%3Crect width='32' height='32' rx='7' fill='%232d5f9b'/%3E"
    "%3Cpath d='M11 4h10v9a5 5 0 0 1-10 0z' fill='%23c9e4d6'/%3E"
    "%3Cpath d='M4 25q6-9 12-6t12 6' fill='none' stroke='%23e8590c' stroke-width='3.4' stroke-linecap='round'/%3E"
    "%3C/svg%3E"
)  # a finger over a surface
ASSETS = files("tactile_loc_app") / "assets"


@cache
def brand_page(page: bytes, is_gzipped: bool) -> bytes:
    """Return viser's page with our title, icon, style and script, gzipped as before."""
    text = (gzip.decompress(page) if is_gzipped else page).decode("utf-8")
    script, style = ((ASSETS / name).read_text("utf-8") for name in ("page.js", "page.css"))
    head = f"<title>{TITLE}</title><script>{script}</script><style>{style}</style>"
    text = text.replace("<title>Viser</title>", head, 1)
    text = re.sub(r'href="data:image/svg\+xml[^"]*"', f'href="{ICON}"', text, count=1)
    branded = text.encode("utf-8")
    return gzip.compress(branded) if is_gzipped else branded


@dataclass(frozen=True)
class Visit:
    """A browser's visit: its `number`, or "" if unknown. If it `is_again`, the same tab loads the page again."""

    number: str = ""
    is_again: bool = False

    @classmethod
    def read(cls, path: str) -> Self:
        """Return the visit that the path of a request states."""
        asked = parse_qs(path.partition("?")[2])
        (number,) = asked.get("visit", [""])[:1]
        return cls(number if _VISIT.fullmatch(number) else "", "again" in asked)
