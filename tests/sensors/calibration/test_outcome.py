"""Calibration: the choice of held-out presses, the errors on them, and the stored outcome."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import TINY, ball_set, label_untouched, write_table

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, SensorError
from tactile_loc.sensors.calibration import outcome
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.calibration.labels import PressLabel
from tactile_loc.sensors.calibration.outcome import (
    average_errors,
    calibrate,
    calibrate_folder,
    calibrate_measured,
    measure_press,
    split,
)
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.sensors.reading.photometric import EstimatorRecipe, PhotometricEstimator
from tactile_loc.store.store import StageStore

BALLS, FIVE = ball_set(10), ball_set(5)
GEOMETRY = BALLS.geometry
FEW = {**TINY, "steps": 5}


def test_every_press_is_used_for_training_or_held_out_as_the_seed_determines():
    for count, held_out in ((5, 1), (6, 1), (10, 2), (22, 4), (101, 20)):
        learned, kept = split(count, 0)
        assert sorted(learned + kept) == list(range(count))
        assert len(kept) == held_out
        assert (learned, kept) == (tuple(sorted(learned)), tuple(sorted(kept)))
    assert split(30, 4) == split(30, 4)
    assert len({split(30, seed)[1] for seed in range(10)}) == 10


def find_number(image: np.ndarray) -> int:
    return next(i for i, other in enumerate(BALLS.images) if np.array_equal(other, image))


class Oracle(PhotometricEstimator):
    """Returns the truth of each image, or differs by a constant; keeps its training data."""

    offset_m = 0.0
    seen: tuple[int, ...] = ()

    def fit(self, presses, progress):
        type(self).seen = tuple(find_number(image) for image, _ in presses)

    def read(self, image):
        number = find_number(image)
        return BALLS.indentation_m[number] + np.float32(self.offset_m), BALLS.read_press(number)[1].slope


@pytest.fixture
def oracle(monkeypatch) -> Oracle:
    monkeypatch.setattr(outcome, "PhotometricEstimator", Oracle)
    return Oracle(GEOMETRY, BALLS.background)


def test_a_perfect_estimator_has_no_error_at_held_out_presses(oracle):
    found = calibrate(BALLS, EstimatorRecipe(seed=3))
    assert sorted([*Oracle.seen, *found.held_out]) == list(range(10))
    assert found.held_out == list(split(10, 3)[1])
    assert found.mean_errors == pytest.approx({"slope_deg": 0, "shape_m": 0, "untouched_m": 0}, abs=1e-5)
    assert found.mean_errors["shape_m"] == pytest.approx(0, abs=1e-9)  # a circle does not say how deep it lies
    assert json.loads(json.dumps(found.record, allow_nan=False)) == found.record
    assert found.record["noise_m"] == found.mean_errors["untouched_m"]


def test_a_constant_offset_changes_only_untouched_and_absolute_errors(oracle, monkeypatch):
    monkeypatch.setattr(oracle, "offset_m", 2e-5)
    image, label = BALLS.read_press(0)
    errors = measure_press(oracle, image, label)
    assert errors["shape_m"] == pytest.approx(0, abs=1e-9)
    assert errors["untouched_m"] == pytest.approx(2e-5, rel=1e-4)
    label = dataclasses.replace(label, indentation_m=BALLS.indentation_m[0], absolute=True)
    assert measure_press(oracle, image, label)["depth_m"] == pytest.approx(2e-5, rel=1e-4)


def test_the_slope_error_is_an_angle_in_degrees_and_unknown_errors_are_left_out(oracle, monkeypatch):
    image, label = BALLS.read_press(0)
    assert measure_press(oracle, image, label_untouched(GEOMETRY)).keys() == {"untouched_m"}
    everywhere = PressLabel(label.indentation_m, label.slope, ~np.zeros_like(label.contact), label.known)
    assert "untouched_m" not in measure_press(oracle, image, everywhere)
    tilted = np.tan(np.arctan(label.slope) + np.radians([2.0, -4.0]))
    monkeypatch.setattr(oracle, "read", lambda image: (label.indentation_m, tilted))
    assert measure_press(oracle, image, label)["slope_deg"] == pytest.approx(3.0, rel=1e-4)


def test_means_ignore_unknown_errors():
    errors = [{"slope_deg": 1.0, "shape_m": 2e-5, "untouched_m": 1e-6}, {"slope_deg": 3.0, "shape_m": 4e-5}]
    assert average_errors(errors) == pytest.approx({"slope_deg": 2.0, "shape_m": 3e-5, "untouched_m": 1e-6})


def test_too_few_presses_and_bad_options_are_refused():
    with pytest.raises(CalibrationError, match=naming("4 presses", 5)):
        calibrate(ball_set(4), EstimatorRecipe())
    with pytest.raises(ConfigError, match=naming("estimator", "steps", "'many'")):
        calibrate(BALLS, EstimatorRecipe({"steps": "many"}))


def test_the_calibration_reports_the_measured_held_out_errors():
    found = calibrate(BALLS, EstimatorRecipe(TINY))
    measured = [measure_press(found.estimator, *BALLS.read_press(number)) for number in found.held_out]
    assert average_errors(measured) == found.mean_errors
    assert found.mean_errors["slope_deg"] < 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return FIVE.write(tmp_path)


@pytest.fixture
def store(tmp_path: Path) -> StageStore:
    return StageStore(tmp_path / "store")


def stage(folder: Path, store: StageStore, seed: int = 0, geometry=GEOMETRY, **options: object) -> tuple:
    """Calibrate or load, and return the record and the slopes (H, W, 2) of the first image."""
    done = calibrate_measured(read_presses(folder, geometry), EstimatorRecipe({**FEW, **options}, seed), store)
    return done.record, done.estimator.read(FIVE.images[0])[1]


def test_a_second_calibration_comes_from_the_store_and_a_damaged_one_is_replaced(folder, store, monkeypatch):
    record, slopes = stage(folder, store)
    with monkeypatch.context() as patched:
        patched.setattr(PhotometricEstimator, "fit", None)  # a second training would fail
        stage(folder, store, rate=PhotometricEstimator.Options().rate)  # the default, stated
        same_record, same_slopes = stage(folder, store)
    assert len(store.built) == 1
    assert record == same_record
    assert record["held_out"]["presses"] == list(split(5, 0)[1])
    (weights,) = store.root.rglob("estimator.safetensors")
    weights.chmod(0o644)
    weights.write_bytes(weights.read_bytes()[:-40])
    for again in (same_slopes, stage(folder, StageStore(store.root))[1]):
        np.testing.assert_array_equal(again, slopes)


@pytest.mark.parametrize("what", ["options", "seed", "0000.png", "background.png", "label", "geometry"])
def test_any_changed_input_starts_a_new_calibration(folder, store, what):
    rows = FIVE.rows()
    stage(folder, store)
    more: dict = {"options": {"steps": 6}, "seed": {"seed": 1}}.get(what, {})
    if what.endswith(".png"):
        (folder / what).write_bytes((folder / "0001.png").read_bytes())
    elif what == "label":
        rows[1]["radius_px"] *= 1.1
        write_table(folder, rows)
    elif what == "geometry":
        more["geometry"] = dataclasses.replace(GEOMETRY, fx=1.01 * GEOMETRY.fx)
    stage(folder, store, **more)
    assert len(store.built) == 2


def test_an_interrupted_calibration_stores_no_result(folder, store, monkeypatch):
    save = PhotometricEstimator.save

    def stop(self, path):
        save(self, path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(PhotometricEstimator, "save", stop)
        with pytest.raises(KeyboardInterrupt):
            stage(folder, store)
    assert [entry.complete for entry in store.entries()] == [False]
    assert not list(store.root.rglob("estimator.safetensors"))
    resumed = stage(folder, store)
    assert [entry.complete for entry in store.entries()] == [True]
    np.testing.assert_array_equal(resumed[1], stage(folder, StageStore(folder / "other"))[1])


def test_bad_options_are_refused_before_anything_is_stored(folder, store):
    with pytest.raises(ConfigError, match=naming("'stepz'", "'steps'")):
        stage(folder, store, stepz=3)
    assert not store.entries()


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_a_folder_becomes_a_sensor_with_its_errors(tmp_path, store):
    presses = ball_set(7).write(tmp_path / "presses")
    found = calibrate_folder(presses, presses / "sensor.toml", EstimatorRecipe(TINY), store=store)
    assert found.title == "1 of 7 presses were held out"
    assert [line.partition(":")[0] for line in found.list_errors()] == [
        "surface angle in the contact",
        "indentation in the contact, up to a constant",
        "indentation in the contact",
        "indentation outside the contact",
    ]
    assert any(fact.startswith("the gel is ") for fact in found.facts)
    written = read_calibration(found.write(tmp_path / "mine"))
    assert written.record["held_out"]["mean"] == found.mean_errors
    assert written.record["presses"] == 7


def test_a_missing_folder_or_sensor_file_is_refused(tmp_path):
    with pytest.raises(CalibrationError):
        calibrate_folder(tmp_path / "none", tmp_path / "none" / "sensor.toml")
    with pytest.raises(SensorError):
        calibrate_folder(tmp_path, tmp_path / "sensor.toml")
