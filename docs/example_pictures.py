#!/usr/bin/env python3
"""Draws the pictures of docs/examples.md: runs each script of examples/, and photographs the Rerun viewer.

The viewer runs in headless Chromium, so this program needs selenium, chromium and chromedriver.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from browser import open_browser

IMAGES, EXAMPLES = Path(__file__).parent / "images", Path(__file__).parents[1] / "examples"
PORTS = (19090, 19876)  # of the viewer's page and of its data
DRAWN_AFTER_S = 25


def draw_rerun(script: Path, picture: Path) -> None:
    """Write the recording of a script, and a picture of it in the Rerun viewer."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "touch.rrd"
        subprocess.run([sys.executable, script, "--out", recording], check=True)
        page, data = PORTS
        ports = ["--web-viewer-port", str(page), "--port", str(data), "--renderer", "webgl"]
        viewer = subprocess.Popen(
            [Path(sys.executable).with_name("rerun"), recording, "--serve-web", *ports], start_new_session=True
        )
        try:
            driver = open_browser(1000, 640)
            address = f"rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{data}%2Fproxy"
            driver.get(f"http://127.0.0.1:{page}/?url={address}&renderer=webgl")
            time.sleep(DRAWN_AFTER_S)
            driver.save_screenshot(str(picture))
            driver.quit()
        finally:
            os.killpg(viewer.pid, signal.SIGTERM)  # the command starts the viewer as another process
            viewer.wait()


def main() -> None:
    """Draw all pictures."""
    for script in sorted(EXAMPLES.glob("[0-9]*.py")):
        picture = IMAGES / f"example-{script.stem[3:].replace('_', '-')}.png"
        if "--out" in script.read_text():
            draw_rerun(script, picture)
        else:
            subprocess.run([sys.executable, script, "--picture", picture], check=True)
        print(picture)


if __name__ == "__main__":
    main()
