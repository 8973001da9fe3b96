"""Calibrating: which presses are held out, and that the errors on them are what they say."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from press_sets import TINY, ball_set  # noqa: E402

from tactile_loc.calibration import calibrate as module  # noqa: E402
from tactile_loc.calibration.calibrate import (  # noqa: E402
    FEWEST,
    Calibrated,
    PressErrors,
    calibrate,
    mean_errors,
    press_errors,
    split,
)
from tactile_loc.calibration.estimator import Chosen, GelEstimator, LabelledPresses  # noqa: E402
from tactile_loc.calibration.labels import PressLabel, untouched_label  # noqa: E402
from tactile_loc.core.errors import CalibrationError, ConfigError  # noqa: E402

BALLS = ball_set(10)
GEOMETRY = BALLS.geometry


@pytest.mark.parametrize(("count", "held_out"), [(5, 1), (6, 1), (10, 2), (22, 4), (101, 20)])
def test_every_press_is_learned_from_or_held_out(count, held_out):
    learned, kept = split(count, 0)
    assert sorted(learned + kept) == list(range(count))
    assert len(kept) == held_out
    assert (learned, kept) == (tuple(sorted(learned)), tuple(sorted(kept)))


def test_the_split_is_the_seeds():
    assert split(30, 4) == split(30, 4)
    assert len({split(30, seed)[1] for seed in range(10)}) == 10


class Oracle(GelEstimator):
    """Knows the truth of each image, or is off by a constant; keeps what it was given to learn from."""

    name = "oracle"
    offset_m = 0.0
    seen: tuple[int, ...] = ()
    truth = BALLS

    def fit(self, problem):
        assert isinstance(problem.presses, Chosen)
        type(self).seen = tuple(problem.presses.numbers)

    def _number(self, image) -> int:
        return next(i for i, other in enumerate(self.truth.images) if np.array_equal(other, image))

    def indentation(self, image):
        return self.truth.indentation_m[self._number(image)] + np.float32(self.offset_m)

    def slopes(self, image):
        return self.truth.press(self._number(image))[1].slope

    def save(self, path):
        raise NotImplementedError

    load = save


@pytest.fixture
def oracle(monkeypatch) -> type[Oracle]:
    monkeypatch.setattr(module, "estimator_class", lambda name: {"oracle": Oracle}[name])
    return Oracle


def test_who_knows_the_truth_makes_no_error(oracle):
    found = calibrate(BALLS, GEOMETRY, BALLS.background, "oracle")
    assert len(found.errors) == len(found.held_out) == 2
    for errors in found.errors:
        assert errors.slope_deg == pytest.approx(0, abs=1e-5)
        assert errors.shape_m == pytest.approx(0, abs=1e-9)
        assert errors.untouched_m == pytest.approx(0, abs=1e-9)
        assert math.isnan(errors.depth_m)  # a circle does not say how deep it lies


def test_what_is_held_out_is_not_learned_from(oracle):
    found = calibrate(BALLS, GEOMETRY, BALLS.background, "oracle", seed=3)
    assert sorted(oracle.seen + found.held_out) == list(range(10))
    assert found.held_out == split(10, 3)[1]


def test_a_constant_error_shows_where_it_should(oracle, monkeypatch):
    monkeypatch.setattr(oracle, "offset_m", 2e-5)
    made = oracle(GEOMETRY, BALLS.background)
    image, label = BALLS.press(0)
    errors = press_errors(made, image, label)
    assert errors.shape_m == pytest.approx(0, abs=1e-9)
    assert errors.untouched_m == pytest.approx(2e-5, rel=1e-4)
    errors = press_errors(made, image, dataclasses.replace(label, indentation_m=BALLS.indentation_m[0], absolute=True))
    assert errors.depth_m == pytest.approx(2e-5, rel=1e-4)


def test_the_slopes_error_is_in_degrees_of_the_surface(oracle, monkeypatch):
    image, label = BALLS.press(0)
    tilted = np.tan(np.arctan(label.slope) + np.radians([2.0, -4.0]))
    monkeypatch.setattr(oracle, "slopes", lambda self, image: tilted)
    assert press_errors(oracle(GEOMETRY, BALLS.background), image, label).slope_deg == pytest.approx(3.0, rel=1e-4)
    monkeypatch.setattr(oracle, "slopes", None)
    assert math.isnan(press_errors(oracle(GEOMETRY, BALLS.background), image, label).slope_deg)


def test_what_cannot_be_said_is_no_number(oracle):
    errors = press_errors(oracle(GEOMETRY, BALLS.background), BALLS.images[0], untouched_label(GEOMETRY))
    assert math.isnan(errors.shape_m)
    assert math.isnan(errors.slope_deg)
    assert errors.untouched_m > 0
    image, label = BALLS.press(0)
    everywhere = PressLabel(label.indentation_m, label.slope, ~np.zeros_like(label.contact), label.known)
    assert math.isnan(press_errors(oracle(GEOMETRY, BALLS.background), image, everywhere).untouched_m)


def test_means_are_over_what_can_be_said():
    nan = math.nan
    errors = [PressErrors(1.0, 2e-5, nan, 1e-6), PressErrors(3.0, 4e-5, nan, nan)]
    assert mean_errors(errors) == pytest.approx({"slope_deg": 2.0, "shape_m": 3e-5, "untouched_m": 1e-6})


def test_the_record_is_json_and_has_the_noise():
    errors = (PressErrors(1.0, 2e-5, math.nan, 5e-6), PressErrors(math.nan, 4e-5, math.nan, 7e-6))
    record = Calibrated(Oracle(GEOMETRY, BALLS.background), (3, 8), errors).record()
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["noise_m"] == pytest.approx(6e-6)
    assert record["held_out"]["presses"] == [3, 8]
    nowhere_untouched = (PressErrors(1.0, 2e-5, math.nan, math.nan),)
    assert Calibrated(Oracle(GEOMETRY, BALLS.background), (3,), nowhere_untouched).record()["noise_m"] == 0.0


class Few(LabelledPresses):
    def __len__(self) -> int:
        return FEWEST - 1

    def press(self, number: int):
        raise AssertionError("they are counted first")


def test_too_few_presses_are_refused():
    with pytest.raises(CalibrationError, match=r"there are 4 presses; a calibration needs 5"):
        calibrate(Few(), GEOMETRY, BALLS.background, "photometric")


def test_bad_options_are_refused():
    with pytest.raises(ConfigError, match="steps = 'many'"):
        calibrate(BALLS, GEOMETRY, BALLS.background, "photometric", {"steps": "many"})


def test_a_simulated_sensor_is_calibrated_and_the_errors_are_those_measured():
    found = calibrate(BALLS, GEOMETRY, BALLS.background, "photometric", TINY)
    measured = [press_errors(found.estimator, *BALLS.press(number)) for number in found.held_out]
    np.testing.assert_array_equal([dataclasses.astuple(e) for e in measured], [*map(dataclasses.astuple, found.errors)])
    assert mean_errors(found.errors)["slope_deg"] < 6
