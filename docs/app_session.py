#!/usr/bin/env python3
"""A recorded visit of the interactive page, from an own mesh to a located object, with the seconds of each step.

Starts the page as `tactile-loc app` does, and drives it in a headless Chromium with selenium. Prints a row for each
step, and how often the contact shape is drawn in each second of a drag. Then it calibrates a sensor from simulated
photos of a ball, and locates the object from a photo of this sensor. With `--picture`, it writes docs/images/app.png
and docs/images/app-calibration.png.
"""

import argparse
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from app_photos import BALL_MM, BALLS, MM_PER_PX, PHOTOS, photograph_balls, photograph_part
from browser import open_browser
from numpy.typing import NDArray
from tactile_loc_app.page.panels import ARCHIVE, VisitorPage
from tactile_loc_app.page.scene_view import UNITS_PER_M, from_view
from tactile_loc_app.server import AppServer
from tactile_loc_app.session import list_poses

from tactile_loc.core.geometry.rigid import make_translation
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.store.store import StageStore

PICTURES = Path(__file__).parent / "images"
DESKTOP, PHONE = (1440, 987), (390, 844)  # pixels
BUTTONS = "[...document.querySelectorAll('button:not([role=tab], [disabled])')]"
BUTTON = f"{BUTTONS}.find(one => one.innerText.includes(arguments[0]))"
DRAWER, CARD = '.mantine-Paper-root[style*="position: fixed"]', "#card"
HANDLE = f"{DRAWER} .mantine-ScrollArea-content > div > div:first-child"
MOST_TOUCHES = 5
GRAB = 0.6  # where the arrow is grabbed, share of its length


class Visitor:
    """A headless browser on the page. Downloads arrive in `folder`."""

    def __init__(self, url: str, folder: Path, size: tuple[int, int] = DESKTOP) -> None:
        self.browser = open_browser(*size, preferences={"download.default_directory": str(folder)})
        self.folder = folder
        if size == PHONE:  # a window is at least 500 pixels wide
            screen = {"width": size[0], "height": size[1], "deviceScaleFactor": 2, "mobile": True}
            self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        self.browser.get(url)

    def close(self) -> None:
        """End the browser."""
        self.browser.quit()

    def read(self) -> str:
        """Return the text of the page."""
        return str(self.browser.execute_script("return document.body.innerText"))

    def await_text(self, text: str, limit_s: float = 120.0) -> None:
        """Wait until the page shows a text."""
        wait_until(lambda: text in self.read(), f"the page does not show {text!r}", limit_s)

    def click(self, text: str) -> None:
        """Press the button with a text."""
        wait_until(lambda: self.browser.execute_script(f"return {BUTTON}", text), f"there is no button {text!r}")
        self.browser.execute_script(f"{BUTTON}.click()", text)

    def click_text(self, text: str) -> None:
        """Click on a heading."""
        find = (
            "return [...document.querySelectorAll('*')]"
            ".find(one => one.children.length < 2 && (one.innerText || '').trim() === arguments[0])"
        )
        self.browser.execute_script(find, text).click()

    def scroll_to(self, text: str) -> None:
        """Scroll to the button with a text."""
        self.browser.execute_script(f"{BUTTON}.scrollIntoView()", text)

    def open_tab(self, text: str) -> None:
        """Show the tab with a text."""
        find = "return [...document.querySelectorAll('[role=tab]')].find(tab => tab.innerText.includes(arguments[0]))"
        wait_until(lambda: self.browser.execute_script(find, text), f"there is no tab {text!r}")
        self.browser.execute_script(find, text).click()

    def upload(self, text: str, path: Path) -> None:
        """Give a file to the upload button with a text."""
        find = (
            "return [...document.querySelectorAll('input[type=file]')]"
            ".find(input => input.parentElement.innerText.includes(arguments[0]))"
        )
        wait_until(lambda: self.browser.execute_script(find, text), f"there is no upload button {text!r}")
        self.browser.execute_script(find, text).send_keys(str(path))

    def fill(self, label: str, value: object) -> None:
        """Write a value into the visible field whose label begins with a text."""
        from selenium.webdriver.common.keys import Keys

        field = self._find_field(label)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(str(value), Keys.TAB)

    def choose(self, label: str, value: str) -> None:
        """Choose a value of the visible list whose label begins with a text."""
        find = (
            "return [...document.querySelectorAll('[role=option]')]"
            ".find(one => one.offsetParent && one.innerText.trim() === arguments[0])"
        )
        self._find_field(label).click()
        wait_until(lambda: self.browser.execute_script(find, value), f"the list {label!r} has no {value!r}")
        self.browser.execute_script(find, value).click()

    def _find_field(self, label: str) -> Any:
        find = (
            "const shown = [...document.querySelectorAll('label')].filter(label => label.offsetParent);"
            "let row = shown.find(label => label.innerText.startsWith(arguments[0]));"
            "const fields = 'input:not([type=hidden]), textarea';"
            "while (row && !row.querySelector(fields)) row = row.parentElement;"
            "return row && row.querySelector(fields)"
        )
        wait_until(lambda: self.browser.execute_script(find, label), f"there is no field {label!r}")
        return self.browser.execute_script(find, label)

    def await_download(self, name: str) -> Path:
        """Wait for a downloaded file, and return its path."""
        path = self.folder / name
        wait_until(path.is_file, f"{name} does not arrive")
        return path

    def drag(self, start: NDArray[np.float64], end: NDArray[np.float64], seconds: float) -> int:
        """Drag the mouse from pixel `start` (2,) to `end` and back for some seconds; return the number of its moves."""
        moves = 0
        begin_s = time.perf_counter()
        self._send_mouse("mouseMoved", start, 0)
        time.sleep(0.5)  # the view marks what is below the mouse
        self._send_mouse("mousePressed", start, 1)
        while (passed := time.perf_counter() - begin_s - 0.5) < seconds:
            share = 0.5 - 0.5 * np.cos(np.pi * passed)
            self._send_mouse("mouseMoved", start + share * (end - start), 1)
            moves += 1
        self._send_mouse("mouseReleased", end, 0)
        return moves

    def leave_controls(self) -> None:
        """Move the mouse to a corner of the view, so that no hint covers the controls."""
        self._send_mouse("mouseMoved", np.ones(2), 0)

    def _send_mouse(self, kind: str, at: NDArray[np.float64], pressed: int) -> None:
        event = {"type": kind, "x": float(at[0]), "y": float(at[1]), "button": "left", "buttons": pressed}
        self.browser.execute_cdp_cmd("Input.dispatchMouseEvent", {**event, "clickCount": 1})

    def close_notifications(self) -> None:
        """Close all notifications."""
        close = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
        self.browser.execute_script(close)
        time.sleep(1.5)

    def find_box(self, selector: str) -> tuple[float, float, float, float]:
        """Return the left, top, width and height of the largest element that a selector finds, pixels."""
        script = (
            "const all = [...document.querySelectorAll(arguments[0])].map(one => one.getBoundingClientRect());"
            "const r = all.sort((a, b) => b.width * b.height - a.width * a.height)[0];"
            "return [r.left, r.top, r.width, r.height]"
        )
        left, top, width, height = self.browser.execute_script(script, selector)
        return left, top, width, height

    def toggle_drawer(self) -> None:
        """Open or close the drawer of the controls on a phone."""
        heights = [self.find_box(DRAWER)[3]]
        self.browser.execute_script("document.querySelector(arguments[0]).click()", HANDLE)

        def rests() -> bool:
            heights.append(self.find_box(DRAWER)[3])
            return abs(heights[-1] - heights[0]) > 0.3 * PHONE[1] and heights[-1] == heights[-2]

        wait_until(rests, "the drawer does not move", pause_s=0.3)


def wait_until(is_done: Callable[[], Any], problem: str, limit_s: float = 120.0, pause_s: float = 0.05) -> None:
    """Look every `pause_s` seconds whether something is done.

    Raises TimeoutError, with the problem, after `limit_s` seconds.
    """
    end_s = time.monotonic() + limit_s
    while not is_done():
        if time.monotonic() > end_s:
            raise TimeoutError(problem)
        time.sleep(pause_s)


def find_arrow(page: VisitorPage, visitor: Visitor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the finger's x arrow is grabbed, and where a drag of 4 mm along it ends, in pixels."""
    assert page.view.finger_gizmo is not None
    T = from_view(page.view.finger_gizmo)
    x0, x1, y0, y1 = page.session.scene.geometry.rectangle
    grab_m = T[:3, 3] + GRAB * max(x1 - x0, y1 - y0) * T[:3, 0]
    return project(page, visitor, grab_m), project(page, visitor, grab_m + 4e-3 * T[:3, 0])


def project(page: VisitorPage, visitor: Visitor, point_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pixel (2,) of the browser's window at which a point (3,), metres, of the view appears."""
    camera, (left, top, width, height) = page.client.camera, visitor.find_box("canvas")
    forward = np.asarray(camera.look_at) - camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    ray = UNITS_PER_M * point_m - camera.position
    scale = 0.5 * height / np.tan(0.5 * camera.fov) / (ray @ forward)
    return np.array(
        [left + 0.5 * width + scale * (ray @ right), top + 0.5 * height - scale * (ray @ np.cross(right, forward))]
    )


def make_part(path: Path) -> Path:
    """Write an own part, an angle bracket with a pin, as STL in metres, and return its path."""
    import trimesh

    foot, wall = trimesh.creation.box((40, 24, 6)), trimesh.creation.box((6, 24, 26))
    wall.apply_translation((-17, 0, 10))
    pin = trimesh.creation.cylinder(3.5, 9, sections=48)
    pin.apply_translation((10, 3, 6))
    trimesh.boolean.union([foot, wall, pin], engine="manifold").apply_scale(1e-3).export(path)
    return path


def await_page(server: AppServer, visitor: Visitor) -> VisitorPage:
    """Wait until the visitor's page is complete, and return it."""
    visitor.await_text("Download the result")
    wait_until(lambda: server.pages, "no visitor is known")
    page = next(reversed(server.pages.values()))
    wait_until(lambda: page.follower.done, "no contact shape is drawn")
    return page


def measure_updates(page: VisitorPage, count: int = 100) -> float:
    """Return how often per second the contact shape and the gel are computed and sent, one request after another."""
    T, depth_m, start_s = page.session.T_base_sensor, page.session.press_depth_m, time.perf_counter()
    for number in range(1, count + 1):
        done = page.follower.done
        page.follower.ask((T @ make_translation([1e-3 * np.sin(number), 0, 0]), depth_m))
        wait_until(lambda done=done: page.follower.done > done, "the contact shape is not drawn", pause_s=0.0005)
    return count / (time.perf_counter() - start_s)


def read_errors(page: VisitorPage) -> list[tuple[str, str]]:
    """Return the errors of the calibrated sensor on held-out photos, each with its name."""
    lines = page.session.calibrator.made.outcome.list_errors()
    return [(f"its error of the {name}", value) for name, value in (line.split(": ") for line in lines)]


def print_row(step: str, value: str) -> None:
    """Print a row of the record."""
    print(f"| {step} | {value} |", flush=True)


def visit(store: StageStore, pictures: Path | None, shots: Path | None) -> None:
    """Visit the page from an own mesh to the exported result, and print a row of the record after each step."""
    start_s = time.perf_counter()

    def note(step: str, text: str = "") -> None:
        nonlocal start_s
        now_s = time.perf_counter()
        if step:
            print_row(step, text or f"{now_s - start_s:.1f} s")
        start_s = time.perf_counter()

    with tempfile.TemporaryDirectory() as name, AppServer(port=0, store=store) as server:
        folder = Path(name)
        note("start the page")
        visitor = Visitor(server.url, folder)
        try:
            page = await_page(server, visitor)
            note("open the page in a browser")
            own_s = time.perf_counter()
            visitor.upload("Open your own mesh", make_part(folder / "bracket.stl"))
            visitor.await_text("bracket: 40.0 x 24.0 x 26.0 mm")
            note("upload an own STL file")
            visitor.click("Add this touch")
            visitor.await_text("Touches: touch-1")
            note("add the first touch")
            time.sleep(2.0)  # the view draws the new object
            start_s, done = time.perf_counter(), page.follower.done
            moves = visitor.drag(*find_arrow(page, visitor), seconds=5.0)
            note("moves of the mouse per second that the browser accepts", f"{moves / 5.0:.0f}")
            note("updates per second while dragging", f"{(page.follower.done - done) / 5.0:.0f}")
            note("updates per second without the mouse", f"{measure_updates(page):.0f}")
            visitor.click("Add this touch")
            visitor.await_text("Touches: touch-1, touch-2")
            note("add the second touch")
            visitor.click("Locate")
            visitor.await_text("Located in", 600.0)
            note("locate from two touches, and build the model")
            while page.session.require_result().verdict != "certain" and len(page.session.touches) < MOST_TOUCHES:
                count = len(page.session.touches) + 1
                visitor.click("Suggest the next touch")
                visitor.await_text("The next touch is green")
                note("suggest the next touch")
                visitor.click("Add this touch")
                visitor.await_text(f"touch-{count}")
                visitor.click("Locate")
                wait_until(lambda count=count: page.session.history[-1].touches == count, "no further result")
                note(f"add this touch, and locate from {count} touches")
                visitor.close_notifications()
                note("")
            print_row("from the own mesh to the verdict, drags included", f"{time.perf_counter() - own_s:.1f} s")
            page = load_again(server, visitor, page)
            print_row("touches after the page is loaded again", str(len(page.session.touches)))
            other = Visitor(visitor.browser.current_url, folder)
            try:
                second = await_page(server, other)
                print_row("touches in a second tab with the same address", str(len(second.session.touches)))
            finally:
                other.close()
            note("")
            visitor.click("Download the result")
            names = zipfile.ZipFile(visitor.await_download(ARCHIVE)).namelist()
            note("export the result")
            assert {"result.json", "report.html", "locate.py", "bracket.stl"} <= {Path(name).name for name in names}
            errors_m = page.session.require_result().measure_errors_m(page.session.object)
            print_row("verdict", str(page.session.require_result().verdict))
            print_row("error of the first pose", f"{1e3 * float(np.asarray(errors_m)[0]):.3f} mm")
            visitor.close_notifications()
            if pictures is not None:
                visitor.browser.save_screenshot(str(pictures / "app.png"))
            untouched, photos = photograph_balls(folder, np.random.default_rng(0))
            visitor.open_tab("Calibrate a sensor")
            visitor.upload("Upload the photo without contact", untouched)
            visitor.await_text(f"Without contact: {untouched.name}")
            visitor.upload("Upload photos of the ball", photos)
            visitor.await_text(f"Photos of presses: {BALLS}")
            visitor.fill("Ball radius", BALL_MM)
            visitor.fill("Size of a pixel", MM_PER_PX)
            wait_until(lambda: page.calibration.scale.value == MM_PER_PX, "the scale does not arrive")
            note("")
            visitor.click("Calibrate")
            visitor.await_text("Use this sensor", 600.0)
            note(f"calibrate a sensor from {BALLS} simulated photos of a ball")
            for row in read_errors(page):
                print_row(*row)
            if pictures is not None:
                wait_until(lambda: not page.calibration.start.disabled, "the reading is not drawn")
                visitor.scroll_to("Download the sensor")
                visitor.leave_controls()
                visitor.close_notifications()
                visitor.browser.save_screenshot(str(pictures / "app-calibration.png"))
            visitor.click("Use this sensor")
            visitor.await_text("is the sensor now")
            visitor.open_tab("Locate")
            visitor.click_text("Touches from files")
            note("")
            for count in PHOTOS:  # touch again until the pose is certain
                packed = folder / f"{count}-touches.zip"  # a browser does not report the same file a second time
                T = photograph_part(page.session, packed, count, np.random.default_rng(0))
                visitor.upload("Upload a touch or a list", packed)
                wait_until(lambda count=count: len(page.session.touches) == count, "the photos do not arrive")
                visitor.click("Locate")
                wait_until(lambda: page.session.result, "no result", 600.0)
                found = page.session.require_result()
                print_row(f"verdict from {count} simulated photos", str(found.verdict))
                if found.verdict == "certain":
                    break
            away_m = float(PoseMetric(page.session.object).symmetric_distance(list_poses(found)[0][None], T[None])[0])
            print_row("error of the first pose", f"{1e3 * away_m:.2f} mm")
            if shots is not None:
                take_shots(server, visitor, shots)
        finally:
            visitor.close()


def load_again(server: AppServer, visitor: Visitor, page: VisitorPage) -> VisitorPage:
    """Load the visitor's page again, and return it."""
    visitor.browser.refresh()

    def find() -> list[VisitorPage]:
        return [one for one in server.pages.values() if one is not page and one.session is page.session]

    wait_until(find, "the session is lost")
    visitor.await_text("Located in")
    return find()[0]


def take_shots(server: AppServer, visitor: Visitor, shots: Path) -> None:
    """Write screenshots of the page: the result, and a fresh visit at the width of a phone."""
    visitor.scroll_to("Locate")
    time.sleep(1.0)
    visitor.browser.save_screenshot(str(shots / "result.png"))
    phone = Visitor(server.url, shots, PHONE)
    try:
        await_page(server, phone)
        phone.close_notifications()
        phone.browser.save_screenshot(str(shots / "phone.png"))
    finally:
        phone.close()


def main() -> None:
    """Record a visit with an empty store, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", action="store_true", help="renew the pictures in docs/images")
    parser.add_argument("--shots", type=Path, help="folder for more screenshots")
    given = parser.parse_args()
    print("| step | measured |\n|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        visit(StageStore(Path(folder)), PICTURES if given.picture else None, given.shots)


if __name__ == "__main__":
    main()
