"""The page in a headless browser: press, add, locate and export; and two visitors at once."""

from __future__ import annotations

import json
import sys
import threading
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import app_session as program
import browser
import numpy as np
import pytest
import trimesh
from press_sets import BALL_M, MM, TINY, ball_set
from tactile_loc import ContactShape, RunConfig, StageStore, write_touch
from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.images import encode_png
from tactile_loc.plugin import ConfigError, MissingLibraryError, registry
from test_uploads import pack

from tactile_loc_app.page.follower import Follower
from tactile_loc_app.page.pictures import paint_beside, paint_photo, paint_wide
from tactile_loc_app.page.scene_view import FROM, choose_magnification, frame_points

if TYPE_CHECKING:
    from tactile_loc_app.page.panels import VisitorPage

MINI = "gelsight-mini"
CONFIG = RunConfig.from_dict({"object": {"path": "pin"}, "sensor": MINI})


@pytest.mark.parametrize(("std_m", "times"), [(5e-3, 1), (4e-4, 1), (4e-5, 10), (4e-9, 1000)])
def test_a_small_ellipsoid_is_drawn_larger(std_m, times):
    assert choose_magnification(std_m**2 * np.eye(6)) == times


@pytest.mark.parametrize(("aspect", "covered"), [(1.4, (0.1, 0.0)), (0.46, (0.15, 0.2))])
def test_the_framed_points_lie_in_the_free_part_of_the_view(aspect, covered):
    points, slope = np.random.default_rng(0).uniform(-1, 1, (50, 3)) * [4, 2, 7] + [10, 20, 30], 0.5
    target, away = frame_points(points, 0.1, slope, aspect, covered)
    right = np.cross([0, 0, 1], FROM) / np.linalg.norm(np.cross([0, 0, 1], FROM))
    seen = points - target
    depth = away - seen @ FROM
    x, y = (
        seen @ right / (depth * slope * aspect),
        seen @ np.cross(FROM, right) / (depth * slope),
    )  # -1 to 1 in the view
    assert np.abs(x).max() < 1
    assert y.max() < 1 - 2 * covered[0]
    assert y.min() > 2 * covered[1] - 1
    assert max(np.ptp(x), np.ptp(y)) > 0.8, "the points fill the view"


def test_the_picture_of_a_shape_shows_contact_beside_a_scaled_photo():
    geometry = registry().create("sensor", MINI, {}).geometry.resize_long_side(72)
    depth = np.full(geometry.shape, 1e-3, np.float32)
    depth[20:30, 30:50] = 0
    picture = paint_wide(ContactShape(depth, 1e-3), geometry)
    assert picture.shape == (3 * geometry.shape[0], 3 * geometry.shape[1], 3)
    assert (picture[3 * 25, 3 * 40] != picture[0, 0]).any()
    assert paint_beside(picture, picture).shape[1] > 2 * picture.shape[1]
    photo = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    scaled = paint_photo(photo, (4, 6))
    np.testing.assert_array_equal(scaled[::2, ::2], photo)
    assert scaled.shape == (4, 6, 3)


def test_only_the_newest_request_counts():
    started, release, seen = threading.Event(), threading.Event(), []

    def work(request: int) -> None:
        seen.append(request)
        started.set()
        release.wait(60)

    follower = Follower(work)
    follower.ask(0)
    assert started.wait(60)
    for request in range(1, 5):
        follower.ask(request)
    release.set()
    for _ in range(6000):
        if follower.done == 2:
            break
        threading.Event().wait(0.01)
    follower.stop()
    assert seen == [0, 4]


def test_the_server_refuses_a_wrong_object_and_port_before_it_starts(tmp_path):
    pytest.importorskip("viser")
    from tactile_loc_app.server import AppServer

    with pytest.raises(ObjectError):
        AppServer(RunConfig.from_dict({"object": {"path": "missing.stl"}}), store=StageStore(tmp_path))
    with pytest.raises(ConfigError):
        AppServer(CONFIG, port=70000, store=StageStore(tmp_path))


def test_without_viser_the_message_names_it(monkeypatch):
    from tactile_loc_app.server import require_viser

    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingLibraryError, match="pip install 'viser"):
        require_viser()


def require_browser() -> None:
    """Skip a test, with the reason, unless the page can be opened in a browser."""
    pytest.importorskip("viser")
    pytest.importorskip("selenium")
    if browser.find_browser() is None:
        pytest.skip("there is no chromium with its chromedriver")


def hostile(suffix: str = "") -> str:
    """Return a name that runs scripts, loads a picture, and links, where it is taken for HTML or Markdown."""
    script = '<img src=x onerror=top.ran=1><iframe srcdoc="<img src=x onerror=top.ran=1>">'
    return f"{script}![](http:&#47;&#47;evil.example&#47;a.png)[x](javascript:top.ran=1) www.evil.example{suffix}"


@pytest.mark.slow
def test_names_in_files_are_shown_literally(tmp_path, store):
    require_browser()
    from tactile_loc_app.server import AppServer

    mesh, photo = tmp_path / hostile(".stl"), tmp_path / hostile(".png")
    mesh.write_bytes(trimesh.creation.box((30, 20, 10)).export(file_type="stl"))
    photo.write_bytes(encode_png(ball_set(1, px=80).background))
    table = "[[touch]]\npath = '{}'\n"
    (tmp_path / "bad.zip").write_bytes(pack({"touches.toml": table.format("<b>missing.npz").encode()}))
    (tmp_path / "link.zip").write_bytes(pack({f"../{hostile()}": b""}))
    with AppServer(CONFIG, port=0, store=store) as server:
        session = server.new_session()
        touch = write_touch(tmp_path / "touch.npz", session.add_touch()).read_bytes()
        session.close()
        listed = {"touches.toml": table.format(hostile(".npz")).encode()}
        (tmp_path / "good.zip").write_bytes(pack({**listed, hostile(".npz"): touch}))
        visitor = program.Visitor(f"{server.url}/?websocket=ws://127.0.0.1:9", tmp_path)
        try:
            program.wait_until(lambda: server.pages, "the page asks another server")
            visitor.browser.get("about:blank")
            program.wait_until(lambda: not server.pages, "the visitor does not leave")
            visitor.browser.get(server.url)
            read_console(visitor)
            page = program.await_page(server, visitor)
            visitor.click("Add this touch")  # draws its number, for which the page makes code
            visitor.await_text("Touches: touch-1", 20)
            visitor.upload("Open your own mesh", mesh)
            visitor.await_text(f"{hostile()}: 30.0 x 20.0", 20)
            visitor.click_text("Touches from files")
            visitor.upload("Upload a touch or a list", tmp_path / "good.zip")
            visitor.await_text(f"Touches: {hostile('.npz')}", 20)
            for name in ("bad.zip", "link.zip"):
                visitor.upload("Upload a touch or a list", tmp_path / name)
            visitor.await_text("<b>missing.npz", 20)
            visitor.await_text(f"'../{hostile()}'", 20)
            visitor.open_tab("Calibrate a sensor")
            visitor.upload("Upload the photo without contact", photo)
            visitor.await_text(f"Without contact: {hostile('.png')}", 20)
            page.notices.notify(hostile("title"), hostile("text"))
            visitor.await_text(hostile("title"), 20)
            find = (
                "return [window.ran,"
                "document.querySelectorAll('iframe, img[src=x], a[href*=evil], a[href^=java]').length,"
                "performance.getEntriesByType('resource').filter(one => one.name.includes('evil')).length]"
            )
            assert visitor.browser.execute_script(find) == [None, 0, 0]
            assert "Error" not in read_console(visitor)
        finally:
            visitor.close()


def read_console(visitor: program.Visitor) -> str:
    """Return the new lines of the browser's console."""
    return "\n".join(str(entry["message"]) for entry in visitor.browser.get_log("browser"))


@pytest.mark.slow
def test_visitors_press_locate_and_export(tmp_path, store):
    require_browser()
    from tactile_loc_app.server import AppServer

    with AppServer(CONFIG, port=0, store=store) as server:
        visitor = program.Visitor(server.url, tmp_path)
        other = program.Visitor(server.url, tmp_path)
        try:
            assert server.url.startswith("http://127.0.0.1:")
            program.await_page(server, visitor)
            program.wait_until(lambda: len(server.pages) == 2, "a visitor is missing")
            mine, theirs = (server.pages[number] for number in sorted(server.pages))
            assert mine.locate.disabled, "there is no touch yet"
            visitor.click("Add this touch")
            visitor.await_text("Touches: touch-1")
            visitor.click("Locate")
            visitor.await_text("Located in", 300)
            visitor.click("Suggest the next touch")
            visitor.await_text("The next touch is green")
            visitor.click("Add this touch")
            visitor.await_text("Touches: touch-1, touch-2")
            assert "mm from the true pose" in visitor.read()
            visitor.browser.refresh()
            program.wait_until(lambda: mine.session in [page.session for page in server.pages.values()] and
                               mine not in server.pages.values(), "the session is lost")  # fmt: skip
            (mine,) = (page for page in server.pages.values() if page.session is mine.session)
            visitor.await_text("Touches: touch-1, touch-2")
            assert visitor.browser.title == "tactile-loc"
            program.wait_until(lambda: "websocket" not in visitor.browser.current_url, "the address stays long")
            visitor.click("Locate")
            visitor.await_text(" s from 2 touches")
            visitor.click("Download the result")
            with zipfile.ZipFile(visitor.await_download(program.ARCHIVE)) as archive:
                assert {"result.json", "locate.py", "touch-1.npz"} <= set(archive.namelist())
                record = json.loads(archive.read("result.json"))
            assert record["verdict"] in visitor.read()
            visitor.fill("Press (mm)", 99)
            visitor.await_text("The press is")
            assert mine.depth.value == mine.depth.max
            visitor.click("Remove this touch")
            visitor.await_text("Touches: touch-1")
            program.wait_until(lambda: "from 2 touches" not in visitor.read(), "the old result stays")
            assert mine.session.result is None
            visitor.click("Add this touch")
            visitor.await_text("Touches: touch-1, touch-2")
            assert sorted(len(page.session.touches) for page in (mine, theirs)) == [0, 2]
            assert "No touch yet" in other.read()
            wrong = tmp_path / "wrong.stl"
            wrong.write_text("this is no mesh")
            other.upload("Open your own mesh", wrong)
            other.await_text("This did not work")
            assert "pin: 16.0" in other.read()
            (tmp_path / "block.stl").write_bytes(trimesh.creation.box((30, 20, 10)).export(file_type="stl"))
            other.upload("Open your own mesh", tmp_path / "block.stl")
            other.await_text("block: 30.0 x 20.0 x 10.0 mm")
            other.choose("Unit of own files", "cm")
            other.await_text("block: 300.0 x 200.0 x 100.0 mm")
            assert theirs.units.value == "cm"
            calibrate_in_the_page(other, theirs, tmp_path)
            assert theirs.session.localizer.config.sensor.name == "calibrated"
            assert mine.session.localizer.config.sensor.name == MINI
            own = [page.session.folder for page in (mine, theirs)]
            assert all(folder.is_dir() for folder in own)
        finally:
            visitor.close()
            other.close()
        program.wait_until(lambda: not server.pages, "a visitor is left")
        assert all(folder.is_dir() for folder in own), "the page can be loaded again"
    assert not any(folder.exists() for folder in own)


@pytest.mark.slow
def test_the_server_knows_the_visit_of_a_slow_browser(tmp_path, store):
    require_browser()
    from tactile_loc_app.server import AppServer

    with AppServer(CONFIG, port=0, store=store) as server:
        visitor = program.Visitor("about:blank", tmp_path)
        try:
            visitor.browser.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 8})
            visitor.browser.get(server.url)
            program.await_page(server, visitor)
            (number,) = server._visits.values()
            assert visitor.browser.current_url == f"{server.url}/?visit={number}"
        finally:
            visitor.close()


@pytest.mark.slow
def test_the_view_fills_a_phone_below_a_card_that_nothing_covers(tmp_path, store):
    require_browser()
    from tactile_loc_app.server import AppServer

    with AppServer(CONFIG, port=0, store=store) as server:
        phone = program.Visitor(server.url, tmp_path, program.PHONE)
        try:
            page = program.await_page(server, phone)
            assert phone.find_box("canvas") == (0, 0, *program.PHONE)
            page.notices.notify("Note", "This text is short.")
            phone.await_text("This text is short")
            for share in (0.2, 0.6, 0.2):  # of the screen
                _, top, width, height = phone.find_box(program.DRAWER)
                assert width == program.PHONE[0]
                assert height / program.PHONE[1] == pytest.approx(share, abs=0.05)
                assert top + height == pytest.approx(program.PHONE[1], abs=1)
                _, card_top, _, card_height = phone.find_box(program.CARD)
                _, note_top, _, note_height = phone.find_box("[role=alert]")
                assert 0 < card_top < card_top + card_height < note_top < note_top + note_height < top
                phone.toggle_drawer()
        finally:
            phone.close()


def calibrate_in_the_page(visitor: program.Visitor, page: VisitorPage, folder: Path) -> None:
    """Calibrate a sensor from photos in the page, after a mistake, and use it."""
    balls, radius_mm = ball_set(7, px=80), BALL_M / MM
    (folder / "untouched.png").write_bytes(encode_png(balls.background))
    photos = {f"{number}.png": encode_png(image) for number, image in enumerate(balls.images)}
    (folder / "balls.zip").write_bytes(pack(photos))
    page.session.calibrator.options = TINY
    visitor.open_tab("Calibrate a sensor")
    visitor.click("Calibrate")
    visitor.await_text("there is no photo of a press yet")
    visitor.upload("Upload the photo without contact", folder / "untouched.png")
    visitor.await_text("Without contact: untouched.png")
    visitor.upload("Upload photos of the ball", folder / "balls.zip")
    visitor.await_text("Photos of presses: 7")
    visitor.fill("Ball radius", radius_mm)
    visitor.fill("Size of a pixel", 0.2)
    program.wait_until(lambda: page.calibration.scale.value == 0.2, "the scale does not arrive")
    visitor.click("Calibrate")
    visitor.await_text("1 of 7 presses were held out", 300)
    visitor.click("Download the sensor")
    with zipfile.ZipFile(visitor.await_download("my_sensor.zip")) as archive:
        assert "my_sensor/calibration.json" in archive.namelist()
    visitor.click("Use this sensor")
    visitor.await_text("my_sensor is the sensor now")
