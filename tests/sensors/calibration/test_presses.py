"""A folder of presses: every kind of row, every fault of a row, and the size of images."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import COLUMNS, ball_set, magnified, write_image, write_table

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.presses import FOR_MEDIAN, choose_size_px, read_presses

BALLS = ball_set(3)
GEOMETRY = BALLS.geometry


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with three presses of a ball."""
    return BALLS.write(tmp_path)


def change(folder: Path, line: int, **values: object) -> None:
    """Change the row in a line of the table (the first press is in line 3); None removes a value."""
    rows = BALLS.rows()
    rows[line - 2] |= values
    write_table(folder, rows)


def refused(folder: Path, *words: str, median: bool = False) -> None:
    with pytest.raises(CalibrationError) as caught:
        read_presses(folder, GEOMETRY, median)
    message = str(caught.value)
    assert "\n" not in message
    for word in ("presses.csv", *words):
        assert word in message


def test_written_balls_are_read_back(folder):
    presses = read_presses(folder, GEOMETRY)
    assert len(presses) == 3
    np.testing.assert_array_equal(presses.background, BALLS.background)
    for number, (image, label) in enumerate(presses.read_presses(range(len(presses)))):
        np.testing.assert_array_equal(image, BALLS.images[number])
        known = BALLS.read_press(number)[1]
        np.testing.assert_allclose(label.indentation_m, known.indentation_m, atol=1e-9)
        deeper = (BALLS.indentation_m[number] - label.indentation_m)[label.contact]
        np.testing.assert_allclose(deeper, deeper[0], atol=1e-9)  # the unknown depth of the visible circle
        np.testing.assert_array_equal(label.known, known.known)


def test_images_and_labels_are_reduced_together(tmp_path):
    larger = magnified(BALLS, 3)
    presses = read_presses(larger.write(tmp_path), larger.geometry, size_px=(GEOMETRY.width_px, GEOMETRY.height_px))
    assert presses.geometry.is_same_sensor(GEOMETRY)
    assert presses.camera is larger.geometry
    np.testing.assert_array_equal(presses.background, BALLS.background)
    for number, (image, label) in enumerate(presses.read_presses(range(len(presses)))):
        np.testing.assert_array_equal(image, BALLS.images[number])
        np.testing.assert_allclose(label.indentation_m, BALLS.read_press(number)[1].indentation_m, atol=1e-9)


@pytest.mark.parametrize("size_px", [(64, 32), (128, 128), (0, 0)])
def test_a_reduced_size_of_another_shape_or_larger_is_refused(folder, size_px):
    with pytest.raises(CalibrationError, match=naming("64 x 64 px", f"{size_px[0]} x {size_px[1]}")):
        read_presses(folder, GEOMETRY, size_px=size_px)


def test_the_background_is_the_mean_of_its_images(folder):
    write_image(folder / "brighter.png", np.minimum(BALLS.background, 200) + np.uint8(4))
    rows = [*BALLS.rows(), {"image": "brighter.png", "kind": "background"}]
    write_table(folder, rows)
    found = read_presses(folder, GEOMETRY).background
    dark = BALLS.background <= 200
    np.testing.assert_array_equal(found[dark], BALLS.background[dark] + 2)


def test_the_median_of_many_presses_shows_the_untouched_gel(folder, tmp_path):
    refused(folder, "3 presses", str(FOR_MEDIAN), "background", median=True)
    many = ball_set(15, seed=3)
    many.write(tmp_path)
    write_table(tmp_path, many.rows()[1:])
    found = read_presses(tmp_path, GEOMETRY, median_background=True).background
    off, pressed_off = (np.abs(image.astype(int) - many.background).mean() for image in (found, many.images[0]))
    assert off < 0.3 * pressed_off


NUMBERS = ["center_x_px", "center_y_px", "radius_px", "ball_radius_mm"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        *(({column: ""}, (column, "ball")) for column in NUMBERS),
        *(({column: "9;5"}, (column, "'9;5'", "ball")) for column in NUMBERS),
        *(({column: "nan"}, (column, "nan", "ball")) for column in NUMBERS),
        *(({column: "inf"}, (column, "inf", "ball")) for column in NUMBERS),
        ({"center_x_px": 70}, ("(70, ", "64 x 64 px")),
        ({"center_y_px": -3}, (", -3)", "64 x 64 px")),
        ({"radius_px": 30}, ("30 px", "7.5 mm", "3 mm")),
        ({"radius_px": 0}, ("0 px", "3 mm")),
        ({"ball_radius_mm": -3}, ("-3 mm",)),
        ({"kind": "bull"}, ("'bull'", "background", "ball")),
        ({"kind": ""}, ("0001.png", "kind")),
        ({"image": ""}, ("image",)),
        ({"image": "none.png"}, ("none.png",)),
        ({"image": "sensor.toml"}, ("sensor.toml", "colour")),
        ({"image": "."}, ("colour",)),
    ],
)
def test_a_wrong_value_is_refused_with_its_line(folder, changes, words):
    change(folder, 4, **changes)
    refused(folder, "line 4", *words)


def test_the_reported_line_number_counts_empty_lines(folder):
    change(folder, 4, kind="bull")
    text = (folder / "presses.csv").read_text().splitlines()
    (folder / "presses.csv").write_text("\n".join([*text[:2], "", "", *text[2:]]))
    refused(folder, "line 6", "'bull'")


def test_all_images_must_be_whole_and_have_the_size_of_the_sensor(folder):
    write_image(folder / "0002.png", BALLS.background[:48])
    refused(folder, "line 5", "0002.png", "64 x 48 px", "64 x 64 px")
    whole = (folder / "0001.png").read_bytes()
    (folder / "0001.png").write_bytes(whole[: len(whole) // 2])
    refused(folder, "line 4", "0001.png", "damaged")
    with pytest.raises(CalibrationError, match=naming("line 2", "background.png", "64 x 64 px", "32 x 32 px")):
        read_presses(folder, dataclasses.replace(GEOMETRY, width_px=32, height_px=32))


def test_an_unreadable_or_missing_table_and_a_table_without_a_required_column_are_refused(folder):
    for column in ("image", "kind"):
        write_table(folder, BALLS.rows(), [name for name in COLUMNS if name != column])
        refused(folder, f"column {column!r}")
    table = folder / "presses.csv"
    table.write_bytes(b"\xffimage,kind")
    refused(folder, "presses.csv")
    table.unlink()
    refused(folder, "presses.csv")


def test_a_table_without_presses_or_untouched_gel_is_refused(folder):
    write_table(folder, BALLS.rows()[:1])
    refused(folder, "ball")
    write_table(folder, [])
    refused(folder, "presses.csv", "press")
    write_table(folder, BALLS.rows()[1:])
    refused(folder, "background", "`background` median")


READ_AT = {(320, 240): (160, 120), (240, 320): (120, 160), (640, 480): (160, 120), (470, 470): (157, 157)}


@pytest.mark.parametrize(("camera", "reading"), [*READ_AT.items(), *(((px, px), (px, px)) for px in (64, 200))])
def test_the_chosen_image_size_suits_locating(camera, reading):
    width, height = camera
    geometry = SensorGeometry("orthographic", width, height, 1e4, 1e4, width / 2, height / 2, 0.01, 1e-3)
    assert choose_size_px(geometry) == reading
