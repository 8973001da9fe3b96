"""The learned encoder learns, is reproducible for a seed, and is not changed by an interruption."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from message_helpers import missing, naming

torch = pytest.importorskip("torch")

from tactile_loc.core.runtime.errors import ConfigError, GridError, TrainingError, WeightsError  # noqa: E402
from tactile_loc.core.sensing.noise import make_noise  # noqa: E402
from tactile_loc.locate.localizer import Localizer  # noqa: E402
from tactile_loc.plugins.encoders.moco import encoder as module  # noqa: E402
from tactile_loc.plugins.encoders.moco import recipe, training  # noqa: E402
from tactile_loc.plugins.encoders.moco.encoder import MocoEncoder  # noqa: E402
from tactile_loc.simulate.listed_training import ListedProblem  # noqa: E402
from tactile_loc.slots.encoder import Checkpoints  # noqa: E402
from tactile_loc.store.store import StageStore  # noqa: E402
from tactile_loc.testing.problems import make_place_training_problem  # noqa: E402

TINY = {"epochs": 3, "queries": 64, "batch": 32, "channels": 4, "noise": "mild"}
PLACES = {"epochs": 2, "queries": 32}  # all rotations of a place are touches of it

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(autouse=True, scope="module")
def few_touches_to_validate_with():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "VALIDATION_TOUCHES", 32)
        yield


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """A coarse grid of the pin on a small sensor."""
    localizer = Localizer.create(
        "pin",
        store=StageStore(tmp_path_factory.mktemp("store")),
        sensor="digit",
        shape_px=32,
        grid={"name": "face", "spacing_mm": 8},
    )
    model = localizer.model
    return ListedProblem(model.grid, localizer.coarse_scene, localizer.sampler, model.shapes.shards)


def make(**options) -> MocoEncoder:
    return MocoEncoder(MocoEncoder.Options(**{**TINY, **options}))


def weights(encoder: MocoEncoder) -> dict[str, np.ndarray]:
    return {k: v.numpy() for k, v in encoder._network.state_dict().items()}


def same(a: MocoEncoder, b: MocoEncoder) -> bool:
    left, right = weights(a), weights(b)
    return left.keys() == right.keys() and all(np.array_equal(left[k], right[k]) for k in left)


@pytest.fixture(scope="module")
def learned(problem, one_thread) -> MocoEncoder:
    """An encoder that was trained without interruption; tests must not change it."""
    encoder = make()
    encoder.fit(problem)
    return encoder


class FileCheckpoints(Checkpoints):
    """Keeps one file; raises KeyboardInterrupt after saving `stop_at` times."""

    def __init__(self, folder: Path, stop_at: int = 0) -> None:
        self.path, self.stop_at, self.saved = folder / "checkpoint.safetensors", stop_at, 0

    def load(self) -> Path | None:
        return self.path if self.path.exists() else None

    def save(self, write) -> None:
        write(self.path)
        self.saved += 1
        if self.saved == self.stop_at:
            raise KeyboardInterrupt


def test_the_momentum_copy_has_the_statistics_and_averaged_weights_of_the_network():
    fast, slow = (torch.nn.Sequential(torch.nn.Conv2d(1, 2, 3), torch.nn.BatchNorm2d(2)) for _ in range(2))
    before = [weight.detach().clone() for weight in slow.parameters()]
    fast(3.0 + torch.randn(4, 1, 8, 8))  # training mode: the statistics follow
    training.follow(slow, fast, 0.9)
    for theirs, ours in zip(slow.buffers(), fast.buffers(), strict=True):
        torch.testing.assert_close(theirs, ours)
    for theirs, was, ours in zip(slow.parameters(), before, fast.parameters(), strict=True):
        torch.testing.assert_close(theirs, 0.9 * was + 0.1 * ours)
    assert not torch.allclose(slow[1].running_mean, torch.zeros(2))


@pytest.mark.slow
def test_equal_seeds_learn_equal_weights_and_other_seeds_learn_others(problem, learned):
    again, other = make(), make(seed=1)
    for encoder in (again, other):
        encoder.fit(problem)
    assert same(learned, again)
    assert not same(learned, other)


@pytest.mark.slow
def test_early_stopping_keeps_the_best_network(problem, monkeypatch):
    losses = iter([3.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    seen = []
    monkeypatch.setattr(training.Trainer, "_validate", lambda self, v: (next(losses), 0.0))
    judge = training.Trainer._judge

    def judge_and_keep(self, *measured):
        judge(self, *measured)
        seen.append(training._copy_weights(self.network))

    monkeypatch.setattr(training.Trainer, "_judge", judge_and_keep)
    encoder = make(epochs=6, patience=2)
    encoder.fit(problem)
    assert len(seen) == 4  # two epochs after the second one bring no improvement
    assert all(np.array_equal(v, seen[1][k].numpy()) for k, v in weights(encoder).items())


def test_a_nan_loss_in_the_first_epoch_stops_with_advice(problem, monkeypatch):
    monkeypatch.setattr(training.Trainer, "_step", lambda *a: float("nan"))
    with pytest.raises(TrainingError, match=naming("NaN", "encoder.rate")):
        make().fit(problem)


def test_a_later_nan_loss_keeps_the_last_good_network(problem, monkeypatch, caplog):
    good = make(epochs=1)
    step = training.Trainer._step
    monkeypatch.setattr(training.Trainer, "_step", lambda self, *a: step(self, *a) if self.epoch == 0 else float("nan"))
    encoder = make()
    encoder.fit(problem)
    monkeypatch.undo()
    assert not missing(caplog.text, "NaN", "epoch 2")
    assert all(np.isfinite(v).all() for v in weights(encoder).values())
    assert good.recipe.epochs == 1


@pytest.mark.parametrize("damage", ["truncated", "another architecture"])
def test_weights_that_do_not_fit_are_refused(learned, tmp_path, damage):
    path = tmp_path / "w.safetensors"
    learned.save_weights(path)
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    reader = make() if damage == "truncated" else make(channels=8)
    with pytest.raises(WeightsError, match=r"w\.safetensors"):
        reader.load_weights(path)


def test_a_missing_gpu_is_refused(problem, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    encoder = make(device="cuda")
    with pytest.raises(ConfigError, match=naming("'moco'", "CUDA", "encoder.device")):
        encoder.fit(problem)


def test_a_grid_too_large_for_memory_is_refused_with_the_memory_it_needs(problem, monkeypatch):
    monkeypatch.setattr(module.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
    with pytest.raises(GridError, match=naming("GiB", "encoder.batch", "grid.spacing_mm")):
        make().fit(problem)


def test_an_untrained_encoder_refuses_to_encode(problem):
    depth = np.concatenate(list(problem.shapes()))[:1]
    with pytest.raises(ConfigError, match="'moco'"):
        make().encode(depth, 1e-3, problem.scene.geometry)


def test_the_input_holds_the_averaged_observed_contact_and_the_press(problem):
    geometry = problem.scene.geometry
    depth = torch.full((1, *geometry.shape), geometry.max_depth_m)
    depth[0, : geometry.height_px // 2] = 0.0
    depth[0, 0, 0] = 0.3 * geometry.max_depth_m
    press_m = np.array([0.5 * geometry.max_depth_m])
    planes = recipe.Recipe(image_px=40, signal="depth").make_planes(depth, press_m, geometry)
    assert planes.shape == (1, 3, *geometry.resize_long_side(40).shape)
    np.testing.assert_allclose(planes[0, 0].mean(), 0.5, atol=0.02)
    np.testing.assert_allclose(planes[0, 1].mean(), 0.25, atol=0.01)
    np.testing.assert_allclose(planes[0, 2], 0.5)
    whole = recipe.Recipe(image_px=max(geometry.shape), signal="depth").make_planes(depth, press_m, geometry)
    np.testing.assert_allclose(whole[0, 1, 0, 0], 0.2, atol=1e-6)
    mask_alone = recipe.Recipe(image_px=40, signal="binary").make_planes(depth, press_m, geometry)
    assert torch.equal(mask_alone, planes[:, [0, 2]])


def test_a_localizer_trains_once_and_reads_the_weights_back(store):
    settings = {"grid": {"name": "face", "spacing_mm": 12}, "encoder": {"name": "moco", **TINY, "epochs": 1}}
    first = Localizer.create("pin", store=store, **settings)
    touch = first.simulate(seed=2)[0]
    posterior = first.posterior(touch)
    built = [key.stage for key in store.built]
    assert built.count("encoder") == 1
    again = Localizer.create("pin", store=store, **settings, refiner="none", seed=5)
    np.testing.assert_array_equal(again.posterior(touch).log_p, posterior.log_p)
    assert [key.stage for key in store.built] == built


@pytest.fixture(scope="module")
def places(one_thread):
    """Return an encoder that has learned the places of a small block, and its training problem."""
    problem, encoder = make_place_training_problem(), make(**PLACES)
    encoder.fit(problem)
    return encoder, problem


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "stop_at"), [("poses", 1), ("poses", 2), ("places", 1)])
def test_an_interrupted_training_ends_like_an_uninterrupted_one(problem, learned, places, tmp_path, kind, stop_at):
    encoder, problem, options = (learned, problem, {}) if kind == "poses" else (*places, PLACES)
    with pytest.raises(KeyboardInterrupt):
        make(**options).fit(dataclasses.replace(problem, checkpoints=FileCheckpoints(tmp_path, stop_at)))
    resumed = make(**options)
    resumed.fit(dataclasses.replace(problem, checkpoints=FileCheckpoints(tmp_path)))
    assert same(encoder, resumed)


def test_weights_are_read_back_from_a_file(problem, learned, places, tmp_path):
    depth, (keys, seen) = np.concatenate(list(problem.shapes()))[:5], some_seen(places[1], np.random.default_rng(1))
    geometry, camera = problem.scene.geometry, places[1].geometry
    for written, read in ((learned, make()), (places[0], make(**PLACES))):
        written.save_weights(tmp_path / "w.safetensors")
        read.load_weights(tmp_path / "w.safetensors")
        assert same(written, read)
        both = (written, read)
        if written is learned:
            np.testing.assert_array_equal(*(one.encode(depth, geometry.max_depth_m, geometry) for one in both))
        else:
            np.testing.assert_array_equal(*(one.encode_seen(keys, seen, 1e-3, camera)[0] for one in both))


def some_seen(problem, rng):
    keys = next(iter(problem.clean_keys(1e-3)))[:6]
    return keys, rng.random(keys.shape) < 0.7


@pytest.mark.slow
def test_the_encoder_learns_to_distinguish_places(places):
    _, problem = places
    encoder = make(epochs=2, queries=128, noise="none")
    encoder.recipe = dataclasses.replace(encoder.recipe, momentum=0.9, refresh=8)
    encoder.fit(problem)
    press_m = float(problem.key_presses_m[-1])
    batch = problem.draw(60, make_noise("none"), np.random.default_rng(7)).batch(60, np.random.default_rng(8), press_m)
    keys = encoder.encode(np.concatenate(list(problem.clean_keys(press_m))), press_m, problem.geometry)
    vectors, _ = encoder.encode_seen(batch.depth_m, batch.seen, press_m, problem.geometry)
    ranks = (vectors @ keys.T > np.sum(vectors * keys[batch.labels], axis=1)[:, None]).sum(axis=1)
    assert np.median(ranks) < 0.025 * len(problem), "an untrained network reaches 0.04 and more"
