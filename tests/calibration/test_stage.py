"""The stage of calibrating: found again for the same presses and options, done again when anything differs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh

torch = pytest.importorskip("torch")

from press_sets import TINY, ball_set, write_table  # noqa: E402

from tactile_loc.calibration.calibrate import split  # noqa: E402
from tactile_loc.calibration.photometric import PhotometricEstimator  # noqa: E402
from tactile_loc.calibration.presses import read_presses  # noqa: E402
from tactile_loc.calibration.stage import calibrate_stage  # noqa: E402
from tactile_loc.core.errors import ConfigError  # noqa: E402
from tactile_loc.core.progress import Progress  # noqa: E402
from tactile_loc.store.store import StageStore  # noqa: E402

BALLS = ball_set(5)
FEW = {**TINY, "steps": 5}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    trimesh.creation.box((6, 3, 4)).export(tmp_path / "box.stl")
    return BALLS.write(tmp_path)


@pytest.fixture
def store(tmp_path: Path) -> StageStore:
    return StageStore(tmp_path / "store")


def stage(folder: Path, store: StageStore, seed: int = 0, geometry=BALLS.geometry, **options: object):
    presses = read_presses(folder, geometry)
    return calibrate_stage(presses, folder, "photometric", {**FEW, **options}, seed, store, Progress())


def test_the_second_time_it_is_found(folder, store, monkeypatch):
    made, record = stage(folder, store)
    monkeypatch.setattr(PhotometricEstimator, "fit", None)  # would fail if it were asked to
    again, same_record = stage(folder, store)
    assert len(store.built) == 1
    assert again.options == made.options
    np.testing.assert_array_equal(again.slopes(BALLS.images[0]), made.slopes(BALLS.images[0]))
    assert record == same_record
    assert record["held_out"]["presses"] == list(split(5, 0)[1])
    assert set(record["held_out"]["mean"]) == {"slope_deg", "shape_m", "untouched_m"}


def test_options_the_default_of_which_is_said_are_the_same(folder, store):
    stage(folder, store)
    stage(folder, store, seed=0, rate=PhotometricEstimator.Options().rate)
    assert len(store.built) == 1


@pytest.mark.parametrize("what", ["options", "seed", "image", "background", "label", "geometry"])
def test_it_is_done_again_when_anything_differs(folder, store, what):
    stage(folder, store)
    more: dict = {"options": {"steps": 6}, "seed": {"seed": 1}}.get(what, {})
    if what == "image":
        (folder / "0000.png").write_bytes((folder / "0001.png").read_bytes())
    elif what == "background":
        (folder / "background.png").write_bytes((folder / "0001.png").read_bytes())
    elif what == "label":
        rows = BALLS.rows()
        rows[1]["radius_px"] *= 1.1
        write_table(folder, rows)
    elif what == "geometry":
        more["geometry"] = dataclasses.replace(BALLS.geometry, fx=1.01 * BALLS.geometry.fx)
    stage(folder, store, **more)
    assert len(store.built) == 2


def test_it_is_done_again_when_a_mesh_is_another(folder, store):
    rows = BALLS.rows()
    pose = dict.fromkeys(("x_mm", "y_mm", "roll_deg", "pitch_deg", "yaw_deg"), 0)
    rows[2] |= {"kind": "mesh", "mesh": "box.stl", "units": "mm", "press_mm": 0.4, **pose}
    write_table(folder, rows)
    stage(folder, store)
    stage(folder, store)
    trimesh.creation.box((5, 3, 4)).export(folder / "box.stl")
    stage(folder, store)
    assert len(store.built) == 2


def test_an_interruption_leaves_nothing_that_counts(folder, store, monkeypatch):
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
    np.testing.assert_array_equal(interrupted.slopes(BALLS.images[0]), whole.slopes(BALLS.images[0]))


def test_a_stored_one_that_is_damaged_is_made_again(folder, store):
    made, _ = stage(folder, store)
    (weights,) = store.root.rglob("estimator.safetensors")
    weights.chmod(0o644)
    weights.write_bytes(weights.read_bytes()[:-40])
    again, _ = stage(folder, StageStore(store.root))
    np.testing.assert_array_equal(again.slopes(BALLS.images[0]), made.slopes(BALLS.images[0]))


def test_bad_options_are_refused_before_anything_is_stored(folder, store):
    with pytest.raises(ConfigError, match="'stepz'"):
        stage(folder, store, stepz=3)
    assert not store.entries()
