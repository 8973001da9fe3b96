from collections.abc import Callable

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import StageStore, load_object
from tactile_loc.locate.sources import listed_grid as module
from tactile_loc.locate.sources.listed_grid import ObjectPoseModel, build_bank, build_model
from tactile_loc.plugin import GridError, Progress, Scene
from tactile_loc.plugins.encoders.pixel import PixelEncoder
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

SHARD = 64


class Counting(ZBufferRenderer):
    """Records how many poses each call rendered, can fail at one call, and can have another version."""

    def __init__(self, stop_at: int | None = None, make: str = "counting") -> None:
        super().__init__()
        self.calls: list[int] = []
        self.stop_at, self.make = stop_at, make

    def describe(self):
        return {**super().describe(), "class": self.make}

    def render(self, mesh, T_sensor_object, geometry):
        if len(self.calls) == self.stop_at:
            raise KeyboardInterrupt
        self.calls.append(len(T_sensor_object))
        return super().render(mesh, T_sensor_object, geometry)


@pytest.fixture(autouse=True)
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SHARD", SHARD)


@pytest.fixture
def own_store(tmp_path) -> StageStore:
    return StageStore(tmp_path / "store")


@pytest.fixture(scope="module")
def sampler() -> FaceGrid:
    return FaceGrid(FaceGrid.Options(spacing_mm=8.0, min_contact_percent=4.0))


@pytest.fixture(scope="module")
def make_pin_scene(pinhole) -> Callable[..., Scene]:
    pin = load_object("pin")
    return lambda renderer=None: Scene(pin, pinhole, renderer or Counting())


def stages(store: StageStore) -> list[str]:
    return [key.stage for key in store.built]


def build(scene: Scene, sampler: FaceGrid, store: StageStore) -> ObjectPoseModel:
    return build_model(scene, sampler, store, Progress())


def test_stored_shapes_decode_to_the_rendered_ones_and_are_cut_for_lighter_presses(make_pin_scene, sampler, own_store):
    scene = make_pin_scene()
    model = build(scene, sampler, own_store)
    rendered = scene.render_contact_depths(model.grid.T_sensor_object, grid=True)
    decoded = np.concatenate(list(model.shapes.shards()))
    assert decoded.dtype == np.float32
    assert decoded.shape == (model.size, *scene.geometry.shape)
    max_depth_m = scene.geometry.max_depth_m
    half_step_m = 0.51 * max_depth_m / 65535
    assert np.abs(decoded - rendered).max() <= half_step_m + 3e-9  # with float32 rounding
    touching = rendered < np.float32(max_depth_m)
    assert np.array_equal(decoded < np.float32(max_depth_m), touching)
    for index in (0, 1, SHARD - 1, SHARD, model.size - 1):
        assert np.array_equal(model.shapes.shape(index, max_depth_m), decoded[index])
    press_m = 0.0007
    cut = np.concatenate(list(model.shapes.shards(press_m)))
    exact = scene.render_contact_depths(model.grid.T_sensor_object, press_m)
    assert cut.max() == np.float32(press_m)
    assert np.abs(cut - exact).max() < 2e-8
    assert np.array_equal(model.shapes.shape(3, press_m), cut[3])


class Farther(ZBufferRenderer):
    """Draws everything 0.5 mm farther away, so there is less contact."""

    def render(self, mesh, T_sensor_object, geometry):
        return super().render(mesh, T_sensor_object, geometry) + np.float32(5e-4)


def test_a_fixed_renderer_decides_which_poses_touch(make_pin_scene, sampler, own_store):
    other, usual = make_pin_scene(Farther()), make_pin_scene()
    alone, ours = (build(scene, sampler, own_store) for scene in (other, usual))
    judged = build_model(other, sampler, own_store, Progress(), usual.renderer)
    assert alone.size < ours.size
    np.testing.assert_array_equal(judged.grid.T_sensor_object, ours.grid.T_sensor_object)
    depths = np.concatenate(list(judged.shapes.shards()))
    np.testing.assert_allclose(depths, other.render_contact_depths(judged.grid.T_sensor_object), atol=4e-8)
    same = build_model(usual, sampler, own_store, Progress(), usual.renderer)
    assert same.key == ours.key
    assert len({model.key for model in (alone, judged, ours)}) == 3


def test_a_barely_touching_pixel_still_touches_after_storage():
    max_depth_m = 0.002
    depths = np.array([[[0.0, np.nextafter(np.float32(max_depth_m), np.float32(0)), max_depth_m, 0.00123]]], np.float32)
    codes = module._encode(depths, max_depth_m)
    assert codes.dtype == np.uint16
    assert codes[0, 0, :3].tolist() == [0, 65534, 65535]
    assert codes[0, 0, 3] * max_depth_m / 65535 == pytest.approx(0.00123, abs=2e-8)
    assert np.array_equal(
        module.ShapeBank._decode(module.ShapeBank(None, max_depth_m), codes, np.float32(max_depth_m))
        < np.float32(max_depth_m),
        depths < np.float32(max_depth_m),
    )


def test_poses_with_too_little_contact_are_pruned(make_pin_scene, sampler, own_store):
    scene = make_pin_scene()
    contact = (
        scene.render_contact_depths(build(scene, sampler, own_store).grid.T_sensor_object) < np.float32(0.002)
    ).mean(axis=(1, 2))
    assert contact.min() >= 0.04
    everything = build(scene, FaceGrid(FaceGrid.Options(spacing_mm=8.0, min_contact_percent=0.0)), own_store)
    assert everything.size > len(contact)


def test_poses_and_shapes_stay_together(make_pin_scene, own_store):
    """This also holds if whole shards are pruned."""
    scene = make_pin_scene()
    module.SHARD = 8
    model = build(scene, FaceGrid(FaceGrid.Options(spacing_mm=8.0, min_contact_percent=9.0)), own_store)
    assert 0 in model.shapes.artifact.load_json("sizes")
    assert all(len(depths) for depths in model.shapes.shards()), "the encoder got an empty batch"
    rendered = scene.render_contact_depths(model.grid.T_sensor_object, grid=True)
    np.testing.assert_allclose(np.concatenate(list(model.shapes.shards())), rendered, atol=1e-7)
    for index in range(0, model.size, 7):
        np.testing.assert_allclose(model.shapes.shape(index, 0.002), rendered[index], atol=1e-7)
    bank = build_bank(model, scene, PixelEncoder(), 0.002, own_store, Progress())
    np.testing.assert_allclose(bank, PixelEncoder().encode(rendered, 0.002, scene.geometry), atol=1e-6)


def test_a_grid_without_remaining_poses_is_refused(make_pin_scene, own_store):
    with pytest.raises(GridError, match=naming("pin", "95 %", "grid.min_contact_percent")):
        build(make_pin_scene(), FaceGrid(FaceGrid.Options(spacing_mm=8.0, min_contact_percent=95.0)), own_store)


def test_a_change_rebuilds_only_the_stages_that_depend_on_it(make_pin_scene, sampler, own_store):
    def built(
        scene: Scene, sampler: FaceGrid = sampler, encoder: PixelEncoder | None = None, press_m: float = 0.002
    ) -> list[str]:
        before = len(own_store.built)
        model = build(scene, sampler, own_store)
        build_bank(model, scene, encoder or PixelEncoder(), press_m, own_store, Progress())
        return stages(own_store)[before:]

    assert built(make_pin_scene()) == ["grid", "shapes", "bank"]
    assert built(make_pin_scene()) == []
    assert built(make_pin_scene(), encoder=PixelEncoder(PixelEncoder.Options(cells=10))) == ["bank"]
    assert built(make_pin_scene(), press_m=0.001) == ["bank"]
    assert built(make_pin_scene(Counting(make="other"))) == ["shapes", "bank"]
    finer = FaceGrid(FaceGrid.Options(spacing_mm=7.0, min_contact_percent=4.0))
    assert built(make_pin_scene(), sampler=finer) == ["grid", "shapes", "bank"]
    smaller = make_pin_scene().geometry.resize(32, 24)
    assert built(Scene(make_pin_scene().object, smaller, Counting())) == ["grid", "shapes", "bank"]
    other = load_object("pin", symmetry="none")
    assert built(Scene(other, make_pin_scene().geometry, Counting())) == ["grid", "shapes", "bank"]
    assert built(make_pin_scene()) == [], "the store kept less than the whole build"


def test_a_bank_of_a_lighter_press_equals_the_rendered_shapes(make_pin_scene, sampler, own_store):
    scene = make_pin_scene()
    scene = scene.press(scene.geometry.max_depth_m)
    model, press_m = build(scene, sampler, own_store), 0.0007
    bank = build_bank(model, scene, PixelEncoder(), press_m, own_store, Progress())
    light = scene.press(press_m)
    depths = light.render_contact_depths(
        model.grid.raise_level(scene.geometry.max_depth_m - press_m).T_sensor_object, grid=True
    )
    wrong = np.abs(bank - PixelEncoder().encode(depths, press_m, light.geometry)) > 1e-4
    assert wrong.mean() < 1e-4, "only depths equal to the press depth up to rounding may differ"


def test_an_interrupted_build_resumes_where_it_stopped(make_pin_scene, sampler, own_store, tmp_path):
    whole = build(make_pin_scene(uninterrupted := Counting()), sampler, StageStore(tmp_path / "other"))
    assert len(uninterrupted.calls) >= 4, "the build has only one shard"
    with pytest.raises(KeyboardInterrupt):
        build(make_pin_scene(stopped := Counting(stop_at=2)), sampler, own_store)
    assert stages(own_store) == ["grid"]
    resumed = build(make_pin_scene(going_on := Counting()), sampler, own_store)
    assert stopped.calls + going_on.calls == uninterrupted.calls, "a shard was rendered twice"
    assert np.array_equal(resumed.grid.T_sensor_object, whole.grid.T_sensor_object)
    assert np.array_equal(np.concatenate(list(resumed.shapes.shards())), np.concatenate(list(whole.shapes.shards())))
    assert resumed.shapes.artifact.names == whole.shapes.artifact.names
    assert all(resumed.shapes.artifact.files[n] == whole.shapes.artifact.files[n] for n in whole.shapes.artifact.names)


def test_progress_reports_every_pose(make_pin_scene, sampler, own_store):
    from contextlib import contextmanager

    done: dict[str, list[int]] = {}

    class Watch(Progress):
        @contextmanager
        def task(self, description, total):
            done[description] = [total, 0]

            def advance(steps: int) -> None:
                done[description][1] += steps

            yield advance

    scene = make_pin_scene()
    model = build_model(scene, sampler, own_store, Watch())
    build_bank(model, scene, PixelEncoder(), 0.002, own_store, Watch())
    assert len(done) == 3
    assert all(total == steps for total, steps in done.values())
    assert done["encoding contact shapes"][0] == model.size
