"""The search of the site works in a browser without a network, from a server and from disk."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser_helpers import LOCAL, find, list_errors, list_requests, open_browser
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver.support.ui import WebDriverWait
from site_helpers import Site

PAGES = {
    "index.md": "# Home\n\nSee [the other page](other.md).\n",
    "other.md": "# Other\n\nThe word zirconium occurs here.\n",
    "api.md": "# API\n\n::: small.Sensor\n",
}


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    site = Site(tmp_path_factory.mktemp("site").resolve())
    site.write(PAGES)
    site.write_notebook("metals", "print('molyb' + 'denum')")
    made = site.make_docs()
    assert made.returncode == 0, made.stderr
    return site.folder / "out" / "site"


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with open_browser(1280, 800) as found:
        yield found


@pytest.fixture
def served(built) -> Iterator[str]:
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(built))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def search(browser, words: str) -> list[str]:
    """Type words into the search of the open page, and return the texts of the results, once they are shown."""
    box = find(browser, "input.md-search__input")
    box.click()
    box.send_keys(words)

    def read_results(_) -> list[str]:
        return [e.text for e in browser.find_elements("css selector", ".md-search-result__item") if e.text]

    return WebDriverWait(browser, 20, ignored_exceptions=[StaleElementReferenceException]).until(read_results)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["disk", "server"])
@pytest.mark.parametrize(
    ("word", "title"),
    [("zirconium", "Other"), ("molybdenum", "The notebook metals")],
    ids=["page", "notebook's output"],
)
def test_a_query_lists_the_page_that_contains_the_word(start, word, title, built, browser, served):
    list_errors(browser), list_requests(browser)
    browser.get(f"{built.as_uri()}/index.html" if start == "disk" else f"{served}index.html")
    (found,) = search(browser, word)
    assert found.startswith(title)
    assert list_errors(browser) == []
    requests = list_requests(browser)
    assert any("index.html" in url for url in requests)
    assert [url for url in requests if not url.startswith((*LOCAL, served))] == []
