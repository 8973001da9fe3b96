"""A calibrated sensor: images become contact shapes, and contact shapes are kept."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import (
    BALL_M,
    ball_indentation,
    ball_set,
    contact_radius,
    photographed,
    places,
    write_calibrated,
    write_image,
)

from tactile_loc import ContactShape, NoContactError, Touch, read_touch
from tactile_loc.plugin import TouchError, registry
from tactile_loc.plugins.sensors.calibrated import CalibratedSensor
from tactile_loc.sensors.reading.reading import SKIRT

BALLS = ball_set(12)
PRESS_M = 7e-4


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_calibrated(tmp_path_factory.mktemp("calibrated") / "sensor", BALLS, steps=500)


@pytest.fixture(scope="module")
def sensor(folder: Path) -> CalibratedSensor:
    return registry().create("sensor", "calibrated", {"path": str(folder)})


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return ball_indentation(BALLS.geometry, 1.2e-3, -1e-3, PRESS_M)


@pytest.fixture(scope="module")
def photo(truth: np.ndarray) -> np.ndarray:
    image = photographed(truth[None], BALLS.geometry)[0]
    image.flags.writeable = False
    return image


def test_the_untouched_gel_is_no_contact_for_a_wrong_estimator(folder):
    sensor = registry().create("sensor", "calibrated", {"path": str(folder)})
    estimator, wrong = sensor.calibration.estimator, ball_indentation(BALLS.geometry, press_m=8e-5)
    read = estimator.read
    estimator.read = lambda image: (read(image)[0] + wrong, read(image)[1])
    with pytest.raises(NoContactError, match=naming("0.1 mm")):
        sensor.contact_shape(BALLS.background)


def test_an_image_of_a_ball_gives_the_contact_shape_of_the_ball(sensor, photo):
    shape = sensor.contact_shape(photo)
    assert isinstance(shape, ContactShape)
    assert shape.depth_m.dtype == np.float32
    assert shape.press_depth_m == pytest.approx((1 - SKIRT) * PRESS_M, rel=0.15)
    x, y = places(BALLS.geometry)
    rho = np.hypot(x - 1.2e-3, y + 1e-3)
    true = rho < contact_radius(shape.press_depth_m)
    assert (shape.contact & true).sum() > 0.8 * (shape.contact | true).sum()
    rise = BALL_M - np.sqrt(BALL_M**2 - rho**2, where=true, out=np.full_like(rho, BALL_M))
    inner = rho < 0.7 * contact_radius(shape.press_depth_m)
    assert np.sqrt(np.mean((shape.depth_m - rise)[inner] ** 2)) < 4e-5
    Touch(shape, sensor.geometry)


def test_an_image_without_contact_gives_an_error(sensor):
    for image in (BALLS.background, BALLS.background + np.uint8(1)):
        with pytest.raises(NoContactError, match=naming("0.05 mm")):
            sensor.contact_shape(image)


def test_contact_shapes_stay_unchanged(sensor, truth):
    depth = np.where(truth > 0, PRESS_M - truth, np.nan)
    shape = sensor.contact_shape(depth)
    np.testing.assert_array_equal(shape.contact, truth > 0)
    np.testing.assert_allclose(shape.depth_m[truth > 0], depth[truth > 0], atol=1e-9)
    with pytest.raises(TouchError, match=naming("(20, 64)", "(64, 64)")):
        sensor.contact_shape(depth[:20])


def test_images_of_other_sensors_are_refused(sensor, photo):
    for image, value in ((photo[:50], "64 x 50 px"), (photo[..., 1], "(64, 64)"), (0 * photo, "black")):
        with pytest.raises(TouchError, match=naming(value)):
            sensor.contact_shape(image)


def brighter(image: np.ndarray) -> np.ndarray:
    return np.clip(1.1 * image.astype(float), 0, 255).astype(np.uint8)


def with_zero(folder: Path, image: np.ndarray, path: Path) -> CalibratedSensor:
    return CalibratedSensor(CalibratedSensor.Options(path=str(folder), zero=str(write_image(path, image))))


def test_a_changed_light_is_refused_until_a_new_zero_image_is_given(sensor, folder, photo, truth, tmp_path):
    with pytest.raises(TouchError, match=naming("light", "`zero`")):
        sensor.contact_shape(brighter(photo))
    zeroed = with_zero(folder, brighter(BALLS.background), tmp_path / "zero.png")
    found = zeroed.contact_shape(brighter(photo))
    usual = sensor.contact_shape(photo)
    assert (found.contact & usual.contact).sum() > 0.85 * (found.contact | usual.contact).sum()
    assert zeroed.describe() != sensor.describe()


def test_lamps_of_other_colours_are_refused_in_spite_of_a_zero_image(folder, photo, tmp_path):
    def other(image: np.ndarray) -> np.ndarray:
        """The untouched gel looks the same, but a touch changes other colours."""
        difference = image.astype(int) - BALLS.background
        return np.clip(BALLS.background + difference[..., [1, 2, 0]], 0, 255).astype(np.uint8)

    zeroed = with_zero(folder, BALLS.background, tmp_path / "zero.png")
    with pytest.raises(TouchError, match=naming("surface", "`zero`")):
        zeroed.contact_shape(other(photo))


def test_a_calibration_without_health_data_is_read(folder, photo, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    record = json.loads((copy / "calibration.json").read_text())
    del record["health"]
    (copy / "calibration.json").write_text(json.dumps(record))
    assert CalibratedSensor(CalibratedSensor.Options(path=str(copy))).contact_shape(photo).contact.any()


def test_a_photo_file_is_read(sensor, photo, tmp_path):
    path = write_image(tmp_path / "photo.png", photo)
    touch = read_touch(path, sensor)
    np.testing.assert_array_equal(touch.contact_shape.depth_m, sensor.contact_shape(photo).depth_m)
    lighter = read_touch(path, sensor, press_depth_m=1e-4)
    assert lighter.press_depth_m == pytest.approx(1e-4)
    assert lighter.contact_shape.contact.sum() < touch.contact_shape.contact.sum()
    untouched = write_image(tmp_path / "gel.png", BALLS.background)
    with pytest.raises(TouchError, match=naming("gel.png", "0.05 mm")):
        read_touch(untouched, sensor)


def test_a_home_folder_is_found(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder.parent))
    assert CalibratedSensor(CalibratedSensor.Options(path="~/sensor")).geometry.shape == (64, 64)
