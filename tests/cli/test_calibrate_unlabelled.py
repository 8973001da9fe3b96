"""`tactile-loc calibrate FOLDER --ball-radius MM`: from unlabelled images to a sensor."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import Cli, assert_refused, succeed
from message_helpers import missing
from photo_helpers import MAPS, photograph
from PIL import Image
from press_sets import BALL_M, MM, ball_set, is_same_camera, write_image

from tactile_loc.sensors.calibration.folder import read_calibration

BALLS = ball_set(7, px=80)
FEW = ["-o", "steps=2", "-o", "hidden=4"]
BALL = ["--ball-radius", BALL_M / MM]
SCALE = ["--mm-per-px", 0.2]

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def photos(cli: Cli) -> Path:
    """A folder with only photos in the working folder."""
    folder = BALLS.write(Path("photos"))
    for name in ("presses.csv", "sensor.toml"):
        (folder / name).unlink()
    return folder


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "presses.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_unlabelled_photos_give_a_sensor_and_an_editable_table(cli, photos):
    write_image(photos / "two.png", np.maximum(BALLS.images[0], BALLS.images[0][::-1, ::-1]))
    done = succeed(cli("calibrate", photos, *BALL, *SCALE, *FEW, "--out", "mine", "--json"))
    labels = json.loads(done.stdout)["labels"]
    assert labels["used"] == 7
    assert list(labels["dropped"]) == ["two.png"]
    assert is_same_camera(read_calibration(Path("mine")).geometry, BALLS.geometry)
    with Image.open(photos / "labels.png") as sheet:
        assert min(sheet.size) > 300
    rows = table(photos)
    assert [row["kind"] for row in rows] == ["background"] + 7 * ["ball"]
    found = {row["image"]: (float(row["center_x_px"]), float(row["center_y_px"])) for row in rows[1:]}
    np.testing.assert_allclose([found[f"{n:04d}.png"] for n in range(7)], BALLS.circles[:, :2], atol=0.7)

    corrected = (photos / "presses.csv").read_text().replace(rows[3]["center_x_px"], "41.5")
    (photos / "presses.csv").write_text(corrected)
    again = succeed(cli("calibrate", photos, *BALL, *SCALE, *FEW, "--out", "mine"))
    assert "presses.csv" in again.stdout
    assert (photos / "presses.csv").read_text() == corrected


def test_each_missing_contradictory_or_unreadable_input_is_one_sentence(cli, photos):
    assert_refused(cli("calibrate", photos, *FEW), "presses.csv", "--ball-radius", "docs/sensors.md")
    assert_refused(cli("calibrate", photos, *BALL, *FEW), "--mm-per-px")
    assert_refused(cli("calibrate", photos, "--ball-radius", 0, *SCALE, *FEW), "--ball-radius", "0")
    assert_refused(cli("calibrate", photos, *BALL, *FEW, "--sensor", "none.toml"), "none.toml")
    assert not (photos / "presses.csv").exists()
    for image in photos.glob("*.png"):
        image.unlink()
    assert_refused(cli("calibrate", photos, *BALL, *SCALE, *FEW), "photos", "PNG", "JPEG")
    BALLS.write(photos)
    assert_refused(cli("calibrate", photos, "--mm-per-px", 0.3, *FEW), "--mm-per-px", "0.3", "sensor.toml", "0.2")
    Path("film.mp4").write_bytes(b"no film")
    assert_refused(cli("calibrate", "film.mp4", *BALL, *SCALE, *FEW), "film.mp4", "convert it to MP4")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lengths", "said"),
    [
        (["--ball-radius", 4000, "--mm-per-px", 0.2], ("4000 mm", "--ball-radius")),
        (["--ball-radius", 0.4, "--mm-per-px", 0.2], ("ball", " mm")),
    ],
)
def test_impossible_lengths_are_refused_and_leave_no_files(cli, photos, lengths, said):
    before = {path.name for path in photos.iterdir()}
    assert_refused(cli("calibrate", photos, *lengths, *FEW), *said)
    assert {path.name for path in photos.iterdir()} == before


@pytest.mark.slow
def test_another_ball_is_refused_and_unlabelled_photos_are_reported(cli, photos):
    BALLS.write(photos)
    assert_refused(cli("calibrate", photos, "--ball-radius", 9, *FEW), "--ball-radius", "9", "table")
    write_image(photos / "new.png", BALLS.images[0])
    done = succeed(cli("calibrate", photos, *BALL, *FEW, "--out", "mine"))
    assert not missing(done.stdout, "presses.csv", 1)


def test_each_impossible_view_is_one_sentence(cli, photos):
    corners = ["--corners", 6, 2, 74, 2, 80, 80, 0, 80]
    square, turned = ["--gel-size", 16, 16], ["--corners", 6, 2, 0, 80, 80, 80, 74, 2]
    asked = ["calibrate", photos, *BALL, *FEW]
    assert_refused(cli(*asked, "--mm-per-px", "0.2,wide"), "--mm-per-px", "0.2,wide")
    assert_refused(cli(*asked, "--mm-per-px", "0.2,0.2,0.2"), "--mm-per-px")
    assert_refused(cli(*asked, *SCALE, *corners), "--gel-size")
    assert_refused(cli(*asked, *SCALE, *corners, *square), "--mm-per-px")
    assert_refused(cli(*asked, *turned, *square), "clockwise")
    assert_refused(cli(*asked, "--mm-per-px", "0.2,0.3", "--camera-matrix", "lens.yaml"), "--camera-matrix")
    assert_refused(cli(*asked, *SCALE, "--camera-matrix", "lens.yaml"), "lens.yaml")
    Path("lens.yaml").write_text("camera_matrix: [700, 0, 320, 0, 700, 240, 0, 0, 1]")
    assert_refused(cli(*asked, *SCALE, "--camera-matrix", "lens.yaml"), "320", "80 x 80 px")
    assert not (photos / "presses.csv").exists()


@pytest.mark.slow
def test_corners_give_a_sensor_with_a_map(cli, photos):
    for path in photos.glob("*.png"):
        write_image(path, photograph(np.asarray(Image.open(path)), MAPS["tilted"]))
    corners = ["--corners", 6, 2, 74, 2, 80, 80, 0, 80, "--gel-size", 16, 16]
    succeed(cli("calibrate", photos, *BALL, *corners, *FEW, "--out", "mine"))
    made = read_calibration(Path("mine"))
    assert made.photo_map is not None
    assert made.photo_map.corners_px == MAPS["tilted"].corners_px
    x0, x1, _, _ = made.geometry.view
    assert x1 - x0 == pytest.approx(16e-3, rel=0.01)
