"""Public sets of presses are converted, each from its format, and sets of another format are refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import BALL_M, MM, ball_set
from public_sets import CIRCLES, PUBLIC_SETS

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.sensors.calibration.public_sets import FORMATS, convert_presses

BALLS = ball_set(3)
MM_PER_PX = 0.25
LARGEST_PX = 0.98 * BALL_M / MM / MM_PER_PX
EACH = pytest.mark.parametrize("format", PUBLIC_SETS)


def write(format: str, folder: Path) -> Path:
    return PUBLIC_SETS[format](folder, BALLS.images, BALLS.background)


@pytest.fixture
def source(format: str, tmp_path: Path) -> Path:
    return write(format, tmp_path / "source")


@EACH
def test_a_converted_set_keeps_images_and_circles_and_can_be_read_for_calibration(format, source, tmp_path):
    table = convert_presses(source, tmp_path / "out", format, BALL_M / MM, MM_PER_PX)
    assert PUBLIC_SETS.keys() == FORMATS.keys(), "a format is not tested"
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    background = [row["image"] for row in rows if row["kind"] == "background"]
    assert len(background) == (0 if format == "fots" else 1)
    for name in background:
        np.testing.assert_array_equal(read_colour_image(table.parent / name), BALLS.background)
    balls = [row for row in rows if row["kind"] == "ball"]
    for row, image, (x, y, radius) in zip(balls, BALLS.images, CIRCLES, strict=True):
        np.testing.assert_array_equal(read_colour_image(table.parent / row["image"]), image)
        found = [float(row[name]) for name in ("center_x_px", "center_y_px", "radius_px", "ball_radius_mm")]
        assert found == pytest.approx([x + 0.5, y + 0.5, min(radius, LARGEST_PX), 3.0], abs=1e-3)
        assert found[2] <= LARGEST_PX
    sensor = read_sensor_file(table.with_name("sensor.toml"))
    assert sensor.view == pytest.approx(BALLS.geometry.view)
    if format == "fots":  # has no untouched gel
        with pytest.raises(CalibrationError, match="`background` median"):
            read_presses(tmp_path / "out", sensor)
    else:
        assert len(read_presses(tmp_path / "out", sensor)) == 3


def refused(source: Path, format: str, out: Path, *words: str) -> None:
    with pytest.raises(CalibrationError, match=naming(source, format, *words)):
        convert_presses(source, out, format, BALL_M / MM, MM_PER_PX)


@EACH
def test_a_set_of_another_format_without_images_missing_or_damaged_is_refused(format, source, tmp_path):
    for other in FORMATS.keys() - {format}:
        refused(source, other, tmp_path / other)
    refused(tmp_path / "none", format, tmp_path / "out")
    labels = {"gs_sdk": "10/label.npz", "taxim": "", "fots": "csv/annotate.csv", "circles": "labels.txt"}
    path = source / labels[format]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - (20 if path.suffix == ".npz" else 8)])
    refused(source, format, tmp_path / "out")
    path.write_bytes(whole)
    if format == "taxim":
        np.savez(source, imgs=BALLS.images, f0=BALLS.background)
    else:
        max(file for file in source.rglob("*.png") if file.name != "background.png").unlink()
    refused(source, format, tmp_path / "out")


def test_a_malformed_circle_line_a_set_without_presses_and_an_unknown_format_are_refused(tmp_path):
    circles, fots = (write(format, tmp_path / format) for format in ("circles", "fots"))
    with (circles / "labels.txt").open("a") as file:
        file.write("press_0.png 20 31 5\n")
    refused(circles, "circles", tmp_path / "out", "'press_0.png 20 31 5'", "image (x, y) radius")
    (fots / "csv" / "annotate.csv").write_text("img_names,center_x,center_y,radius\n")
    refused(fots, "fots", tmp_path / "out", "press")
    with pytest.raises(CalibrationError, match=naming("'gelsight'", "gs_sdk", "taxim", "fots", "circles")):
        convert_presses(tmp_path, tmp_path / "out", "gelsight", 3.0, 0.1)


@pytest.mark.parametrize(
    ("name", "format", "lengths_mm", "count", "circle"),
    [
        ("gelsight_mini_balls", "gs_sdk", (4.735, 0.0634), 50, (196.5, 160.5, 29)),
        ("gelsight_balls_160x120/dataPack_small.npz", "taxim", (2.0, 0.1245), 49, (84.5, 66.5, 15.742)),
        ("fots_balls", "fots", (2.35, 1 / 19.58), 42, (76.5, 182.5, 38)),
        ("gelslim_balls", "circles", (2.92, 0.059259), 22, (212.5, 128.5, 26)),
    ],
)
def test_public_sets_are_read_with_their_counts_and_circles(
    shared_data, tmp_path, name, format, lengths_mm, count, circle
):
    source, (x, y, radius) = shared_data / "tactile" / name, circle
    if not source.exists():
        pytest.skip(f"there is no {source}: it holds real images that are not part of the project")
    table = convert_presses(source, tmp_path, format, *lengths_mm)
    presses = read_presses(tmp_path, read_sensor_file(table.with_name("sensor.toml")), format == "fots")
    assert len(presses) == count
    image, label = presses.read_press(0)
    row, column = np.argwhere(label.contact).mean(axis=0) + 0.5
    assert (column, row) == pytest.approx((x, y), abs=0.1)
    assert label.contact.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    changed = np.abs(image.astype(int) - presses.background).max(axis=2)
    assert changed[label.contact].mean() > 3 * np.median(changed)  # the image has changed inside the label
