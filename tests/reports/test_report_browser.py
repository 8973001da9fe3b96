"""The pages in a browser without a network draw, respond, and cause no error and no request.

The page of a live run requests only its own server.
"""

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_helpers import LOCAL, choose, find, list_errors, list_requests, open_browser, plots
from PIL import Image
from report_helpers import UNFRIENDLY

from tactile_loc import ExampleTable, Localizer, LocatedFrame, SourceFrame, Touch, Verdict
from tactile_loc.reports import write_report
from tactile_loc.reports.live_server import LiveServer
from tactile_loc.reports.live_view import describe_frame, make_live_page, render_shape
from tactile_loc.reports.page import render
from tactile_loc.reports.scene import list_rows_mm
from tactile_loc.tracking.live import LiveResult

CHANGED_PX = 300


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless browser that cannot look up any host."""
    with open_browser() as found:
        yield found


@pytest.fixture
def show(browser: Any, tmp_path: Path) -> Iterator[Callable[[Path], Any]]:
    """Open the report of a result; afterwards, check that there was no console error and no request to a server."""
    for kind in ("browser", "performance"):
        browser.get_log(kind)

    def open_report(folder: Path) -> Any:
        browser.get(write_report(folder, tmp_path / "page.html").as_uri())
        return browser

    yield open_report
    assert list_errors(browser) == []
    urls = list_requests(browser)
    assert any(url.endswith("page.html") for url in urls)
    assert [url for url in urls if not url.startswith(LOCAL)] == []


def pixels(element: Any) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB")).astype(int)


def object_points(browser: Any) -> np.ndarray:
    """The drawn vertices (V, 3) of the object on the sensor, mm."""
    script = "const t = document.getElementById('scene').data[0]; return [t.x, t.y, t.z].map((v) => Array.from(v))"
    return np.array(browser.execute_script(script)).T


@pytest.mark.slow
def test_the_page_of_a_run_moves_the_object_to_the_chosen_candidate(show, run_folder):
    browser = show(run_folder)
    assert set(plots(browser)) == {"scene", "surface", "yaw", "modes", "times"}
    assert min(plots(browser).values()) > 0
    result = json.loads((run_folder / "result.json").read_text())
    vertices = object_points(browser)
    scene = find(browser, "#scene")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", scene)
    view = "return document.getElementById('scene').layout.scene.camera"
    before, camera = pixels(scene), browser.execute_script(view)
    rows = browser.find_elements("css selector", "tr.pick")
    assert len(rows) == len(result["hypotheses"]) > 1
    browser.execute_script("arguments[0].click()", rows[1])
    after = pixels(scene)
    assert camera == browser.execute_script(view)
    assert (np.abs(after - before).max(axis=2) > 20).sum() > CHANGED_PX
    first, second = (np.array(h["T_sensor_object"]) for h in result["hypotheses"][:2])
    move = second @ np.linalg.inv(first)
    expected = vertices @ move[:3, :3].T + 1e3 * move[:3, 3]
    assert np.abs(object_points(browser) - expected).max() < 0.01
    assert [row.get_attribute("aria-selected") for row in rows[:3]] == ["false", "true", "false"]
    assert rows[1].value_of_css_property("background-color") != rows[0].value_of_css_property("background-color")
    assert find(browser, "#chosen").text.startswith("Candidate 2: ")
    cards = browser.find_elements("css selector", ".card")
    assert [card.get_attribute("aria-selected") for card in cards[:2]] == ["false", "true"]


@pytest.mark.slow
def test_names_are_shown_as_text_and_the_page_of_a_run_responds(show, unfriendly_run):
    browser = show(unfriendly_run)
    assert UNFRIENDLY.strip() in find(browser, "h1").get_attribute("textContent")
    assert browser.execute_script("return document.scripts.length") == 5  # the data, plotly, and three of ours
    assert min(plots(browser).values()) > 0
    assert_to_scale(browser)
    assert_chosen_by_card_and_key(browser)
    assert_dark_theme_draws_anew(browser)


def assert_to_scale(browser: Any) -> None:
    """Check that one millimetre has the same length along all axes, for any ranges."""
    for name in ("scene", "surface"):
        scene = browser.execute_script(
            "const s = document.getElementById(arguments[0])._fullLayout.scene;"
            "return ['x', 'y', 'z'].map(k => [s.aspectratio[k], s[k + 'axis'].range])",
            name,
        )
        per_mm = [ratio / (high - low) for ratio, (low, high) in scene]
        assert per_mm == pytest.approx([per_mm[0]] * 3, rel=1e-6)


def assert_chosen_by_card_and_key(browser: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    cards = browser.find_elements("css selector", ".card")
    browser.execute_script("arguments[0].click()", cards[1])
    assert find(browser, "#chosen").text.startswith("Candidate 2")
    browser.find_elements("css selector", "tr.pick")[0].send_keys(Keys.ENTER)
    assert find(browser, "#chosen").text.startswith("Candidate 1")


def assert_dark_theme_draws_anew(browser: Any) -> None:
    script = (
        "return [getComputedStyle(document.body).backgroundColor, document.getElementById('modes').layout.font.color]"
    )
    before = browser.execute_script(script)
    find(browser, "#theme").click()
    after = browser.execute_script(script)
    assert all(a != b for a, b in zip(before, after, strict=True))


@pytest.mark.slow
def test_the_page_of_what_run_answers_is_drawn_and_its_menus_work(show, recall_folder):
    browser = show(recall_folder)
    assert set(plots(browser)) == {"curves", "verdicts-plot", "reliability-plot"}
    assert min(plots(browser).values()) > 0
    table = ExampleTable.read(json.loads((recall_folder / "recall.json").read_text())["examples"])
    for name, value in (("object", "hook"), ("noise", "strong"), ("kind", "listed"), ("metric", "shape")):
        choose(browser, name, value)
    x, y = browser.execute_script(
        "const t = document.getElementById('curves').data[1]; return [Array.from(t.x), Array.from(t.y)]"
    )
    errors = 1e3 * table.group("object", "noise", "touches")["hook", "strong", 3].errors_m("listed", "shape")
    known = sorted(errors[errors <= 50])
    assert x[1:-1] == pytest.approx([max(e, 0.02) for e in known], rel=1e-4)
    assert y[-1] == pytest.approx(100 * len(known) / len(errors))


def visible_rows(browser: Any) -> list[list[str]]:
    rows = browser.find_elements("css selector", "#table tbody tr:not([hidden])")
    return [[cell.get_attribute("textContent") for cell in row.find_elements("css selector", "td")] for row in rows]


@pytest.mark.slow
def test_the_page_of_a_sweep_is_drawn_sorted_and_filtered(show, sweep_folder):
    browser = show(sweep_folder)
    assert set(plots(browser)) == {"scatter", "effect-0", "effect-1"}
    effect = "return document.getElementById('effect-0').data.map(t => [t.name, Array.from(t.y)])"
    middle = (4.0 * 1.0 * 0.5) ** (1 / 3)
    for name, ratios in browser.execute_script(effect):
        assert ratios == pytest.approx([{"none": 4.0, "icp": 1.0, "filterreg": 0.5}[name] / middle] * 4)
    headings = browser.find_elements("css selector", "#table th")
    place = [heading.get_attribute("textContent") for heading in headings].index("chosen (mm)")
    for sign in (1, -1):
        browser.execute_script("arguments[0].click()", headings[place])
        values = [float(row[place]) for row in visible_rows(browser)]
        assert values == sorted(values, reverse=sign < 0)
    find(browser, "#filter").send_keys("pin icp")
    assert {tuple(row[:2]) for row in visible_rows(browser)} == {("pin", "icp")}
    assert find(browser, "#count").text.startswith("2 of 12 ")
    dots = "return document.getElementById('scatter').data.reduce((n, t) => n + t.x.length, 0)"
    assert browser.execute_script(dots) == 2
    texts = browser.execute_script("return document.getElementById('scatter').data.flatMap(t => t.text)")
    assert all("refiner: icp" in text for text in texts)


def live_result(number: int, touch: Touch | None) -> LiveResult:
    """A frame with a photo, at the true pose of its touch."""
    photo = np.random.default_rng(number).integers(0, 256, (48, 48, 3), np.uint8)
    frame = SourceFrame(number, 0.0, f"{number}.png", photo)
    if touch is None:
        located = LocatedFrame(Verdict.NO_CONTACT, says="no contact: nothing", seconds=0.1)
    else:
        T, C = touch.T_sensor_object, np.diag(np.square([1e-4] * 3 + [0.01] * 3))
        located = LocatedFrame(Verdict.CERTAIN, T[None], np.array([0.97]), C, 0.8, 0.1)
    return LiveResult(frame, located, touch, 2, 4.0)


@pytest.mark.slow
def test_the_page_of_a_live_run_is_drawn_during_the_run(browser, localizer: Localizer):
    from selenium.webdriver.support.ui import WebDriverWait

    first, second = localizer.simulate(2, seed=1)
    body = localizer.object.mesh.vertices_m
    for kind in ("browser", "performance"):
        browser.get_log(kind)
    with LiveServer(render(make_live_page(localizer, "camera 0")), 0) as server:
        browser.get(server.url)
        assert "waiting" in find(browser, "#says").text
        for number, touch in enumerate((first, second, None)):
            result = live_result(number, touch)
            made = render_shape(result, localizer)
            server.board.show(lambda result=result, made=made: describe_frame(result, made, localizer))
            WebDriverWait(browser, 120).until(
                lambda _, n=str(number): browser.execute_script("return document.documentElement.dataset.number") == n
            )
            drawn = browser.execute_script("return document.getElementById('scene').data[0].visible")
            image, *_ = browser.find_elements("css selector", "#photo image")
            assert image.get_attribute("href").startswith("data:image/png")
            assert drawn == (touch is not None)
            if touch is not None:
                rows = np.reshape(list_rows_mm(touch.T_sensor_object), (3, 4))
                expected = 1e3 * body @ rows[:, :3].T + rows[:, 3]
                assert np.abs(object_points(browser) - expected).max() < 0.01
                texts = [find(browser, f"#{name}").text for name in ("verdict", "probability", "place-more", "rate")]
                assert texts == ["certain", "97 %", "std 0.10, 0.10, 0.10 mm", "4.0 Hz"]
                assert find(browser, "#shape .made").get_attribute("d").startswith("M")
        assert find(browser, "#verdict").text == "no contact"
        assert find(browser, "#says").text == "no contact: nothing"
    WebDriverWait(browser, 120).until(lambda _: find(browser, "#verdict").text == "ended")
    assert list_errors(browser) == []
    assert {url for url in list_requests(browser) if not url.startswith(LOCAL)} == {server.url, f"{server.url}events"}
