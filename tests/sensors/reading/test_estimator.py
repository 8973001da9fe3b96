"""What both estimators do: features, seeds, files of weights, and refused training data."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

torch = pytest.importorskip("torch")

from press_sets import TINY, ball_set, label_untouched  # noqa: E402

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, WeightsError  # noqa: E402
from tactile_loc.core.runtime.progress import Progress  # noqa: E402
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry  # noqa: E402
from tactile_loc.sensors.calibration.labels import LabelledPresses  # noqa: E402
from tactile_loc.sensors.reading.estimator import (  # noqa: E402
    COLOUR_STEP,
    FIXED,
    PLANES,
    GelEstimator,
    make_estimator,
    scale_difference,
    stack_features,
    stack_fixed_features,
)
from tactile_loc.slots.encoder import Checkpoints  # noqa: E402

BALLS = ball_set(6)
SMALL = {"photometric": {**TINY, "steps": 20}, "cnn": {"channels": 4, "epochs": 1, "batch": 4}}
OTHER = {"photometric": {"hidden": 8}, "cnn": {"channels": 8}}
WIDE = SensorGeometry("orthographic", 80, 64, 4000.0, 4000.0, 40.0, 32.0, 0.01, 1.5e-3)

pytestmark = pytest.mark.usefixtures("one_thread")
EACH = pytest.mark.parametrize("name", SMALL)


def make(name: str, **options) -> GelEstimator:
    return make_estimator(name, {**SMALL[name], **options}, BALLS.geometry, BALLS.background)


def train(name: str, presses: LabelledPresses = BALLS, **options) -> GelEstimator:
    estimator = make(name, **options)
    estimator.fit(presses, Progress(), Checkpoints())
    return estimator


def weights(estimator: GelEstimator, path: Path) -> bytes:
    estimator.save(path)
    return path.read_bytes()


@EACH
def test_the_seed_determines_the_weights_and_training_leaves_the_callers_random_state_unchanged(name, tmp_path):
    state = torch.get_rng_state()
    one, same, other = (weights(train(name, seed=seed), tmp_path / "w") for seed in (1, 1, 2))
    assert one == same != other
    assert weights(make(name), tmp_path / "w") != weights(make(name, seed=1), tmp_path / "w")
    assert torch.equal(torch.get_rng_state(), state)


@EACH
def test_saved_weights_give_the_same_indentation(name, tmp_path):
    first, second = train(name), make(name, seed=9)
    first.save(tmp_path / "w.safetensors")
    second.load(tmp_path / "w.safetensors")
    found, expected = (one.read_indentation(BALLS.images[0]) for one in (second, first))
    assert (found.dtype, found.shape) == (np.float32, BALLS.geometry.shape)
    assert np.array_equal(found, expected)


@EACH
def test_damaged_or_foreign_weights_are_refused(name, tmp_path):
    whole = weights(make(name), tmp_path / "w")
    (tmp_path / "cut").write_bytes(whole[:-100])
    make(name, **OTHER[name]).save(tmp_path / "of-another-network")
    make(*(SMALL.keys() - {name})).save(tmp_path / "of-another-estimator")
    for file in ("cut", "of-another-network", "of-another-estimator", "missing"):
        with pytest.raises(WeightsError, match=naming(tmp_path / file, name, "calibrate")):
            make(name).load(tmp_path / file)


class Untouched(LabelledPresses):
    geometry, background = BALLS.geometry, BALLS.background

    def __len__(self) -> int:
        return 6

    def read_press(self, number: int):
        return BALLS.background, label_untouched(BALLS.geometry)


@EACH
def test_presses_without_contact_are_refused(name):
    with pytest.raises(CalibrationError, match="contact"):
        train(name, Untouched())


def test_unknown_options_and_estimators_are_named():
    for options, words in (({"stepz": 3}, ("'stepz'", "'steps'", "hidden (int)")), ({"steps": 0}, ("steps", 0))):
        with pytest.raises(ConfigError, match=naming("'photometric'", *words)):
            make("photometric", **options)
    with pytest.raises(CalibrationError, match=naming("'photometrik'", "'photometric'", "cnn")):
        make_estimator("photometrik", {}, BALLS.geometry, BALLS.background)


def test_fixed_features_are_scaled_and_oriented():
    gel = np.zeros((64, 80, 3), np.uint8)
    gel[..., 0] = 255
    fixed = stack_fixed_features(gel, WIDE)
    assert fixed.shape == (64, 80, FIXED)
    np.testing.assert_allclose(fixed[..., :3], np.broadcast_to([1, -1, -1], (64, 80, 3)), atol=1e-6)
    np.testing.assert_allclose(fixed[[0, 63], :, 4], [[-1] * 80, [1] * 80])
    np.testing.assert_allclose(fixed[:, [0, 79], 3], [[-1, 1]] * 64)


def test_features_of_a_crop_equal_those_of_the_whole_image():
    rng = np.random.default_rng(0)
    image, gel = (rng.integers(0, 256, (64, 80, 3), dtype=np.uint8) for _ in range(2))
    difference = scale_difference(image, gel)
    assert difference[3, 5, 1] == (int(image[3, 5, 1]) - int(gel[3, 5, 1])) / COLOUR_STEP
    fixed, part = stack_fixed_features(gel, WIDE), np.s_[10:20, 30:50]
    whole = stack_features(image, gel, fixed)
    assert whole.shape == (64, 80, PLANES)
    np.testing.assert_array_equal(stack_features(image[part], gel[part], fixed[part]), whole[part])
