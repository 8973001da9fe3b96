"""Slope from colour: the estimator learns a simulated sensor from a few presses, and its weights survive a file."""

from __future__ import annotations

import numpy as np
import pytest
from message_helpers import naming

torch = pytest.importorskip("torch")

from press_sets import BALL_M, TINY, ball_indentation, ball_set, contact_radius, label_untouched, photographed, places  # noqa: E402

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, TrainingError, WeightsError  # noqa: E402
from tactile_loc.sensors.calibration.calibrate import measure_press  # noqa: E402
from tactile_loc.sensors.calibration.labels import Chosen, LabelledPresses  # noqa: E402
from tactile_loc.sensors.reading.estimator import CalibrationProblem, load_estimator, validate_estimator_options  # noqa: E402
from tactile_loc.sensors.reading.photometric import SMOOTHINGS_PX, PhotometricEstimator  # noqa: E402

BALLS = ball_set(12)
GEOMETRY = BALLS.geometry


pytestmark = pytest.mark.usefixtures("one_thread")


def make(**options) -> PhotometricEstimator:
    chosen = validate_estimator_options(PhotometricEstimator, {**TINY, **options})
    return PhotometricEstimator(GEOMETRY, BALLS.background, chosen)


def problem(presses: LabelledPresses = BALLS) -> CalibrationProblem:
    return CalibrationProblem(GEOMETRY, BALLS.background, presses)


def trained(**options) -> PhotometricEstimator:
    estimator = make(**options)
    estimator.fit(problem())
    return estimator


@pytest.fixture(scope="module")
def estimator() -> PhotometricEstimator:
    learned = make(steps=500)
    learned.fit(problem(Chosen(BALLS, range(9))))
    return learned


def weights(estimator: PhotometricEstimator) -> dict[str, np.ndarray]:
    return {k: v.numpy() for k, v in estimator._network.state_dict().items()}


def same(a: PhotometricEstimator, b: PhotometricEstimator) -> bool:
    left, right = weights(a), weights(b)
    return left.keys() == right.keys() and all(np.array_equal(left[k], right[k]) for k in left)


def test_the_estimator_generalizes_to_unseen_presses(estimator):
    errors = [measure_press(estimator, *BALLS.read_press(number)) for number in (9, 10, 11)]
    assert np.mean([e.slope_deg for e in errors]) < 1.5
    assert np.mean([e.shape_m for e in errors]) < 2e-5
    assert np.mean([e.untouched_m for e in errors]) < 1e-5


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
    assert found.shape == GEOMETRY.shape
    assert found.dtype == np.float32
    rho = np.hypot(places(GEOMETRY)[0] + 1e-3, places(GEOMETRY)[1] - 1.5e-3)
    assert found[rho < 5e-4].mean() == pytest.approx(true[rho < 5e-4].mean(), rel=0.12)
    assert np.abs(found[rho > 2.5 * contact_radius(7e-4)]).max() < 3e-5
    assert np.abs(estimator.read_indentation(BALLS.background)).max() < 2e-5


def test_the_seed_determines_the_weights():
    first, again, other = trained(steps=20), trained(steps=20), trained(steps=20, seed=1)
    assert same(first, again)
    assert not same(first, other)
    assert not same(make(), make(seed=1))


def test_training_leaves_the_callers_random_state_unchanged():
    state = torch.get_rng_state()
    trained(steps=2)
    assert torch.equal(torch.get_rng_state(), state)


def test_saved_weights_give_the_same_slopes(estimator, tmp_path):
    path = tmp_path / "e.safetensors"
    estimator.save(path)
    other = make(steps=500)
    assert not same(other, estimator)
    other.load(path)
    np.testing.assert_array_equal(other.estimate_slopes(BALLS.images[0]), estimator.estimate_slopes(BALLS.images[0]))


@pytest.mark.parametrize("damage", ["truncated", "another network", "missing", "another estimator's"])
def test_weights_that_do_not_fit_are_refused(estimator, tmp_path, damage):
    path = tmp_path / "e.safetensors"
    estimator.save(path)
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "missing":
        path.unlink()
    elif damage == "another estimator's":
        from safetensors.torch import save_file

        save_file({"layers.0.weight": torch.zeros(3)}, path)
    reader = make(hidden=8) if damage == "another network" else make()
    with pytest.raises(WeightsError, match=naming("e.safetensors", "photometric", "calibrate")):
        reader.load(path)


class Untouched(LabelledPresses):
    def __len__(self) -> int:
        return 6

    def read_press(self, number: int):
        return BALLS.background, label_untouched(GEOMETRY)


def test_presses_without_contact_are_refused():
    with pytest.raises(CalibrationError, match="contact"):
        make().fit(problem(Untouched()))


def test_a_nan_loss_stops_training_with_advice(monkeypatch):
    loss = torch.tensor(float("nan"), requires_grad=True)
    monkeypatch.setattr(torch.nn.functional, "huber_loss", lambda *a, **k: loss)
    with pytest.raises(TrainingError, match=naming("NaN", "rate")):
        make().fit(problem())


def test_unknown_options_and_estimators_are_named():
    for options, words in (({"stepz": 3}, ("'stepz'", "'steps'", "hidden (int)")), ({"steps": 0}, ("steps", 0))):
        with pytest.raises(ConfigError, match=naming("'photometric'", *words)):
            make(**options)
    with pytest.raises(CalibrationError, match=naming("'photometrik'", "'photometric'", "cnn")):
        load_estimator("photometrik")


def test_a_pixel_changes_slopes_only_within_the_widest_smoothing():
    """The widest smoothing reaches three standard deviations."""
    image, estimator = BALLS.background.copy(), trained(steps=20)
    image[30, 40] = 255
    changed = (estimator.estimate_slopes(image) != estimator.estimate_slopes(BALLS.background)).any(axis=2)
    far = np.abs(np.argwhere(changed) - [30, 40]).max()
    assert 2 * max(SMOOTHINGS_PX) < far <= 3 * max(SMOOTHINGS_PX) + 1
