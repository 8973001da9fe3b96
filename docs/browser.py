"""A headless browser for the programs that photograph pages: chromium with its chromedriver, driven by selenium."""

import shutil
from collections.abc import Mapping
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  # fmt: skip


def find_browser() -> tuple[str, str] | None:
    """Return the paths of chromium and of chromedriver, or None if one of them is missing."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    return None if browser is None or driver is None else (browser, driver)


def open_browser(
    width_px: int, height_px: int, *flags: str, preferences: Mapping[str, Any] | None = None, logs: bool = False
) -> Any:
    """Return a headless browser; end it with `quit`. With `logs`, it keeps its console and its requests.

    Raises FileNotFoundError without a browser.
    """
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    found = find_browser()
    if found is None:
        raise FileNotFoundError("there is no chromium with its chromedriver; install both")
    options = webdriver.ChromeOptions()
    options.binary_location, driver = found
    for flag in (*FLAGS, *flags, f"--window-size={width_px},{height_px}"):
        options.add_argument(flag)
    options.add_experimental_option("prefs", dict(preferences or {}))
    if logs:
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=Service(driver))
