"""Calibration: the choice of held-out presses, and the errors on them.

The stage store returns a finished calibration for the same presses and options. Any change starts a new one.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import naming

torch = pytest.importorskip("torch")

from press_sets import TINY, ball_set, label_untouched, write_table  # noqa: E402

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError  # noqa: E402
from tactile_loc.core.runtime.progress import Progress  # noqa: E402
from tactile_loc.sensors.calibration.calibrate import (  # noqa: E402
    FEWEST,
    Calibrated,
    PressErrors,
    average_errors,
    calibrate,
    calibrate_stage,
    measure_press,
    split,
)
from tactile_loc.sensors.calibration.labels import Chosen, LabelledPresses, PressLabel  # noqa: E402
from tactile_loc.sensors.calibration.presses import read_presses  # noqa: E402
from tactile_loc.sensors.reading import estimator  # noqa: E402
from tactile_loc.sensors.reading.estimator import CalibrationProblem, EstimatorRecipe, GelEstimator  # noqa: E402
from tactile_loc.sensors.reading.photometric import PhotometricEstimator  # noqa: E402
from tactile_loc.sensors.reading.reading import Health  # noqa: E402
from tactile_loc.store.store import StageStore  # noqa: E402

BALLS = ball_set(10)
GEOMETRY = BALLS.geometry
PROBLEM = CalibrationProblem(GEOMETRY, BALLS.background, BALLS)
FIVE = ball_set(5)
FEW = {**TINY, "steps": 5}


def test_every_press_is_used_for_training_or_held_out_as_the_seed_determines():
    for count, held_out in ((5, 1), (6, 1), (10, 2), (22, 4), (101, 20)):
        learned, kept = split(count, 0)
        assert sorted(learned + kept) == list(range(count))
        assert len(kept) == held_out
        assert (learned, kept) == (tuple(sorted(learned)), tuple(sorted(kept)))
    assert split(30, 4) == split(30, 4)
    assert len({split(30, seed)[1] for seed in range(10)}) == 10


class Oracle(GelEstimator):
    """Returns the truth of each image, or differs by a constant; keeps its training data."""

    name = "oracle"
    offset_m = 0.0
    seen: tuple[int, ...] = ()
    truth = BALLS

    def fit(self, problem):
        assert isinstance(problem.presses, Chosen)
        type(self).seen = tuple(problem.presses.numbers)

    def _number(self, image) -> int:
        return next(i for i, other in enumerate(self.truth.images) if np.array_equal(other, image))

    def read(self, image):
        number = self._number(image)
        return self.truth.indentation_m[number] + np.float32(self.offset_m), self.truth.read_press(number)[1].slope

    def save(self, path):
        raise NotImplementedError

    load = save


@pytest.fixture
def oracle(monkeypatch) -> type[Oracle]:
    monkeypatch.setattr(estimator, "load_estimator", lambda name: {"oracle": Oracle}[name])
    return Oracle


def test_a_perfect_estimator_has_no_error_at_held_out_presses(oracle):
    found = calibrate(PROBLEM, EstimatorRecipe("oracle", seed=3))
    assert sorted(oracle.seen + found.held_out) == list(range(10)), "training uses presses that are held out"
    assert found.held_out == split(10, 3)[1]
    assert len(found.errors) == len(found.held_out) == 2
    for errors in found.errors:
        assert errors.slope_deg == pytest.approx(0, abs=1e-5)
        assert errors.shape_m == pytest.approx(0, abs=1e-9)
        assert errors.untouched_m == pytest.approx(0, abs=1e-9)
        assert math.isnan(errors.depth_m)  # a circle does not say how deep it lies


def test_a_constant_offset_changes_only_untouched_and_absolute_errors(oracle, monkeypatch):
    monkeypatch.setattr(oracle, "offset_m", 2e-5)
    made = oracle(GEOMETRY, BALLS.background)
    image, label = BALLS.read_press(0)
    errors = measure_press(made, image, label)
    assert errors.shape_m == pytest.approx(0, abs=1e-9)
    assert errors.untouched_m == pytest.approx(2e-5, rel=1e-4)
    errors = measure_press(made, image, dataclasses.replace(label, indentation_m=BALLS.indentation_m[0], absolute=True))
    assert errors.depth_m == pytest.approx(2e-5, rel=1e-4)


def test_the_slope_error_is_an_angle_in_degrees(oracle, monkeypatch):
    image, label = BALLS.read_press(0)
    tilted = np.tan(np.arctan(label.slope) + np.radians([2.0, -4.0]))
    monkeypatch.setattr(oracle, "read", lambda self, image: (label.indentation_m, tilted))
    assert measure_press(oracle(GEOMETRY, BALLS.background), image, label).slope_deg == pytest.approx(3.0, rel=1e-4)
    monkeypatch.setattr(oracle, "read", lambda self, image: (label.indentation_m, None))
    assert math.isnan(measure_press(oracle(GEOMETRY, BALLS.background), image, label).slope_deg)


def test_an_undefined_error_is_nan(oracle):
    errors = measure_press(oracle(GEOMETRY, BALLS.background), BALLS.images[0], label_untouched(GEOMETRY))
    assert math.isnan(errors.shape_m)
    assert math.isnan(errors.slope_deg)
    assert errors.untouched_m > 0
    image, label = BALLS.read_press(0)
    everywhere = PressLabel(label.indentation_m, label.slope, ~np.zeros_like(label.contact), label.known)
    assert math.isnan(measure_press(oracle(GEOMETRY, BALLS.background), image, everywhere).untouched_m)


def test_means_ignore_undefined_errors():
    nan = math.nan
    errors = [PressErrors(1.0, 2e-5, nan, 1e-6), PressErrors(3.0, 4e-5, nan, nan)]
    assert average_errors(errors) == pytest.approx({"slope_deg": 2.0, "shape_m": 3e-5, "untouched_m": 1e-6})


def test_the_record_is_json_and_contains_the_noise():
    errors = (PressErrors(1.0, 2e-5, math.nan, 5e-6), PressErrors(math.nan, 4e-5, math.nan, 7e-6))
    record = Calibrated(Oracle(GEOMETRY, BALLS.background), (3, 8), errors, Health(2.0, math.nan)).record()
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["noise_m"] == pytest.approx(6e-6)
    assert record["held_out"]["presses"] == [3, 8]
    assert record["health"] == {"light": 2.0, "unfit": None}
    nowhere_untouched = (PressErrors(1.0, 2e-5, math.nan, math.nan),)
    noiseless = Calibrated(Oracle(GEOMETRY, BALLS.background), (3,), nowhere_untouched, Health(2.0, 0.1))
    assert noiseless.record()["noise_m"] == 0.0


class Few(LabelledPresses):
    def __len__(self) -> int:
        return FEWEST - 1

    def read_press(self, number: int):
        raise AssertionError("calibrate reads a press before it counts them")


def test_too_few_presses_and_bad_options_are_refused():
    with pytest.raises(CalibrationError, match=naming("4 presses", 5)):
        calibrate(CalibrationProblem(GEOMETRY, BALLS.background, Few()), EstimatorRecipe("photometric"))
    with pytest.raises(ConfigError, match=naming("'photometric'", "steps", "'many'")):
        calibrate(PROBLEM, EstimatorRecipe("photometric", {"steps": "many"}))


def test_the_calibration_reports_the_measured_held_out_errors():
    found = calibrate(PROBLEM, EstimatorRecipe("photometric", TINY))
    measured = [measure_press(found.estimator, *BALLS.read_press(number)) for number in found.held_out]
    np.testing.assert_array_equal([dataclasses.astuple(e) for e in measured], [*map(dataclasses.astuple, found.errors)])
    assert average_errors(found.errors)["slope_deg"] < 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    trimesh.creation.box((6, 3, 4)).export(tmp_path / "box.stl")
    return FIVE.write(tmp_path)


@pytest.fixture
def store(tmp_path: Path) -> StageStore:
    return StageStore(tmp_path / "store")


def stage(folder: Path, store: StageStore, seed: int = 0, geometry=FIVE.geometry, **options: object):
    presses = read_presses(folder, geometry)
    return calibrate_stage(presses, folder, EstimatorRecipe("photometric", {**FEW, **options}, seed), store, Progress())


def test_a_second_calibration_comes_from_the_store(folder, store, monkeypatch):
    made, record = stage(folder, store)
    monkeypatch.setattr(PhotometricEstimator, "fit", None)  # a second training would fail
    stage(folder, store, seed=0, rate=PhotometricEstimator.Options().rate)  # the default, stated
    again, same_record = stage(folder, store)
    assert len(store.built) == 1
    assert again.options == made.options
    np.testing.assert_array_equal(again.estimate_slopes(FIVE.images[0]), made.estimate_slopes(FIVE.images[0]))
    assert record == same_record
    assert record["held_out"]["presses"] == list(split(5, 0)[1])
    assert set(record["held_out"]["mean"]) == {"slope_deg", "shape_m", "untouched_m"}


@pytest.mark.parametrize("what", ["options", "seed", "0000.png", "background.png", "label", "geometry"])
def test_any_changed_input_starts_a_new_calibration(folder, store, what):
    stage(folder, store)
    more: dict = {"options": {"steps": 6}, "seed": {"seed": 1}}.get(what, {})
    if what.endswith(".png"):
        (folder / what).write_bytes((folder / "0001.png").read_bytes())
    elif what == "label":
        rows = FIVE.rows()
        rows[1]["radius_px"] *= 1.1
        write_table(folder, rows)
    elif what == "geometry":
        more["geometry"] = dataclasses.replace(FIVE.geometry, fx=1.01 * FIVE.geometry.fx)
    stage(folder, store, **more)
    assert len(store.built) == 2


def test_a_changed_mesh_starts_a_new_calibration(folder, store):
    rows = FIVE.rows()
    pose = dict.fromkeys(("x_mm", "y_mm", "roll_deg", "pitch_deg", "yaw_deg"), 0)
    rows[2] |= {"kind": "mesh", "mesh": "box.stl", "units": "mm", "press_mm": 0.4, **pose}
    write_table(folder, rows)
    stage(folder, store)
    stage(folder, store)
    trimesh.creation.box((5, 3, 4)).export(folder / "box.stl")
    stage(folder, store)
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
    interrupted, _ = stage(folder, store)
    assert [entry.complete for entry in store.entries()] == [True]
    whole, _ = stage(folder, StageStore(folder / "other"))
    np.testing.assert_array_equal(interrupted.estimate_slopes(FIVE.images[0]), whole.estimate_slopes(FIVE.images[0]))


def test_a_damaged_stored_calibration_is_replaced(folder, store):
    made, _ = stage(folder, store)
    (weights,) = store.root.rglob("estimator.safetensors")
    weights.chmod(0o644)
    weights.write_bytes(weights.read_bytes()[:-40])
    again, _ = stage(folder, StageStore(store.root))
    np.testing.assert_array_equal(again.estimate_slopes(FIVE.images[0]), made.estimate_slopes(FIVE.images[0]))


def test_bad_options_are_refused_before_anything_is_stored(folder, store):
    with pytest.raises(ConfigError, match=naming("'stepz'", "'steps'")):
        stage(folder, store, stepz=3)
    assert not store.entries()
