"""The convolutional estimator learns, resumes, and sees far enough."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch
from message_helpers import naming
from press_sets import sensor

from tactile_loc import EstimatorRecipe, SensorGeometry, StageStore
from tactile_loc.plugin import Progress, TrainingError
from tactile_loc.sensors.calibration.labels import LabelledPresses, label_surface
from tactile_loc.sensors.calibration.outcome import calibrate
from tactile_loc.sensors.optics.board_presses import SimulatedSensor, simulate_presses
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.optics.simulate import render_touches
from tactile_loc.sensors.reading.cnn import PLANES, CnnEstimator, GelNetwork
from tactile_loc.slots.encoder import Checkpoints

LAMPS = OPTICS["gelslim"]
SMALL = {"channels": 8, "epochs": 10, "batch": 4, "rate": 5e-3, "dropout": 0.1}
PRESS_M = 1e-3
SENSOR = sensor(64, 0.024, 2e-3)


@dataclass(frozen=True, eq=False)
class Tips(LabelledPresses):
    """A flat square tip, pressed in at different places, of different sizes."""

    count: int = 24
    geometry: SensorGeometry = SENSOR
    background: np.ndarray = field(default_factory=lambda: render_background(SENSOR, LAMPS))

    def __len__(self) -> int:
        return self.count

    def read_press(self, number: int):
        rng = np.random.default_rng(number)
        x, y = np.meshgrid(*SENSOR.pixel_slopes)
        half_m, (cx, cy) = rng.uniform(3.5e-3, 4.5e-3), rng.uniform(-6e-3, 6e-3, 2)
        contact = (np.abs(x - cx) < half_m) & (np.abs(y - cy) < half_m)
        depth = np.where(contact, 0, PRESS_M).astype(np.float32)
        image = render_touches(depth[None], [PRESS_M], SENSOR, LAMPS, rng)[0]
        return image, label_surface(PRESS_M - depth, contact, SENSOR)


class Notes(Progress):
    """Remembers what was shown."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


class InFile(Checkpoints):
    """Keeps a checkpoint in a file; interrupts the training after some of them."""

    def __init__(self, path, most: int = 1000) -> None:
        self.path, self.left = path, most

    def load(self):
        return self.path if self.path.exists() else None

    def save(self, write) -> None:
        write(self.path)
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def presses(tmp_path_factory):
    lit = SimulatedSensor(SENSOR, LAMPS)
    done = simulate_presses(lit, 40, 0, StageStore(tmp_path_factory.mktemp("store")))
    torch.set_num_threads(1)  # the renderer's threads have set it
    return done


def fitted(presses: LabelledPresses, checkpoints: Checkpoints | None = None, **options) -> CnnEstimator:
    estimator = CnnEstimator(SENSOR, presses.background, CnnEstimator.Options(**{**SMALL, **options}))
    estimator.fit(presses, Progress(), checkpoints or Checkpoints())
    return estimator


def weights(estimator: CnnEstimator, path) -> bytes:
    estimator.save(path)
    return path.read_bytes()


@pytest.mark.slow
def test_training_reduces_the_loss_and_beats_a_zero_depth(presses):
    notes = Notes()
    options = {**SMALL, "epochs": 25}
    done = calibrate(presses, EstimatorRecipe("cnn", options), notes)
    losses_mm = [float(note.split()[2]) for note in notes.notes]
    assert len(losses_mm) == options["epochs"]
    assert losses_mm[-1] < 0.95 * losses_mm[0]
    held_out = [presses.read_press(number) for number in done.held_out]
    none_m = np.mean([np.sqrt(np.mean(label.indentation_m[label.contact] ** 2)) for _, label in held_out])
    assert done.mean_errors["depth_m"] < 0.8 * none_m
    assert "slope_deg" not in done.mean_errors


def test_the_network_stores_the_statistics_of_the_presses(presses):
    network = fitted(presses, epochs=1)._network
    indentation_m = np.stack([label.indentation_m for _, label in presses.read_presses()])
    assert float(network.output_mean) == pytest.approx(indentation_m.mean(), rel=1e-3)
    assert float(network.output_std) == pytest.approx(indentation_m.std(), rel=1e-3)
    difference = np.stack([image - presses.background.astype(float) for image, _ in presses.read_presses()]) / 64
    assert network.input_mean.numpy()[:3, 0, 0] == pytest.approx(difference.mean(axis=(0, 1, 2)), abs=1e-4)
    assert network.input_std.numpy()[:3, 0, 0] == pytest.approx(difference.std(axis=(0, 1, 2)), rel=1e-3)


@pytest.mark.parametrize("epochs_done", [1, 2])
def test_a_resumed_training_gives_the_same_weights(tmp_path, epochs_done):
    whole = weights(fitted(Tips(10), epochs=3), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        fitted(Tips(10), InFile(tmp_path / "checkpoint", epochs_done), epochs=3)
    resumed = fitted(Tips(10), InFile(tmp_path / "checkpoint"), epochs=3)
    assert weights(resumed, tmp_path / "resumed") == whole


@pytest.mark.slow
def test_a_wide_receptive_field_recovers_the_middle_of_a_flat_contact():
    image, label = Tips().read_press(1001)
    x, y = np.nonzero(label.contact)
    middle = np.s_[int(x.mean()) - 2 : int(x.mean()) + 3, int(y.mean()) - 2 : int(y.mean()) + 3]
    assert np.abs(image[middle].astype(int) - render_background(SENSOR, LAMPS)[middle]).mean() < 3  # looks untouched
    sees_far, sees_near = (fitted(Tips(), epochs=20, dilations=d) for d in ((1, 2, 4, 8, 16), (1,) * 5))
    assert sees_far.read_indentation(image)[middle].mean() > 0.5 * PRESS_M
    assert sees_near.read_indentation(image)[middle].mean() < 0.25 * PRESS_M


def test_the_default_receptive_field_reaches_31_pixels_to_each_side():
    network = GelNetwork(4, CnnEstimator.Options().dilations, 0.0).eval()
    features = torch.zeros(1, PLANES, 1, 101, requires_grad=True)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.abs_().add_(0.01)  # nothing cancels
    network(features)[0, 0, 50].backward()
    seen = torch.nonzero(features.grad.abs().sum(dim=(0, 1, 2))).ravel()
    assert (int(seen.min()), int(seen.max())) == (50 - 31, 50 + 31)


def test_a_nan_loss_stops_training():
    with pytest.raises(TrainingError, match=naming("NaN", "epoch 1", "rate")):
        fitted(Tips(12), rate=1e30)
