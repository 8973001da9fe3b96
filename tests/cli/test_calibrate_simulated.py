"""`tactile-loc calibrate --simulated`: a sensor calibrated on simulated presses."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import assert_refused, succeed
from PIL import Image

from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.plugins.sensors.calibrated import CalibratedSensor
from tactile_loc.plugins.sensors.presets import GelSlim
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.reading.reading import reduce_image

SENSOR = """\
camera = "orthographic"
image_size_px = [48, 40]
max_depth_mm = 2.0
mm_per_px = 0.4
"""
TINY = {
    "photometric": ["--estimator", "photometric", "-o", "steps=20"],
    "cnn": ["--estimator", "cnn", "-o", "channels=4", "-o", "epochs=1"],
}


@pytest.fixture
def calibrate(cli):
    Path("sensor.toml").write_text(SENSOR)
    return lambda *words: cli("calibrate", "--simulated", "--presses", 12, *words)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", TINY)
@pytest.mark.usefixtures("drawn_pictures")
def test_the_sensor_is_calibrated_under_the_chosen_lamps(calibrate, estimator):
    done = calibrate("--sensor", "sensor.toml", "--optics", "digit", *TINY[estimator], "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert "2 of 12" in done.stdout
    calibration = read_calibration(Path("out"))
    assert calibration.record["estimator"] == estimator
    assert calibration.record["presses"] == 12
    assert calibration.record["simulated"]["optics"] == OPTICS["digit"].describe()
    assert calibration.geometry.describe() == read_sensor_file(Path("sensor.toml")).describe()
    assert np.array_equal(calibration.background, render_background(calibration.geometry, OPTICS["digit"]))
    assert calibration.estimator.read_indentation(calibration.background).shape == (40, 48)
    with Image.open("out/held-out.png") as picture:
        assert min(picture.size) > 100


@pytest.mark.slow
def test_equal_seeds_give_equal_weights(calibrate):
    words = ["--sensor", "sensor.toml", *TINY["cnn"]]
    for out, seed in (("a", 1), ("b", 1), ("c", 2)):
        done = calibrate(*words, "--seed", seed, "--out", out)
        assert done.exit_code == 0, done.stderr
    a, b, c = (Path(name, "estimator.safetensors").read_bytes() for name in "abc")
    assert a == b != c
    record = json.loads(Path("a/calibration.json").read_text())
    assert record["simulated"]["optics"] == OPTICS["gelslim"].describe()  # the default lamps


@pytest.mark.slow
def test_a_built_in_sensor_also_reads_full_size_camera_images(cli):
    succeed(cli("calibrate", "--simulated", "--presses", 8, *TINY["photometric"], "--out", "mine"))
    sensor = CalibratedSensor(CalibratedSensor.Options(path="mine"))
    assert (sensor.geometry.shape, sensor.calibration.camera_px) == ((200, 200), (470, 470))
    native, small = render_background(GelSlim.native, OPTICS["gelslim"]), sensor.calibration.background
    assert np.abs(reduce_image(native, (200, 200)).astype(int) - small).max() <= 1
    np.testing.assert_array_equal(
        sensor.calibration.read_indentation(native),
        sensor.calibration.read_indentation(reduce_image(native, (200, 200))),
    )


def test_exactly_one_source_of_presses_is_required(cli, calibrate):
    assert_refused(calibrate("somewhere"), "--simulated", "FOLDER")
    assert_refused(calibrate("--image-size", 20, 20), "--image-size")
    assert_refused(cli("calibrate"), "FOLDER", "--simulated")
    assert_refused(cli("calibrate", "somewhere", "--optics", "digit"), "--optics", "--simulated")
    assert not Path("my_sensor").exists()


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        (["--optics", "gelslam"], ["gelslam", "gelslim"]),
        (["--sensor", "depth"], ["depth", "gelslim"]),
        (["--sensor", "none.toml"], ["none.toml"]),
        (["--estimator", "cnn", "-o", "depth=3"], ["cnn", "depth", "dilations"]),
    ],
)
def test_unknown_names_are_refused_before_anything_is_written(calibrate, words, mentioned):
    assert_refused(calibrate(*words, "--out", "out"), *mentioned)
    assert not Path("out").exists()
