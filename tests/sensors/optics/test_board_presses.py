"""Simulated presses of the calibration boards: labels, lamps, seeds and storage."""

import numpy as np
import pytest
from press_sets import sensor

from tactile_loc.sensors.optics import board_presses as module
from tactile_loc.sensors.optics.board_presses import SHARD, SimulatedSensor, simulate_presses
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.optics.simulate import press_boards
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore

LAMPS = OPTICS["gelslim"]
SENSOR = sensor(48, max_depth_m=2e-3)
LIT = SimulatedSensor(SENSOR, LAMPS)


@pytest.fixture
def store(tmp_path) -> StageStore:
    return StageStore(tmp_path)


def rendered(count: int, seed: int):
    """Images and indentations of the first presses, as the simulator makes them."""
    renderer = registry().create("renderer", "heightmap", {})
    rng = np.random.default_rng([seed, 0])
    untouched = render_background(SENSOR, LAMPS)
    done = list(press_boards(SENSOR, count, LAMPS, rng, renderer, background=untouched))
    press = np.concatenate([batch.press_depth_m for batch in done])
    return *(np.concatenate([getattr(b, name) for b in done]) for name in ("images", "indentation_m")), press


def test_labels_are_press_minus_depth_where_the_board_touches(store):
    presses = simulate_presses(LIT, 18, 3, store, variation=0.0)
    images, indentation_m, press_m = rendered(18, 3)
    assert len(presses) == 18
    for number, (image, label) in enumerate(presses.read_presses()):
        assert np.array_equal(image, images[number])
        assert np.array_equal(label.contact, indentation_m[number] > 0)
        assert np.allclose(label.indentation_m, indentation_m[number], atol=2e-3 / 65535)
        assert label.absolute
        assert label.contact.any()
        assert label.indentation_m.max() <= press_m[number] + 1e-6


@pytest.mark.slow
def test_different_lamps_leave_the_untouched_gel_unchanged(store):
    presses = simulate_presses(LIT, SHARD + 8, 0, store, variation=1.0)
    assert np.array_equal(presses.background, render_background(SENSOR, LAMPS))
    for image, label in presses.read_presses():
        far = label.known & ~label.contact  # 3 mm from any contact
        changed = np.abs(image[far].astype(int) - presses.background[far])
        assert changed.sum() <= 8 * changed.size


def test_lamps_differ_from_shard_to_shard(store):
    even, varied = (simulate_presses(LIT, 8, 0, store, variation=v) for v in (0.0, 1.0))
    assert even.key != varied.key
    assert not np.array_equal(even.images[0], varied.images[0])


def test_all_shards_exist_and_the_last_may_be_short(store):
    presses = simulate_presses(LIT, SHARD + 3, 0, store)
    assert [len(shard) for shard in presses.images] == [SHARD, 3]
    image, label = presses.read_press(SHARD + 2)
    assert np.array_equal(image, presses.images[1][2])
    assert np.array_equal(label.contact, presses.codes[1][2] > 0)
    assert presses.name(7) == "simulated press 7"


def test_stored_presses_are_not_rendered_again(store, monkeypatch):
    first = simulate_presses(LIT, 8, 0, store)
    monkeypatch.setattr(module, "press_boards", lambda *a, **k: pytest.fail("rendered again"))
    assert np.array_equal(simulate_presses(LIT, 8, 0, store).images[0], first.images[0])


@pytest.mark.slow
def test_an_interruption_keeps_the_finished_shards(tmp_path, monkeypatch):
    whole = simulate_presses(LIT, SHARD + 8, 0, StageStore(tmp_path / "whole"))
    asked, real = [], module.press_boards

    def interrupted(geometry, count, *rest, **more):
        asked.append(count)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return real(geometry, count, *rest, **more)

    monkeypatch.setattr(module, "press_boards", interrupted)
    store = StageStore(tmp_path / "resumed")
    with pytest.raises(KeyboardInterrupt):
        simulate_presses(LIT, SHARD + 8, 0, store)
    resumed = simulate_presses(LIT, SHARD + 8, 0, store)
    assert asked == [SHARD, 8, 8]
    for got, want in zip(resumed.images, whole.images, strict=True):
        assert np.array_equal(got, want)
