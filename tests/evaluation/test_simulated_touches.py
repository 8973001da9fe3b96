"""The touches of an evaluation are always the same, as shapes and as images of the same poses."""

import dataclasses
import json
import logging
from pathlib import Path

import numpy as np
import pytest
from message_helpers import missing, naming

from tactile_loc import EstimatorRecipe, Localizer, SensorGeometry
from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, TouchError
from tactile_loc.evaluation.protocol import evaluate, make_evaluation_key
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.sensors.calibration.folder import read_calibration, write_calibration
from tactile_loc.sensors.optics.board_presses import SimulatedSensor, calibrate_simulated
from tactile_loc.sensors.optics.lamps import OPTICS

IMAGES = SimulatedTouches(seed=3, images=True)
SENSOR = SensorGeometry("orthographic", 96, 96, 3500.0, 3500.0, 48.0, 48.0, 0.01, 2e-3)


@pytest.fixture(scope="module")
def folder(store, tmp_path_factory) -> Path:
    """A sensor calibrated on simulated boards."""
    options = {"steps": 400, "hidden": 16}
    sensor = SimulatedSensor(SENSOR, OPTICS["digit"])
    made = calibrate_simulated(sensor, 40, EstimatorRecipe(options=options), store)
    return made.write(tmp_path_factory.mktemp("sensor") / "calibrated")


def located(folder: Path, store) -> Localizer:
    sensor = {"name": "calibrated", "path": str(folder)}
    grid = {"name": "face", "spacing_mm": 8, "min_contact_percent": 2}  # its images do not show smaller contacts
    return Localizer.create("pin", store=store, sensor=sensor, grid=grid, refiner="none")


@pytest.fixture(scope="module")
def localizer(folder, store) -> Localizer:
    return located(folder, store)


def test_the_image_of_a_number_shows_the_touch_of_that_number(localizer):
    overlaps = []
    for number in range(6):
        shape, image = (SimulatedTouches(seed=3, images=i).draw_touch(localizer, number) for i in (False, True))
        assert (shape.T_sensor_object == image.T_sensor_object).all()
        assert shape.name == image.name == f"touch-{number:04d}"
        assert (shape.image, image.image.shape) == (None, (96, 96, 3))
        true = shape.contact_shape.press_to(image.press_depth_m)
        overlaps.append(image.contact_shape.contact_iou(true, localizer.sensor.geometry.observed_mask))
    assert np.median(overlaps) > 0.6


def test_equal_seeds_give_equal_touches_and_other_seeds_give_other_touches(localizer):
    first, again = (IMAGES.draw_touch(localizer, 2) for _ in range(2))
    assert (first.image == again.image).all()
    other = dataclasses.replace(IMAGES, seed=4).draw_touch(localizer, 2)
    assert not np.allclose(first.T_sensor_object, other.T_sensor_object)


def test_an_image_without_contact_is_drawn_again_with_a_warning(localizer, monkeypatch, caplog):
    read, asked = type(localizer.sensor).contact_shape, []

    def sees_nothing_first(self, image):
        asked.append(image)
        if len(asked) == 1:
            raise TouchError("no contact")
        return read(self, image)

    monkeypatch.setattr(type(localizer.sensor), "contact_shape", sees_nothing_first)
    with caplog.at_level(logging.WARNING):
        touch = IMAGES.draw_touch(localizer, 1)
    assert not missing(caplog.text, "touch-0001", "pin", "no contact")
    drawn_first = SimulatedTouches(seed=3).draw_touch(localizer, 1)
    assert not np.allclose(touch.T_sensor_object, drawn_first.T_sensor_object)
    monkeypatch.setattr(
        type(localizer.sensor), "contact_shape", lambda *_: (_ for _ in ()).throw(TouchError("no contact"))
    )
    with pytest.raises(TouchError, match="pin"):
        IMAGES.draw_touch(localizer, 1)


def test_an_evaluation_of_images_has_its_own_key_and_the_same_true_poses(localizer):
    shapes = evaluate(localizer, 3, SimulatedTouches(seed=3))
    images = evaluate(localizer, 3, IMAGES)
    # the depth of a photo is measured, and its grid uses this depth
    np.testing.assert_allclose(shapes.errors_m("random", "add"), images.errors_m("random", "add"), atol=2e-4)
    assert make_evaluation_key(localizer, 3, IMAGES) != make_evaluation_key(localizer, 3, SimulatedTouches(seed=3))
    assert np.median(images.errors_m("best-1", "add")) < np.median(images.errors_m("random", "add"))


def test_the_key_contains_the_calibration(localizer, folder, store, tmp_path):
    other = write_altered(folder, tmp_path / "other")
    keys = {make_evaluation_key(located(f, store), 3, IMAGES).digest for f in (folder, other)}
    assert len({make_evaluation_key(localizer, 3, IMAGES).digest, *keys}) == 2


def write_altered(folder: Path, to: Path) -> Path:
    """The same calibration with one other weight."""
    calibration = read_calibration(folder)
    calibration.estimator._network.weights["linear.bias"][:] += 0.01
    kept = {k: v for k, v in calibration.record.items() if k not in ("schema_version", "estimator", "options")}
    return write_calibration(to, calibration.estimator, calibration.background, kept)


def test_sensors_that_cannot_read_their_own_images_and_noise_of_contact_shapes_are_refused(folder, store, tmp_path):
    unreadable = Localizer.create("pin", store=store, sensor="gelslim")
    with pytest.raises(ConfigError, match=naming("gelslim", "tactile-loc calibrate --simulated", "`sensor`")):
        IMAGES.require_readable(unreadable)
    real = write_altered(folder, tmp_path / "real")
    record = json.loads((real / "calibration.json").read_text())
    del record["simulated"]
    (real / "calibration.json").write_text(json.dumps(record))
    localizer = located(real, store)
    with pytest.raises(CalibrationError, match=naming(real, "tactile-loc calibrate --simulated")):
        IMAGES.require_readable(localizer)
    SimulatedTouches().require_readable(located(real, store))
    with pytest.raises(ConfigError, match=naming("'mild'", "`noise`")):
        SimulatedTouches("mild", images=True)
