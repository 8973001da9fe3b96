"""All pages of the documentation: what of their figures is not true, and how they are renewed and bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from figures import Quote, Results, checked, renewed, sentences
from quotes import QUOTES
from results import RESULTS, ROOT, latest


def pages() -> dict[str, list[Quote]]:
    """Return the pages with figures and what of them is quoted."""
    named = ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]
    return {page: [quote for quote in QUOTES if quote.page == page] for page in named}


def problems() -> list[str]:
    """Return what is not true of the documentation's figures."""
    results = Results(latest())
    return [
        problem
        for page, quotes in pages().items()
        for problem in checked(page, (ROOT / page).read_text(encoding="utf-8"), results, quotes)
    ]


def renew() -> list[Path]:
    """Write what comes of the results into the documentation; return the pages that changed."""
    results, changed = Results(latest()), []
    for page, quotes in pages().items():
        path = ROOT / page
        text = path.read_text(encoding="utf-8")
        new, _ = renewed(page, text, results, quotes)
        if new != text:
            path.write_text(new, encoding="utf-8")
            changed.append(path)
    return changed


def bind(run: str, folder: Path = RESULTS) -> None:
    """Keep with a run what the documentation says of it. Raises SystemExit for a run that is not kept."""
    results = latest(folder)
    if run not in results:
        raise SystemExit(f"bench: there is no run {run}; there are {', '.join(results)}")
    told = [
        one.text
        for page, quotes in pages().items()
        for one in sentences(page, (ROOT / page).read_text(encoding="utf-8"), quotes)
        if one.run == run
    ]
    replace(results[run], beside=told).write(folder)
