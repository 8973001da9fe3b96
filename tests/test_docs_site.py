"""The site: its navigation, its builder's checks and its search, partly on a small example site."""

import functools
import http.server
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from page_helpers import DOCS
from site_helpers import Site, read_settings

MOST_PAGES = 65


def list_pages(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [page for child in (entry.values() if isinstance(entry, dict) else entry) for page in list_pages(child)]


def test_the_navigation_lists_every_page_and_notebook_once():
    listed = sorted(list_pages(read_settings()["nav"]))
    paths = [path for suffix in ("md", "ipynb") for path in DOCS.rglob(f"*.{suffix}")]
    assert listed == sorted(path.relative_to(DOCS).as_posix() for path in paths)
    assert len(listed) <= MOST_PAGES


@pytest.fixture
def site(tmp_path) -> Site:
    return Site(tmp_path.resolve())


@pytest.mark.slow
def test_a_good_site_is_built_without_warnings(site):
    site.write({"drawing.py": "raise SystemExit\n"})
    page = site.write_page("linked.md", "# Linked\n\n[Lab\nnotes](../notes/one.md#two) and [the API](api.md).\n")
    made = site.make_docs()
    assert (made.returncode, made.stdout, made.stderr) == (0, "docs: out/site/index.html\n", "")
    built = site.folder / "out" / "site"
    assert {p.name for p in built.glob("*.html")} == {"404.html", "index.html", "other.html", "api.html", "linked.html"}
    assert re.search(r"Lab\s+notes \(<code>notes/one.md</code>\)", page.read_text()), "the site has no such file"
    assert not list(built.rglob("drawing*")), "code beside the pages is not part of the site"
    names = set(re.findall(r'id="(small[^"]*)"', (built / "api.html").read_text()))
    assert names == {"small.Sensor", "small.Sensor.read", "small.Camera", "small.Camera.read", "small.Camera.follow"}


def test_every_kind_of_mistake_is_reported_once_and_fails(site):
    site.write(
        {
            "index.md": "# Home\n\n[a](other.md#the-part-above), [b](absent.md), [c](/other.md), ![d](absent.png)\n",
            "other.md": "# Other\n\n## The part below\n\n::: small.Sensor\n",
            "stray.md": "# Stray\n",
        }
    )
    made = site.make_docs()
    assert made.returncode != 0
    told = [line for line in made.stderr.splitlines() if not line.startswith("make")]
    for mistake in (
        "'other.md#the-part-above', but the doc 'other.md' does not contain an anchor '#the-part-above'",
        "'absent.md', but the target is not found",
        "absolute link '/other.md'",
        "'absent.png', but the target",
        "Multiple primary URLs found for 'small.Sensor'",
        "'other.md' documents 'small.Sensor', which 'api.md' documents already",
        'are not included in the "nav"',
        "- stray.md",
    ):
        assert any(mistake in line for line in told), (mistake, made.stderr)
    assert not any(line.startswith("INFO") or "small.Sensor.read" in line for line in told)
    assert len(set(told)) == len(told)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A site with a word on a page, and another in a notebook's output."""
    site = Site(tmp_path_factory.mktemp("site").resolve())
    site.write({"other.md": "# Other\n\n## The part below\n\nThe word zirconium occurs here.\n"})
    site.write_notebook("metals", "print('molyb' + 'denum')")
    assert site.make_docs().returncode == 0
    return site.folder / "out" / "site"


@pytest.fixture
def served(built) -> Iterator[str]:
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(built))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "word", "title"), [("disk", "zirconium", "Other"), ("server", "molybdenum", "The notebook metals")]
)
def test_the_search_finds_a_word_without_a_network(start, word, title, built, served):
    """The search works from disk and from a server."""
    from browser_helpers import LOCAL, find, list_errors, list_requests, open_browser
    from selenium.common.exceptions import StaleElementReferenceException
    from selenium.webdriver.support.ui import WebDriverWait

    with open_browser(1280, 800) as browser:
        browser.get(f"{built.as_uri()}/index.html" if start == "disk" else f"{served}index.html")
        box = find(browser, "input.md-search__input")
        box.click()
        box.send_keys(word)
        wait = WebDriverWait(browser, 20, ignored_exceptions=[StaleElementReferenceException])
        items = functools.partial(browser.find_elements, "css selector", ".md-search-result__item")
        (found,) = wait.until(lambda _: [one.text for one in items() if one.text])
        assert found.startswith(title)
        assert list_errors(browser) == []
        requests = list_requests(browser)
    assert any("index.html" in url for url in requests)
    assert [url for url in requests if not url.startswith((*LOCAL, served))] == []
