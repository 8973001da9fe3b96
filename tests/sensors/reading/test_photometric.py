"""Slope from colour: the estimator learns a simulated sensor from a few presses."""

import numpy as np
import pytest
from message_helpers import naming
from press_sets import BALL_M, TINY, ball_indentation, ball_set, contact_radius, photographed, places

from tactile_loc.plugin import Progress, TrainingError
from tactile_loc.sensors.calibration.labels import Chosen
from tactile_loc.sensors.calibration.outcome import measure_press
from tactile_loc.sensors.reading.photometric import FEATURES, SMOOTHINGS_PX, PhotometricEstimator
from tactile_loc.slots.encoder import Checkpoints

BALLS = ball_set(12)
GEOMETRY = BALLS.geometry

pytestmark = pytest.mark.usefixtures("one_thread")


def train(steps: int) -> PhotometricEstimator:
    """Return an estimator that learned from all but the last three presses."""
    options = PhotometricEstimator.Options(**{**TINY, "steps": steps})
    learned = PhotometricEstimator(GEOMETRY, BALLS.background, options)
    learned.fit(Chosen(BALLS, range(9)), Progress(), Checkpoints())
    return learned


@pytest.fixture(scope="module")
def estimator() -> PhotometricEstimator:
    return train(500)


def test_the_estimator_generalizes_to_unseen_presses(estimator):
    errors = [measure_press(estimator, *BALLS.read_press(number)) for number in (9, 10, 11)]
    for name, most in {"slope_deg": 1.5, "shape_m": 2e-5, "untouched_m": 1e-5}.items():
        assert np.mean([one[name] for one in errors]) < most


def test_slopes_have_the_signs_and_axes_of_the_sensor_frame(estimator):
    image = photographed(ball_indentation(GEOMETRY, 1e-3, -2e-3)[None], GEOMETRY)[0]
    slope = estimator.estimate_slopes(image)
    assert slope.shape == (64, 64, 2)
    x, y = places(GEOMETRY)
    x, y = x - 1e-3, y + 2e-3
    ring = (np.hypot(x, y) > 0.3 * BALL_M) & (np.hypot(x, y) < 0.6 * BALL_M)
    steep = np.sqrt(BALL_M**2 - x[ring] ** 2 - y[ring] ** 2)
    assert np.median(np.abs(slope[ring, 0] + x[ring] / steep)) < 0.1
    assert np.median(np.abs(slope[ring, 1] + y[ring] / steep)) < 0.1


def test_the_indentation_matches_the_ball_and_is_zero_elsewhere(estimator):
    true = ball_indentation(GEOMETRY, -1e-3, 1.5e-3, 7e-4)
    found = estimator.read_indentation(photographed(true[None], GEOMETRY)[0])
    rho = np.hypot(places(GEOMETRY)[0] + 1e-3, places(GEOMETRY)[1] - 1.5e-3)
    assert found[rho < 5e-4].mean() == pytest.approx(true[rho < 5e-4].mean(), rel=0.12)
    assert np.abs(found[rho > 2.5 * contact_radius(7e-4)]).max() < 3e-5
    assert np.abs(estimator.read_indentation(BALLS.background)).max() < 2e-5


def test_a_nan_loss_stops_training_with_advice(monkeypatch):
    nothing = np.full((9, FEATURES), np.nan, np.float32), np.zeros((9, 2), np.float32)
    monkeypatch.setattr(PhotometricEstimator, "_collect_samples", lambda *_: nothing)
    with pytest.raises(TrainingError, match=naming("NaN", "rate")):
        train(5)


def test_a_pixel_changes_slopes_only_within_the_widest_smoothing(estimator):
    """The widest smoothing reaches three standard deviations."""
    image = BALLS.background.copy()
    image[30, 40] = 255
    changed = (estimator.estimate_slopes(image) != estimator.estimate_slopes(BALLS.background)).any(axis=2)
    far = np.abs(np.argwhere(changed) - [30, 40]).max()
    assert 2 * max(SMOOTHINGS_PX) < far <= 3 * max(SMOOTHINGS_PX) + 1
