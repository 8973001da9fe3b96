"""Hooks of mkdocs that name files outside the site, and warn if the API reference documents a name twice.

mkdocs itself warns only if a page links to such a name. Names of the API are the anchors with a dot, as in
`tactile_loc.Touch`. Anchors of headings have no dot.
"""

import logging
import re
from typing import Any

LOG = logging.getLogger("mkdocs.hooks.site_checks")  # a logger below mkdocs, because --strict counts its warnings
ANCHOR = re.compile(r'\sid="([^"]+\.[^"]+)"')

_page_of: dict[str, str] = {}  # the first page that documents a name


def on_pre_build(**_: Any) -> None:
    """Forget the names of the previous build, because `mkdocs serve` builds many times."""
    _page_of.clear()


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace each link to a file outside the site by the link's text and the file's path in the repository."""
    above = "../" * (page.file.src_uri.count("/") + 1)
    return re.sub(rf"\[([^\]]+)\]\({re.escape(above)}([^)#]+)[^)]*\)", r"\1 (`\2`)", markdown)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Warn of each name that another page already documents. Members of such a name give no warning."""
    here, twice = page.file.src_uri, {}
    for name in ANCHOR.findall(output):
        if name in _page_of:
            twice[name] = _page_of[name]
        else:
            _page_of[name] = here
    for name, first in twice.items():
        if name.rpartition(".")[0] not in twice:
            LOG.warning("Doc file '%s' documents '%s', which '%s' documents already.", here, name, first)
    return output
