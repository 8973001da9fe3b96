"""Slope from colour: the estimator learns a simulated sensor from a few presses."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from press_sets import BALL_M, TINY, ball_indentation, ball_set, contact_radius, label_untouched, photographed, places

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, WeightsError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.plugin import Progress, TrainingError
from tactile_loc.sensors.calibration.outcome import measure_press
from tactile_loc.sensors.reading.photometric import (
    FEATURES,
    FIXED,
    SMOOTHINGS_PX,
    PhotometricEstimator,
    stack_fixed_features,
)

BALLS = ball_set(12)
GEOMETRY = BALLS.geometry
WIDE = SensorGeometry("orthographic", 80, 64, 4000.0, 4000.0, 40.0, 32.0, 0.01, 1.5e-3)

pytestmark = pytest.mark.usefixtures("one_thread")


def make(**options) -> PhotometricEstimator:
    return PhotometricEstimator(GEOMETRY, BALLS.background, {**TINY, **options})


def train(steps: int, **options) -> PhotometricEstimator:
    """Return an estimator that learned from all but the last three presses."""
    learned = make(steps=steps, **options)
    learned.fit(BALLS.read_presses(range(9)), Progress())
    return learned


def weights(estimator: PhotometricEstimator, path: Path) -> bytes:
    estimator.save(path)
    return path.read_bytes()


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
    found = estimator.read(photographed(true[None], GEOMETRY)[0])[0]
    rho = np.hypot(places(GEOMETRY)[0] + 1e-3, places(GEOMETRY)[1] - 1.5e-3)
    assert found[rho < 5e-4].mean() == pytest.approx(true[rho < 5e-4].mean(), rel=0.12)
    assert np.abs(found[rho > 2.5 * contact_radius(7e-4)]).max() < 3e-5
    assert np.abs(estimator.read(BALLS.background)[0]).max() < 2e-5


def test_a_nan_loss_stops_training_with_advice(monkeypatch):
    nothing = np.full((9, FEATURES), np.nan, np.float32), np.zeros((9, 2), np.float32), 9
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


def test_the_seed_determines_the_weights(tmp_path):
    one, same, other = (weights(train(20, seed=seed), tmp_path / "w") for seed in (1, 1, 2))
    assert one == same != other
    assert weights(make(), tmp_path / "w") != weights(make(seed=1), tmp_path / "w")


def test_saved_weights_give_the_same_indentation(estimator, tmp_path):
    loaded = make(seed=9)
    estimator.save(tmp_path / "w.safetensors")
    loaded.load(tmp_path / "w.safetensors")
    found, expected = (one.read(BALLS.images[0])[0] for one in (loaded, estimator))
    assert (found.dtype, found.shape) == (np.float32, GEOMETRY.shape)
    assert np.array_equal(found, expected)


def test_damaged_or_foreign_weights_are_refused(tmp_path):
    whole = weights(make(), tmp_path / "w")
    (tmp_path / "cut").write_bytes(whole[:-100])
    make(hidden=8).save(tmp_path / "of-another-network")
    for file in ("cut", "of-another-network", "missing"):
        with pytest.raises(WeightsError, match=naming(tmp_path / file, "calibrate")):
            make().load(tmp_path / file)


def test_presses_without_contact_are_refused():
    with pytest.raises(CalibrationError, match="contact"):
        make().fit([(BALLS.background, label_untouched(GEOMETRY))] * 6, Progress())


def test_unknown_options_are_named():
    for options, words in (({"stepz": 3}, ("'stepz'", "'steps'", "hidden (int)")), ({"steps": 0}, ("steps", 0))):
        with pytest.raises(ConfigError, match=naming("estimator", *words)):
            make(**options)


def test_fixed_features_are_scaled_and_oriented():
    gel = np.zeros((64, 80, 3), np.uint8)
    gel[..., 0] = 255
    fixed = stack_fixed_features(gel, WIDE)
    assert fixed.shape == (64, 80, FIXED)
    np.testing.assert_allclose(fixed[..., :3], np.broadcast_to([1, -1, -1], (64, 80, 3)), atol=1e-6)
    np.testing.assert_allclose(fixed[[0, 63], :, 4], [[-1] * 80, [1] * 80])
    np.testing.assert_allclose(fixed[:, [0, 79], 3], [[-1, 1]] * 64)
