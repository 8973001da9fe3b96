"""A folder of presses becomes a calibrated sensor, whose errors are stated in words."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from press_sets import TINY, ball_set

from tactile_loc.core.runtime.errors import CalibrationError, SensorError
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.calibration.outcome import calibrate_folder
from tactile_loc.sensors.reading.estimator import EstimatorRecipe
from tactile_loc.store.store import StageStore

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.slow
def test_a_folder_becomes_a_sensor_with_its_errors(tmp_path):
    presses = ball_set(7).write(tmp_path / "presses")
    store = StageStore(tmp_path / "store")
    outcome = calibrate_folder(presses, presses / "sensor.toml", EstimatorRecipe(options=TINY), store=store)
    assert outcome.title == "1 of 7 presses were held out"
    assert [line.partition(":")[0] for line in outcome.list_errors()] == [
        "surface angle in the contact",
        "indentation in the contact, up to a constant",
        "indentation in the contact",
        "indentation outside the contact",
    ]
    assert any(fact.startswith("the gel is ") for fact in outcome.facts)
    written = read_calibration(outcome.write(tmp_path / "mine"))
    assert written.record["held_out"]["mean"] == outcome.mean_errors
    assert written.record["presses"] == 7


def test_a_missing_folder_or_sensor_file_is_refused(tmp_path):
    with pytest.raises(CalibrationError):
        calibrate_folder(tmp_path / "none", tmp_path / "none" / "sensor.toml")
    with pytest.raises(SensorError):
        calibrate_folder(tmp_path, tmp_path / "sensor.toml")
