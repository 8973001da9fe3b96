"""The reader of YCB-Slide, on a small replica: poses, chosen frames, and refused files."""

import pickle
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from tactile_loc.plugin import ConfigError, TouchError, registry
from tactile_loc.plugin.helpers import transform_points

from tactile_loc_benchmark.sources.ycb_slide import STANDOFF_M, YcbSlide, read_pickled

NAME, FRAMES, FIRST = "035_power_drill", 12, 8
CHOSEN = (8, 10, 11)
SHIFT_M = np.array([1e-3, -2e-3, 5e-4])


@pytest.fixture
def source(tmp_path: Path) -> YcbSlide:
    """A DIGIT above a box, which looks down along -z of its own frame, in a world that is turned."""
    recording = tmp_path / "real" / NAME / "dataset_0"
    (recording / "frames").mkdir(parents=True)
    mesh = tmp_path / "obj_models" / NAME / "nontextured.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box((0.04, 0.03, 0.02)).export(mesh)
    for number in range(FRAMES):
        image = np.full((24, 32, 3), 200 if number >= FIRST else 90 + number, np.uint8)
        PIL.Image.fromarray(image).save(recording / "frames" / f"frame_{number:07d}.jpg")
    world = Rotation.from_euler("xyz", [0.3, -0.2, 0.9])
    digit_m = (
        np.stack([np.linspace(0, 0.01, FRAMES), np.zeros(FRAMES), np.full(FRAMES, 0.01 + 0.022)], axis=1) - SHIFT_M
    )
    quaternion = np.tile(world.as_quat(), (FRAMES, 1))
    poses = {
        "DIGIT": np.hstack([world.apply(digit_m), quaternion]),
        NAME: np.hstack([np.zeros((FRAMES, 3)), quaternion]),
    }
    np.save(
        recording / "synced_data.npy", {"poses": poses, "start_time": "now", "timestamps": [0.1]}, allow_pickle=True
    )
    alignment = np.eye(4)
    alignment[:3, 3] = SHIFT_M
    np.save(tmp_path / "real" / NAME / "alignment.npy", alignment)
    return YcbSlide(YcbSlide.Options(data=str(tmp_path), sensor="my_digit", touches=3))


def test_the_touched_face_is_at_the_gel_and_the_sensor_slides(source):
    assert source.find_objects()[NAME].mesh.extents_m == pytest.approx([0.04, 0.03, 0.02])
    touches = list(source.read_touches(NAME))
    assert [touch.name for touch in touches] == [f"dataset_0 frame_{n:07d}" for n in CHOSEN]
    assert touches[0].image.shape == (24, 32, 3)
    for touch, number in zip(touches, CHOSEN, strict=True):
        below = [0.01 * number / (FRAMES - 1), 0.0, 0.01]  # the point of the upper face below the sensor
        np.testing.assert_allclose(transform_points(touch.T_sensor_object, [below])[0], [0, 0, STANDOFF_M], atol=1e-9)
        outwards = touch.T_sensor_object[:3, :3] @ [0, 0, 1]
        np.testing.assert_allclose(outwards, [0, 0, -1], atol=1e-9)  # the sensor looks at the face


def test_images_may_be_turned(source):
    turned = YcbSlide(source.options.model_copy(update={"turn_deg": 90.0}))
    one, other = (next(iter(each.read_touches(NAME))).T_sensor_object for each in (source, turned))
    between = Rotation.from_matrix((one @ np.linalg.inv(other))[:3, :3]).as_rotvec(degrees=True)
    np.testing.assert_allclose(between, [0, 0, 90], atol=1e-6)


def test_a_missing_or_damaged_set_is_refused(source, tmp_path):
    with pytest.raises(ConfigError):
        YcbSlide(YcbSlide.Options(data="nowhere", sensor="my_digit")).find_objects()
    poses = tmp_path / "real" / NAME / "dataset_0" / "synced_data.npy"
    whole = poses.read_bytes()
    poses.write_bytes(whole[:-40])
    with pytest.raises(TouchError):
        list(source.read_touches(NAME))
    poses.write_bytes(whole)
    next((poses.parent / "frames").iterdir()).unlink()
    with pytest.raises(TouchError):
        list(source.read_touches(NAME))


class Bad:
    def __reduce__(self):
        return print, ("this must not run",)


def test_a_pickle_that_runs_code_is_refused(tmp_path, capsys):
    np.save(tmp_path / "bad.npy", {"poses": Bad()}, allow_pickle=True)
    with pytest.raises(pickle.UnpicklingError):
        read_pickled(tmp_path / "bad.npy")
    assert capsys.readouterr().out == ""


def test_the_source_is_registered():
    assert registry().load("touch-source", "ycb-slide") is YcbSlide
