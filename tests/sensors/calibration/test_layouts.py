"""Photos of presses are recognised in the layouts of other tools, and labelled ones are converted."""

import csv
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import BALL_M, MM, ball_set, write_image
from public_sets import CIRCLES, PUBLIC_SETS

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.sensors.calibration.frames import read_frames
from tactile_loc.sensors.calibration.layouts import LAYOUTS, convert_presses, find_photos, recognise_set
from tactile_loc.sensors.calibration.press_table import read_rows
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.sensors.calibration.untouched import is_named_untouched

BALLS = ball_set(3)
MM_PER_PX = 0.25
EACH = pytest.mark.parametrize("format", PUBLIC_SETS)


def write(format: str, folder: Path) -> Path:
    return PUBLIC_SETS[format](folder, BALLS.images, BALLS.background)


@pytest.fixture
def source(format: str, tmp_path: Path) -> Path:
    return write(format, tmp_path / "source")


@EACH
def test_a_converted_set_keeps_images_and_circles_and_can_be_read_for_calibration(format, source, tmp_path):
    table = convert_presses(source, tmp_path / "out", BALL_M / MM, MM_PER_PX)
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
        if format == "py3dcal":  # its press depths are at most the ball's radius
            radius = min(radius, BALL_M / MM / MM_PER_PX)
        assert found == pytest.approx([x + 0.5, y + 0.5, radius, 3.0], abs=1e-3)
    sensor = read_sensor_file(table.with_name("sensor.toml"))
    assert sensor.view == pytest.approx(BALLS.geometry.view)
    if format == "fots":  # has no untouched gel
        with pytest.raises(CalibrationError, match="`background` median"):
            read_presses(tmp_path / "out", sensor)
    else:
        assert len(read_presses(tmp_path / "out", sensor)) == 3


def refused(source: Path, out: Path, *words: str) -> None:
    with pytest.raises(CalibrationError, match=naming(source, *words)):
        convert_presses(source, out, BALL_M / MM, MM_PER_PX)
    assert not out.exists()


TOOLS = {"gs_sdk": "gs_sdk", "taxim": "Taxim", "fots": "FOTS", "circles": "list of circles", "py3dcal": "py3DCal"}


@EACH
def test_a_labelled_set_is_named_and_a_damaged_one_is_refused(format, source, tmp_path):
    assert TOOLS[format] in recognise_set(source).describe()
    assert "its circles are used" in recognise_set(source).describe()
    labels = {
        "gs_sdk": "10/label.npz", "taxim": "", "fots": "csv/annotate.csv", "circles": "labels.txt",
        "py3dcal": "sensor_calibration_data/annotations/annotations.csv",
    }  # fmt: skip
    path = source / labels[format]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - (20 if path.suffix == ".npz" else 8)])
    refused(source, tmp_path / "out")
    path.write_bytes(whole)
    if format == "taxim":
        np.savez(source, imgs=BALLS.images, f0=BALLS.background)
    else:
        max(file for file in source.rglob("*.png") if file.name not in ("background.png", "blank.png")).unlink()
    refused(source, tmp_path / "out")


def test_a_malformed_circle_line_a_set_without_presses_and_an_unknown_scale_are_refused(tmp_path):
    circles, fots = (write(format, tmp_path / format) for format in ("circles", "fots"))
    with pytest.raises(CalibrationError, match=naming("`ball_radius`", "`mm_per_px`")):
        convert_presses(circles, tmp_path / "out")
    with (circles / "labels.txt").open("a") as file:
        file.write("press_0.png 20 31\n")
    refused(circles, tmp_path / "out", "'press_0.png 20 31'", "image (x, y) radius")
    (fots / "csv" / "annotate.csv").write_text("img_names,center_x,center_y,radius\n")
    refused(fots, tmp_path / "out", "no circles")


def test_some_sets_state_ball_and_scale(tmp_path):
    table = convert_presses(write("py3dcal", tmp_path / "probed"), tmp_path / "out")
    assert [row.read_number("ball_radius_mm") for row in read_rows(table) if row.kind == "ball"] == [3.0] * 3
    assert read_sensor_file(table.with_name("sensor.toml")).view == pytest.approx(BALLS.geometry.view)
    balls = write("gs_sdk", tmp_path / "balls")
    (balls / "catalog.csv").write_text("experiment_reldir,diameter(mm)\n2,6.0\n10,6.0\n11,6.0\n")
    assert recognise_set(balls).ball_radius_mm == 3.0
    (balls / "catalog.csv").write_text("experiment_reldir,diameter(mm)\n2,6.0\n10,8.0\n11,6.0\n")
    refused(balls, tmp_path / "other", "6, 8 mm")


def test_a_table_is_recognised_by_the_names_of_its_columns(tmp_path):
    for number, image in enumerate(BALLS.images):
        write_image(tmp_path / f"{number}.png", image)
    write_image(tmp_path / "bg.png", BALLS.background)
    lines = [f"{n}.png;{x};{y};{r}" for n, (x, y, r) in enumerate(CIRCLES)]
    (tmp_path / "my labels.csv").write_text("\n".join(["Filename;cx;cy;r_px", *lines]))
    found = recognise_set(tmp_path)
    assert "my labels.csv" in found.describe()
    assert found.circles == {f"{n}.png": circle for n, circle in enumerate(CIRCLES)}
    assert [*found.photos] == ["bg.png", "0.png", "1.png", "2.png"]
    (tmp_path / "my labels.csv").write_text("time;force\n0;1\n")
    assert recognise_set(tmp_path).circles == {}


def write_folders(root: Path, *names: str) -> Path:
    """A folder for each press, with a photo of each name, and the untouched gel."""
    for number, image in enumerate(BALLS.images):
        (root / f"press {number}").mkdir(parents=True)
        for name in names:
            write_image(root / f"press {number}" / name, image)
    write_image(root / "ref.png", BALLS.background)
    return root


def write_probed(root: Path) -> Path:
    source = write("py3dcal", root)
    (source / "sensor_calibration_data" / "annotations" / "annotations.csv").unlink()
    return source


UNLABELLED = {
    "one folder per press": (lambda root: write_folders(root, "gelsight.png"), 4, "press 2/gelsight.png"),
    "a py3DCal set": (write_probed, 4, "sensor_calibration_data/probe_images/2_X2.0Y2.0Z1.0.png"),
}


@pytest.mark.parametrize("tool", UNLABELLED)
def test_unlabelled_photos_are_listed_with_the_untouched_gel(tool, tmp_path):
    write_it, count, name = UNLABELLED[tool]
    source = write_it(tmp_path / "source")
    found = recognise_set(source)
    assert (found.tool, found.circles, len(found.photos)) == (tool, {}, count)
    folder, frames = read_frames(source)
    assert name in [frame.name for frame in frames]
    assert (folder / name).is_file()
    assert any(is_named_untouched(frame.name) for frame in frames)
    with pytest.raises(CalibrationError, match=naming("no circles")):
        convert_presses(source, tmp_path / "out", 3.0, 0.2)


def test_only_the_photo_that_all_folders_share_is_a_press(tmp_path):
    source = write_folders(tmp_path / "source", "tactile.png")
    write_image(source / "press 1" / "webcam.png", BALLS.images[0])
    assert len(recognise_set(source).photos) == 4
    both = write_folders(tmp_path / "both", "tactile.png", "webcam.png")
    with pytest.raises(CalibrationError, match=naming("tactile.png", "webcam.png")):
        recognise_set(both)


def test_a_flat_folder_is_the_last_layout(tmp_path):
    assert LAYOUTS[-1] is find_photos
    with pytest.raises(CalibrationError, match=naming(tmp_path)):
        recognise_set(tmp_path)
    folder = write_folders(tmp_path, "a.png")
    for path in ("0.png", ".hidden.png", "labels.png"):
        write_image(folder / path, BALLS.images[0])
    assert [*recognise_set(folder).photos] == ["0.png", "ref.png"]


@pytest.mark.parametrize(
    ("name", "format", "lengths_mm", "count", "circle"),
    [
        ("gelsight_mini_balls", "gs_sdk", (4.735, 0.0634), 50, (196.5, 160.5, 29)),
        ("gelsight_balls_160x120/dataPack_small.npz", "taxim", (2.0, 0.1245), 49, (84.5, 66.5, 15.742)),
        ("fots_balls", "fots", (2.35, 1 / 19.58), 42, (76.5, 182.5, 38)),
        ("gelslim_balls", "circles", (2.92, 0.059259), 22, (212.5, 128.5, 26)),
        ("gelsight_dots", "circles", (2.42, 0.1), 40, (133.5, 135.5, 23)),
    ],
)
def test_public_sets_are_read_with_their_counts_and_circles(
    shared_data, tmp_path, name, format, lengths_mm, count, circle
):
    source, (x, y, radius) = shared_data / "tactile" / name, circle
    if not source.exists():
        pytest.skip(f"there is no {source}: it holds real images that are not part of the project")
    table = convert_presses(source, tmp_path, *lengths_mm)
    presses = read_presses(tmp_path, read_sensor_file(table.with_name("sensor.toml")), format == "fots")
    assert len(presses) == count
    image, label = presses.read_press(0)
    row, column = np.argwhere(label.contact).mean(axis=0) + 0.5
    assert (column, row) == pytest.approx((x, y), abs=0.1)
    assert label.contact.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    changed = np.abs(image.astype(int) - presses.background).max(axis=2)
    assert changed[label.contact].mean() > 3 * np.median(changed)  # the image has changed inside the label
