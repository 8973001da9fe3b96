"""`tactile-loc simulate --images`: camera images beside the contact shapes."""

from pathlib import Path

import numpy as np
import pytest
from cli_helpers import assert_refused, succeed, write_box
from message_helpers import missing
from PIL import Image

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.plugins.sensors.presets import Digit, GelSlim
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background

SENSOR = """\
camera = "orthographic"
image_size_px = [64, 48]
max_depth_mm = 1.0
mm_per_px = 0.5
"""


def image(path: str) -> np.ndarray:
    with Image.open(path) as picture:
        assert picture.mode == "RGB"
        return np.asarray(picture)


def simulate(cli, *words: object):
    return succeed(cli("simulate", "--count", 2, "--seed", 4, *words))


def test_every_touch_has_an_image_beside_the_background(cli):
    done = simulate(cli, "--images", "--out", "out", "-o", "grid.min_contact_percent=2")
    assert "background.png" in done.stdout
    names = ["touch-0000", "touch-0001"]
    files = ["background.png", "poses.json", *(f"{n}.{e}" for n in names for e in ("npz", "png")), "touches.png"]
    assert sorted(p.name for p in Path("out").iterdir()) == files
    unpressed = image("out/background.png")
    assert np.array_equal(unpressed, render_background(GelSlim().geometry, OPTICS["gelslim"]))
    for name in names:
        seen = image(f"out/{name}.png")
        assert seen.shape == unpressed.shape
        changed = np.abs(seen.astype(int) - unpressed).max(axis=-1) > 25
        with np.load(f"out/{name}.npz") as touch:
            contact = touch["depth"] < touch["press_depth"]
        grown = np.pad(contact, 15)
        near = np.any([np.roll(grown, (i, j), (0, 1)) for i in (-15, 0, 15) for j in (-15, 0, 15)], axis=0)
        assert changed.any()
        assert near[15:-15, 15:-15][changed].mean() > 0.9  # the image changes near the contact


def test_images_are_optional_do_not_change_the_touches_and_follow_the_seed(cli):
    simulate(cli, "--out", "plain")
    for out in ("seen", "again"):
        simulate(cli, "--images", "--out", out)
    assert not list(Path("plain").glob("touch-*.png"))
    for path in Path("plain").glob("*.npz"):
        with np.load(path) as a, np.load(Path("seen") / path.name) as b:
            assert np.array_equal(a["depth"], b["depth"])
    assert np.array_equal(image("seen/touch-0001.png"), image("again/touch-0001.png"))


def test_older_touches_in_the_folder_are_reported(cli):
    assert "older" not in simulate(cli, "--out", "out").stderr
    done = cli("simulate", "--count", 1, "--seed", 4, "--out", "out")
    assert not missing(done.stderr, "out", 1, "touch-0001.npz")
    assert len(list(Path("out").glob("*.npz"))) == 2


@pytest.mark.parametrize(
    ("words", "geometry", "style"),
    [
        (["--images", "--sensor", "digit"], Digit().geometry, "digit"),
        (["--optics", "gelsight-mini"], GelSlim().geometry, "gelsight-mini"),
    ],
)
def test_the_optics_follow_the_sensor_or_the_option(cli, words, geometry: SensorGeometry, style):
    simulate(cli, *words, "--out", "out")
    assert np.array_equal(image("out/background.png"), render_background(geometry, OPTICS[style]))


def test_a_sensor_file_also_gives_images_and_unknown_optics_are_refused(cli):
    Path("sensor.toml").write_text(SENSOR)
    write_box(Path("box.obj"))
    assert_refused(cli("simulate", "--optics", "gelslam", "--out", "out"), "gelslam", "gelslim")
    assert not Path("out").exists()
    simulate(cli, "--object", "box.obj", "--units", "mm", "--sensor", "sensor.toml", "--images", "--out", "out")
    assert image("out/touch-0000.png").shape == (48, 64, 3)
