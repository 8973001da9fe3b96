"""The start page offers a few links to each kind of reader, and the navigation has one tab for each kind of page."""

from __future__ import annotations

import re
from pathlib import Path

from site_helpers import read_settings

ROOT = Path(__file__).parents[1]
NAV = read_settings()["nav"]
CARDS = re.split(r"^-   ", (ROOT / "docs" / "index.md").read_text().split("</div>\n\n## Everything")[0], flags=re.M)[1:]


def list_pages(entry) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [page for child in (entry.values() if isinstance(entry, dict) else entry) for page in list_pages(child)]


def test_each_card_has_three_to_five_lines_of_links():
    titles = [re.search(r"\*\*(.+)\*\*", card)[1] for card in CARDS]
    assert titles == ["I have a mesh and a photo", "I have a robot", "I write a method", "I build a sensor"]
    for card in CARDS:
        lines = re.findall(r"^    - (.+)$", card, re.MULTILINE)
        assert 3 <= len(lines) <= 5
        assert all("](" in line for line in lines)


def test_every_page_occurs_once_in_the_navigation():
    pages = [page for page in list_pages(NAV) if page.endswith(".md")]
    assert len(pages) == len(set(pages))
    assert set(pages) == {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}


def test_results_have_their_own_tab():
    tab_of = {page: name for tab in NAV for name, entry in tab.items() for page in list_pages(entry)}
    assert {tab for page, tab in tab_of.items() if page.startswith(("benchmarks", "trust"))} == {"Results"}
