"""A folder of presses: every kind of row, every fault of a row, and the size of images."""

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import naming
from press_sets import COLUMNS, MM, ball_set, magnified, places, write_image, write_table

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.presses import FOR_MEDIAN, choose_size_px, read_presses

BALLS = ball_set(3)
GEOMETRY = BALLS.geometry
POSE = {"x_mm": 1, "y_mm": -0.5, "roll_deg": 0, "pitch_deg": 0, "yaw_deg": 90}
BOX = {"mesh": "box.stl", "units": "mm", **POSE, "press_mm": 0.4}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with three presses of a ball, and the mesh of a box in mm."""
    trimesh.creation.box((6, 3, 4)).export(tmp_path / "box.stl")
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


def test_a_mesh_is_pressed_at_its_pose(folder, caplog):
    change(folder, 4, kind="mesh", **BOX)
    with caplog.at_level(logging.WARNING):
        presses = read_presses(folder, GEOMETRY)
    assert not caplog.records  # the table names the unit
    label = presses.label(1)
    x, y = (v / MM for v in places(GEOMETRY))
    beyond = np.maximum(np.abs(x - 1) - 1.5, np.abs(y + 0.5) - 3)  # rotated by 90 degrees
    assert label.contact[beyond < -0.25].all()
    assert not label.contact[beyond > 0.25].any()
    np.testing.assert_allclose(label.indentation_m[beyond < -0.25], 4e-4, rtol=1e-4)
    assert label.absolute
    assert not presses.label(0).absolute


@pytest.mark.parametrize(("angle", "edge_mm"), [("roll_deg", (-1.5, -2)), ("pitch_deg", (3, -2))])
def test_a_tilted_mesh_is_deepest_at_its_lowest_edge(folder, angle, edge_mm):
    change(folder, 3, kind="mesh", **(BOX | {"x_mm": 0, "y_mm": 0, "yaw_deg": 0, angle: 10}))
    label = read_presses(folder, GEOMETRY).label(0)
    turn = np.radians(10 if angle == "roll_deg" else -10)  # in the plane of y and z, or of x and z
    edge = np.cos(turn) * edge_mm[0] - np.sin(turn) * edge_mm[1]
    across, along = (v / MM for v in (places(GEOMETRY) if angle == "pitch_deg" else places(GEOMETRY)[::-1]))
    deepest = label.indentation_m > 0.9 * label.indentation_m.max()
    assert across[deepest].mean() == pytest.approx(edge, abs=0.3)  # a pixel is 0.25 mm
    assert np.ptp(along[label.contact]) == pytest.approx(6 if angle == "roll_deg" else 3, abs=0.3)


def test_the_unit_scales_the_mesh_and_paths_are_relative_to_the_table(folder):
    (folder / "images").mkdir()
    (folder / "0000.png").rename(folder / "images" / "0000.png")
    change(folder, 3, image="images/0000.png", kind="mesh", **(BOX | {"units": "cm", "x_mm": 0, "y_mm": 0}))
    assert read_presses(folder, GEOMETRY).label(0).contact.all()  # 60 x 30 mm


NUMBERS = ["center_x_px", "center_y_px", "radius_px", "ball_radius_mm"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (BOX | {"mesh": ""}, ("mesh",)),
        (BOX | {"mesh": "bax.stl"}, ("bax.stl",)),
        (BOX | {"mesh": "background.png"}, ("background.png", "mesh")),
        (BOX | {"yaw_deg": ""}, ("yaw_deg", "mesh")),
        (BOX | {"press_mm": ""}, ("press_mm",)),
        (BOX | {"press_mm": "0"}, ("press depth", "0 mm")),
        (BOX | {"press_mm": "-0.3"}, ("press depth", "-0.3 mm")),
        (BOX | {"x_mm": "100"}, ("box",)),
        (BOX | {"roll_deg": "steep"}, ("roll_deg", "'steep'")),
        (BOX | {"units": "feet"}, ("'feet'", "mm")),
        *(({column: ""}, (column, "ball")) for column in NUMBERS),
        *(({column: "9;5"}, (column, "'9;5'", "ball")) for column in NUMBERS),
        *(({column: "nan"}, (column, "nan", "ball")) for column in NUMBERS),
        *(({column: "inf"}, (column, "inf", "ball")) for column in NUMBERS),
        ({"center_x_px": 70}, ("(70, ", "64 x 64 px")),
        ({"center_y_px": -3}, (", -3)", "64 x 64 px")),
        ({"radius_px": 30}, ("30 px", "7.5 mm", "3 mm")),
        ({"radius_px": 0}, ("0 px", "3 mm")),
        ({"ball_radius_mm": -3}, ("-3 mm",)),
        ({"kind": "bull"}, ("'bull'", "background", "ball", "mesh")),
        ({"kind": ""}, ("0001.png", "kind")),
        ({"image": ""}, ("image",)),
        ({"image": "none.png"}, ("none.png",)),
        ({"image": "box.stl"}, ("box.stl", "colour")),
        ({"image": "."}, ("colour",)),
    ],
)
def test_a_wrong_value_is_refused_with_its_line(folder, changes, words):
    change(folder, 4, **({"kind": "mesh"} if "mesh" in changes else {}), **changes)
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
    refused(folder, "ball", "mesh")
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
