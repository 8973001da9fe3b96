"""A headless browser without a network, and the requests of its pages."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import browser as program
import pytest

pytest.importorskip("selenium.webdriver", reason="selenium is not installed")

OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
LOCAL = ("file:", "data:", "blob:", "about:", "chrome:")


@contextmanager
def open_browser(width_px: int = 640, height_px: int = 640) -> Iterator[Any]:
    """Open a headless browser that cannot look up any host; skip the test if there is none."""
    if program.find_browser() is None:
        pytest.skip("there is no chromium with its chromedriver")
    browser = program.open_browser(width_px, height_px, OFFLINE, logs=True)
    try:
        browser.set_page_load_timeout(120)
        yield browser
    finally:
        browser.quit()


def list_errors(browser: Any) -> list[dict[str, Any]]:
    """Return the errors in the console since the last call."""
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def list_requests(browser: Any) -> list[str]:
    """Return the addresses of all requests since the last call."""
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [m["params"]["request"]["url"] for m in asked if m["method"] == "Network.requestWillBeSent"]


def plots(browser: Any) -> dict[str, int]:
    """Return the number of traces of each plot, by the name of its element."""
    script = "return [...document.querySelectorAll('.plotly')].map(e => [e.id, (e.data || []).length])"
    return {name: count for name, count in browser.execute_script(script) if name}


def choose(browser: Any, name: str, value: str) -> None:
    """Choose an option of a list, by its value."""
    find(browser, f"#{name} option[value='{value}']").click()


def find(browser: Any, selector: str) -> Any:
    return browser.find_element("css selector", selector)
