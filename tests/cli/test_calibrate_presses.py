"""`tactile-loc calibrate FOLDER`: from photos of presses to a sensor that locates an object in a photo."""

import json
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cli_helpers import Cli, assert_refused, succeed
from PIL import Image
from press_sets import MM, ball_set, is_same_camera, magnified, sensor, write_image, write_table

from tactile_loc.io.sensor_files import write_sensor_file
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.reading.photometric import PhotometricEstimator

BALLS = ball_set(16, px=80)
STEPS = ["-o", "steps=300", "-o", "hidden=16"]
FEW = ["-o", "steps=2", "-o", "hidden=4"]
GRID = ["--grid", "face", "-o", "grid.spacing_mm=2.5"]
ELL = ["--object", "ell.stl", "--units", "mm", "--symmetry", "none"]

NOT_ITS_IMAGES = {
    "small": (BALLS.background[:40], "80 x 40 px"),
    "black": (0 * BALLS.background, "black"),
    "grey": (BALLS.background[..., 0], "8-bit colour photo"),
    "alpha": (np.dstack([BALLS.background, BALLS.background[..., 0]]), "transparent"),
    "other": (render_background(BALLS.geometry, OPTICS["digit"]), "sensor"),
}


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def presses(cli: Cli) -> Path:
    """A folder of presses in the working folder."""
    return BALLS.write(Path("presses"))


def write_ell(path: Path) -> None:
    """Write an L-shaped part of 9 x 8.5 x 4 mm."""
    parts = [trimesh.creation.box((9, 3, 4)), trimesh.creation.box((3, 7, 4))]
    parts[1].apply_translation([3, 5, 0])
    trimesh.util.concatenate(parts).export(path)


def add_m(found: list, true: list) -> float:
    """The mean distance between the part's corners at two poses, in metres."""
    corners = MM * np.array(
        [[-4.5, -1.5, 2], [4.5, -1.5, 2], [4.5, 8.5, 2], [1.5, 8.5, 2], [-4.5, 1.5, -2], [3, 3, -2]]
    )
    R, t = np.subtract(found, true)[:3, :3], np.subtract(found, true)[:3, 3]
    return float(np.linalg.norm(corners @ R.T + t, axis=1).mean())


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_a_sensor_calibrated_from_photos_locates_a_photo(cli, presses):
    done = succeed(cli("calibrate", presses, *STEPS, "--out", "mine"))
    assert "3 of 16" in done.stdout
    assert re.search(r"angle.*\d", done.stdout)
    assert "--sensor mine --touch IMAGE" in done.stdout
    calibration = read_calibration(Path("mine"))
    assert is_same_camera(calibration.geometry, BALLS.geometry)
    assert calibration.geometry.gel.is_elastic
    assert calibration.record["presses"] == 16
    assert calibration.record["held_out"]["mean"]["slope_deg"] < 2
    assert calibration.noise_m < 2e-5
    with Image.open("mine/held-out.png") as picture:
        assert min(picture.size) > 300

    write_ell(Path("ell.stl"))
    succeed(
        cli("simulate", *ELL, "--sensor", "mine", "--images", "--count", 8, "--press-depth", 0.8, "--out", "sim", *GRID)
    )
    record = json.loads(Path("sim/poses.json").read_text())["T_sensor_object"]
    contact = {}
    for name in record:
        with np.load(f"sim/{name}.npz") as touch:
            contact[name] = int((touch["depth"] < np.float32(touch["press_depth"])).sum())
    most = max(contact, key=contact.__getitem__)
    succeed(cli("run", *ELL, "--sensor", "mine", "--touch", f"sim/{most}.png", "--out", "out", *GRID))
    result = json.loads(Path("out/result.json").read_text())
    assert add_m(result["hypotheses"][0]["T_sensor_object"], record[most]) < 2e-3
    assert Path("out/result.png").is_file()

    refused = cli("run", *ELL, "--sensor", "mine", "--touch", "mine/background.png", "--out", "none", *GRID)
    assert_refused(refused, "mine/background.png", " mm")
    for name, (image, words) in NOT_ITS_IMAGES.items():
        photo = write_image(Path(f"{name}.png"), image)
        assert_refused(
            cli("run", *ELL, "--sensor", "mine", "--touch", photo, "--out", "none", *GRID), photo.name, words
        )
    assert not Path("none").exists()


@pytest.mark.slow
def test_image_size_sets_the_size_of_the_calibrated_images(cli, presses):
    larger = magnified(BALLS, 2)
    larger.write(Path("larger"))
    succeed(cli("calibrate", "larger", "--image-size", 80, 80, *FEW, "--out", "reduced"))
    reduced = read_calibration(Path("reduced"))
    assert reduced.camera_px == (160, 160)
    assert is_same_camera(reduced.geometry, BALLS.geometry)
    of_large = reduced.read(larger.images[3]).indentation_m
    np.testing.assert_array_equal(reduced.read(BALLS.images[3]).indentation_m, of_large)
    assert_refused(cli("calibrate", presses, *FEW, "--image-size", 90, 80), "80 x 80", "90 x 80")


def test_a_public_set_needs_no_table(cli, presses):
    lines = [f"{n:04d}.png ({x - 0.5}, {y - 0.5}) {r}" for n, (x, y, r) in enumerate(BALLS.circles)]
    (presses / "labels.txt").write_text("\n".join(lines))
    (presses / "presses.csv").unlink()
    (presses / "sensor.toml").unlink()
    words = ["--ball-radius", 3, "--mm-per-px", 0.2]
    succeed(cli("calibrate", presses, *words, *FEW, "--out", "mine"))
    found = read_calibration(Path("mine")).geometry
    assert found.shape == (80, 80)
    assert found.view == pytest.approx(BALLS.geometry.view)
    assert_refused(cli("calibrate", presses), "--ball-radius", "--mm-per-px")
    assert_refused(cli("calibrate", presses, *words[:2], "--mm-per-px", -1), "positive")


def test_an_error_of_a_public_set_names_the_users_folder(cli, presses):
    (presses / "labels.txt").write_text(
        "\n".join(f"{n:04d}.png ({x}, {y}) {r}" for n, (x, y, r) in enumerate(BALLS.circles))
    )
    (presses / "presses.csv").unlink()
    (presses / "0003.png").write_bytes((presses / "0003.png").read_bytes()[:500])
    refused = cli("calibrate", presses, "--ball-radius", 3, "--mm-per-px", 0.2, *FEW)
    assert_refused(refused, f"{presses}/0003.png", f"presses.csv made from {presses}")
    assert tempfile.gettempdir() + "/tmp" not in refused.stderr


def test_the_median_of_the_presses_may_be_the_background(cli, presses):
    write_table(presses, BALLS.rows()[1:])
    assert_refused(cli("calibrate", presses), "background", "--background median")
    succeed(cli("calibrate", presses, "--background", "median", *FEW, "--out", "mine"))
    assert np.abs(read_calibration(Path("mine")).background.astype(int) - BALLS.background).mean() < 2


BAD = {
    "no table": (lambda f: (f / "presses.csv").unlink(), ("presses.csv", "table")),
    "few presses": (lambda f: write_table(f, BALLS.rows()[:4]), ("3 presses", "5")),
    "no sensor": (lambda f: (f / "sensor.toml").unlink(), ("sensor.toml", "--sensor")),
    "another sensor": (lambda f: write_sensor_file(f / "sensor.toml", sensor(32)), ("80 x 80 px", "32 x 32 px")),
}


@pytest.mark.parametrize("what", BAD)
def test_each_fault_of_a_folder_is_one_sentence(cli, presses, what):
    spoil, words = BAD[what]
    spoil(presses)
    assert_refused(cli("calibrate", presses, *FEW, "--out", "mine"), *words)
    assert not Path("mine").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none"], ("none", "folder")),
        (["presses", "-o", "stepz=3"], ("estimator", "'stepz'", "'steps'")),
        (["presses", "-o", "steps=many"], ("steps", "'many'", "whole number")),
        (["presses", "-o", "steps=0"], ("estimator", "steps", "0")),
        (["presses", "-o", "steps"], ("steps", "OPTION=VALUE")),
    ],
)
def test_a_missing_folder_or_a_wrong_estimator_option_is_refused(cli, presses, words, said):
    assert_refused(cli("calibrate", *words, "--out", "mine"), *said)
    assert not Path("mine").exists()


def test_an_unusable_output_path_is_refused_before_training(cli, presses, monkeypatch):
    monkeypatch.setattr(PhotometricEstimator, "fit", None)
    before = sorted(os.listdir(presses))
    new = ["-o", "seed=99"]  # not in the store
    assert_refused(cli("calibrate", presses, *FEW, *new, "--out", presses), presses.name, "--out")
    assert sorted(os.listdir(presses)) == before
    Path("file").write_text("mine")
    assert_refused(cli("calibrate", presses, *FEW, "--out", "file"), "file", "--out")
    assert_refused(cli("calibrate", presses, *FEW, "--out", "file/deeper"), "file", "--out")
