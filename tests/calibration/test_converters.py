"""Public calibration sets: their images and circles arrive as they were written down, and damaged ones are refused."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from press_sets import BALL_M, MM, ball_set, write_image

from tactile_loc.calibration.calibrate import calibrate, mean_errors
from tactile_loc.calibration.converters import FORMATS, convert
from tactile_loc.calibration.presses import read_presses
from tactile_loc.core.errors import CalibrationError
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.io.images import read_colour_image

BALLS = ball_set(3)
MM_PER_PX = 0.25
# as these sets count, from the centre of the first pixel; the last is a little larger than the ball
CIRCLES = [(20.0, 31.0, 5.0), (40.0, 12.5, 7.0), (33.0, 35.0, 13.0)]
LARGEST_PX = 0.98 * BALL_M / MM / MM_PER_PX


def write_gs_sdk(source: Path) -> Path:
    write_image(source / "background.png", BALLS.background)
    for number, image, circle in zip((2, 10, 11), BALLS.images, CIRCLES, strict=True):
        folder = source / str(number)
        folder.mkdir()
        write_image(folder / "gelsight.png", image)
        np.savez(folder / "label.npz", center=np.array(circle[:2]), radius=np.array(circle[2]))
    return source


def write_taxim(source: Path) -> Path:
    circles = np.array(CIRCLES)
    np.savez(
        source / "pack.npz", imgs=BALLS.images, f0=BALLS.background, touch_center=circles[:, :2],
        touch_radius=circles[:, 2], names=np.array(["a", "b", "c"]),
    )  # fmt: skip
    return source / "pack.npz"


def write_fots(source: Path) -> Path:
    (source / "gelsight").mkdir()
    (source / "csv").mkdir()
    lines = ["img_names,center_x,center_y,radius"]
    for number, (image, circle) in enumerate(zip(BALLS.images, CIRCLES, strict=True)):
        write_image(source / "gelsight" / f"{number}.png", image)
        lines.append(f"/somewhere/else/gelsight/{number}.png,{','.join(map(str, circle))}")
    (source / "csv" / "annotate.csv").write_text("\n".join(lines) + "\n")
    return source


def write_circles(source: Path) -> Path:
    write_image(source / "background.png", BALLS.background)
    lines = []
    for number, (image, (x, y, radius)) in enumerate(zip(BALLS.images, CIRCLES, strict=True)):
        write_image(source / f"press_{number}.png", image)
        lines.append(f"press_{number}.png ({x}, {y}) {radius}")
    (source / "labels.txt").write_text("\n".join(lines) + "\n\n")
    return source


WRITERS = {"gs_sdk": write_gs_sdk, "taxim": write_taxim, "fots": write_fots, "circles": write_circles}
EACH = pytest.mark.parametrize("format", WRITERS)


@pytest.fixture
def source(format: str, tmp_path: Path) -> Path:
    (tmp_path / "source").mkdir()
    return WRITERS[format](tmp_path / "source")


def rows(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_format_is_tested():
    assert WRITERS.keys() == FORMATS.keys()


@EACH
def test_images_and_circles_arrive(format, source, tmp_path):
    table = convert(source, tmp_path / "out", format, BALL_M / MM, MM_PER_PX)
    background = [row["image"] for row in rows(table) if row["kind"] == "background"]
    balls = [row for row in rows(table) if row["kind"] == "ball"]
    assert len(background) == (0 if format == "fots" else 1)
    for name in background:
        np.testing.assert_array_equal(read_colour_image(table.parent / name), BALLS.background)
    assert len(balls) == 3
    for row, image, (x, y, radius) in zip(balls, BALLS.images, CIRCLES, strict=True):
        np.testing.assert_array_equal(read_colour_image(table.parent / row["image"]), image)
        found = [float(row[name]) for name in ("center_x_px", "center_y_px", "radius_px", "ball_radius_mm")]
        assert found == pytest.approx([x + 0.5, y + 0.5, min(radius, LARGEST_PX), 3.0], abs=1e-3)
        assert found[2] <= LARGEST_PX


@EACH
def test_what_is_converted_can_be_calibrated_with(format, source, tmp_path):
    convert(source, tmp_path / "out", format, BALL_M / MM, MM_PER_PX)
    if format == "fots":  # has no untouched gel
        with pytest.raises(CalibrationError, match="untouched gel"):
            read_presses(tmp_path / "out", BALLS.geometry)
    else:
        assert len(read_presses(tmp_path / "out", BALLS.geometry)) == 3


def refused(source: Path, format: str, out: Path, *words: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        convert(source, out, format, BALL_M / MM, MM_PER_PX)
    for word in (str(source), format, *words):
        assert word in str(caught.value)


@EACH
def test_a_set_of_another_format_is_refused(format, source, tmp_path):
    for other in FORMATS.keys() - {format}:
        refused(source, other, tmp_path / other)


@EACH
def test_a_set_that_is_not_there_is_refused(format, tmp_path):
    refused(tmp_path / "none", format, tmp_path / "out")


@EACH
def test_a_set_with_a_damaged_label_is_refused(format, source, tmp_path):
    labels = {"gs_sdk": "10/label.npz", "taxim": "", "fots": "csv/annotate.csv", "circles": "labels.txt"}
    path = source / labels[format]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - (20 if path.suffix == ".npz" else 8)])
    refused(source, format, tmp_path / "out")


@EACH
def test_a_set_without_its_images_is_refused(format, source, tmp_path):
    if format == "taxim":
        np.savez(source, imgs=BALLS.images, f0=BALLS.background)
    else:
        images = [path for path in source.rglob("*.png") if path.name != "background.png"]
        images[-1].unlink()
    refused(source, format, tmp_path / "out")


def test_a_line_that_is_no_circle_is_not_passed_over(tmp_path):
    (tmp_path / "source").mkdir()
    source = write_circles(tmp_path / "source")
    with (source / "labels.txt").open("a") as file:
        file.write("press_0.png 20 31 5\n")
    refused(source, "circles", tmp_path / "out", "'press_0.png 20 31 5'", "image (x, y) radius")


def test_a_set_without_presses_is_refused(tmp_path):
    (tmp_path / "source").mkdir()
    source = write_fots(tmp_path / "source")
    (source / "csv" / "annotate.csv").write_text("img_names,center_x,center_y,radius\n")
    refused(source, "fots", tmp_path / "out", "no press")


def test_an_unknown_format_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match=r"'gelsight'.*gs_sdk, taxim, fots, circles"):
        convert(tmp_path, tmp_path / "out", "gelsight", 3.0, 0.1)


# What the public sets say of their first presses: where, in which format, ball radius and pixel in mm, image size and
# number of presses, and the first one's circle.
PUBLIC = {
    "gelsight_mini_balls": ("gs_sdk", "", 4.735, 0.0634, (240, 320), 50, (196.5, 160.5, 29)),
    "gelsight_balls_160x120": ("taxim", "dataPack_small.npz", 2.0, 0.1245, (120, 160), 49, (84.5, 66.5, 15.742)),
    "fots_balls": ("fots", "", 2.35, 1 / 19.58, (320, 240), 42, (76.5, 182.5, 38)),
    "gelslim_balls": ("circles", "", 2.92, 0.059259, (320, 320), 22, (212.5, 128.5, 26)),
}


@pytest.fixture
def public(shared_data: Path, tmp_path: Path):
    """Convert a public set, of which no copy is part of the project, and read it."""

    def read(name: str):
        format, file, ball_mm, mm_per_px, (height, width), *_ = PUBLIC[name]
        source = shared_data / "tactile" / name / file
        if not source.exists():
            pytest.skip(f"there is no {source}: it holds real images that are not part of the project")
        table = convert(source, tmp_path / name, format, ball_mm, mm_per_px)
        k = 1e3 / mm_per_px
        geometry = SensorGeometry("orthographic", width, height, k, k, width / 2, height / 2, 0.01, 1.5e-3)
        return read_presses(table.parent, geometry, median_background=format == "fots")

    yield read
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_sets_are_read_as_they_are(public, name):
    *_, count, (x, y, radius) = PUBLIC[name]
    presses = public(name)
    assert len(presses) == count
    image, label = presses.press(0)
    row, column = np.argwhere(label.contact).mean(axis=0) + 0.5
    assert (column, row) == pytest.approx((x, y), abs=0.1)
    assert label.contact.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    changed = np.abs(image.astype(int) - presses.background).max(axis=2)
    assert changed[label.contact].mean() > 3 * np.median(changed)  # where the label says, the image has changed


def test_a_real_sensor_is_learned_in_a_few_steps(public):
    presses = public("gelslim_balls")
    found = calibrate(presses, presses.geometry, presses.background, "photometric", {"steps": 150, "hidden": 16})
    mean = mean_errors(found.errors)
    assert mean["slope_deg"] < 5
    assert mean["shape_m"] < 8e-5
