"""A result's files: they are read as written, and a damaged file gives an error of one sentence."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ObjectError, ResultError, TactileLocError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.io.streams.records import read_document
from tactile_loc.locate.result.result_arrays import (
    ResultArrays,
    TouchArrays,
    find_most_probable,
    gather_arrays,
    hash_record,
    read_arrays,
    unpack_arrays,
    write_arrays,
)
from tactile_loc.locate.result.result_json import SETS_OF_GRID_POSES, read_record


@pytest.fixture
def copy(run_folder: Path, tmp_path: Path) -> Path:
    """A result that a test may change."""
    return shutil.copytree(run_folder, tmp_path / "copy")


def read(folder: Path) -> ResultArrays:
    return read_arrays(folder / "result.npz", read_record(folder / "result.json"))


def test_written_arrays_are_read_back(tmp_path, run_folder):
    record = read_record(run_folder / "result.json")
    rng = np.random.default_rng(0)
    observed = rng.random((6, 8)) > 0.2
    geometry = SensorGeometry(
        "orthographic", 8, 6, 1000.0, 900.0, 4.2, 3.1, 0.01, 0.002, (-0.003, 0.003, -0.002, 0.002), observed
    )
    depth = rng.uniform(0, 0.002, (6, 8)).astype(np.float32)
    made = rng.uniform(0, 0.002, (len(record.hypotheses), 6, 8)).astype(np.float32)
    image = rng.integers(0, 255, (6, 8, 3), np.uint8)
    T = make_transform(np.eye(3), [0.1, 0.2, 0.3])
    touches = [TouchArrays(ContactShape(depth, 0.0015), geometry, T, made, image)] * 2
    mesh = TriangleMesh(rng.random((5, 3)), np.array([[0, 1, 2], [2, 3, 4]]))
    arrays = ResultArrays(mesh, np.stack([T, T]), np.log([0.75, 0.25]), tuple(touches))
    write_arrays(tmp_path / "result.npz", arrays, record)
    found = read_arrays(tmp_path / "result.npz", record)
    assert found.mesh.vertices_m == pytest.approx(mesh.vertices_m, rel=1e-6)
    assert (found.mesh.faces == mesh.faces).all()
    assert found.T_sensor_object == pytest.approx(arrays.T_sensor_object, rel=1e-6)
    assert found.weights == pytest.approx([0.75, 0.25], rel=1e-6)
    assert len(found.touches) == 2
    for touch in found.touches:
        assert touch.geometry.describe() == geometry.describe()
        assert (touch.geometry.observed_mask == geometry.observed_mask).all()
        assert (touch.shape.depth_m == depth).all()
        assert touch.shape.press_depth_m == 0.0015
        assert (touch.made_m == made).all()
        assert (touch.image == image).all()
        assert (touch.T_sensor_first == T).all()


def test_the_arrays_of_a_run_hold_the_posterior_and_the_rendered_shapes(run_folder, localizer):
    record, arrays = read_record(run_folder / "result.json"), read(run_folder)
    (touch,) = arrays.touches
    assert len(arrays.log_p) <= record.grid_poses
    assert arrays.mass == pytest.approx(1.0, abs=1e-4)
    assert (np.diff(arrays.log_p) <= 0).all()
    entropy = -(np.exp(arrays.log_p) * arrays.log_p).sum()
    assert entropy == pytest.approx(record.entropy_nats, rel=1e-3)
    T = np.array(record.hypotheses[1].T_sensor_object)
    expected = localizer.scene.contact_shape(T, record.touch.press_depth_m)
    assert np.abs(touch.make_shape(1).depth_m - expected.depth_m).max() < 1e-6
    assert touch.shape.contact_iou(touch.make_shape(0), touch.geometry.observed_mask) > 0.5


def test_only_the_most_probable_poses_are_kept(box):
    T = make_transform(np.eye(3), np.arange(30)[:, None] * np.array([1e-3, 0, 0]))
    log_p = np.random.default_rng(0).normal(size=30)
    log_p[3] = -np.inf
    posterior = PosePosterior(PoseGrid(T, PoseMetric(box)), log_p)
    kept = find_most_probable(posterior, 10)
    assert kept.tolist() == np.argsort(-log_p)[:10].tolist()
    assert len(find_most_probable(posterior, 100)) == 29  # without the excluded one


def test_each_touch_shows_the_hypotheses_from_its_own_sensor(localizer):
    import dataclasses

    from tactile_loc.core.geometry.rigid import invert
    from tactile_loc.locate.localizer import localize_together

    touches = localizer.simulate(2, seed=4)
    contacts = [
        (localizer, dataclasses.replace(t, T_base_sensor=invert(np.asarray(t.T_sensor_object)))) for t in touches
    ]
    localization = localize_together(contacts)
    arrays = gather_arrays(localization.make_views(), localization)
    T = arrays.touches[1].T_sensor_first @ localization.best.T_sensor_object
    expected = localizer.scene.contact_shape(T, touches[1].press_depth_m)
    assert np.abs(arrays.touches[1].make_shape(0).depth_m - expected.depth_m).max() < 1e-6
    assert (arrays.touches[0].T_sensor_first == np.eye(4)).all()


def test_a_missing_file_gives_a_one_sentence_error(copy):
    (copy / "result.npz").unlink()
    with pytest.raises(ResultError, match=r"\A(?!.*damaged).*result\.npz"):
        read(copy)


@pytest.mark.parametrize("keep", [0, 10, 5000])
def test_a_truncated_file_gives_a_one_sentence_error(copy, keep):
    whole = (copy / "result.npz").read_bytes()
    (copy / "result.npz").write_bytes(whole[:keep])
    with pytest.raises(ResultError, match=naming("result.npz", "damaged")):
        read(copy)


def test_altered_bytes_give_a_one_sentence_error(copy):
    data = bytearray((copy / "result.npz").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 400] = bytes(400)
    (copy / "result.npz").write_bytes(data)
    with pytest.raises(ResultError, match=naming("result.npz", "damaged")):
        read(copy)


def resave(folder: Path, **changed: object) -> None:
    """Write the arrays again with changes; None omits an array."""
    with np.load(folder / "result.npz") as file:
        arrays = {name: file[name] for name in file.files} | changed
    np.savez(folder / "result.npz", **{name: value for name, value in arrays.items() if value is not None})


@pytest.mark.parametrize("version", [None, np.array(99), np.array("old")])
def test_another_version_of_the_arrays_gives_a_one_sentence_error(copy, version):
    resave(copy, schema_version=version)
    with pytest.raises(ResultError, match=naming("result.npz", f"version {version}", "version 1")):
        read(copy)


@pytest.mark.parametrize(
    "changed",
    [
        {"faces": None}, {"touch_0_geometry": None}, {"touch_0_geometry": np.array("{")}, {"log_p": np.zeros(3)},
        {"faces": np.array([[0, 1, 10**6]])}, {"touch_0_depth_m": np.zeros((3, 3), np.float32)},
        {"touch_0_made_m": np.zeros((0, 200, 200), np.float32)}, {"log_p": np.array(["a"])},
    ],
)  # fmt: skip
def test_inconsistent_arrays_give_a_one_sentence_error(copy, changed):
    resave(copy, **changed)
    with pytest.raises(ResultError, match=r"result\.npz.*(damaged|incomplete)"):
        read(copy)


def test_pickled_objects_are_not_read(copy):
    np.savez(copy / "result.npz", log_p=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ResultError, match=naming("result.npz", "damaged")):
        read(copy)


def test_two_files_of_different_results_are_refused(copy):
    document = json.loads((copy / "result.json").read_text())
    document["normalised_entropy"] += 0.01
    (copy / "result.json").write_text(json.dumps(document))
    with pytest.raises(ResultError, match=naming("result.npz", ".json")):
        read(copy)


def test_the_fingerprint_does_not_depend_on_the_layout_of_the_json(copy):
    record = read_record(copy / "result.json")
    (copy / "result.json").write_text(json.dumps(json.loads((copy / "result.json").read_text()), indent=4))
    assert hash_record(read_record(copy / "result.json")) == hash_record(record)


@pytest.mark.parametrize(("key", "value"), [("hypotheses", None), ("normalised_entropy", "much"), ("unknown", 1)])
def test_a_damaged_record_gives_a_one_sentence_error(copy, key, value):
    document = json.loads((copy / "result.json").read_text())
    document[key] = value
    (copy / "result.json").write_text(json.dumps(document))
    with pytest.raises(ResultError, match=naming("result.json", key)):
        read_record(copy / "result.json")


def test_a_record_of_another_version_gives_a_one_sentence_error(copy):
    (copy / "result.json").write_text('{"schema_version": 7}')
    with pytest.raises(ResultError, match=naming("result.json", "version 7")):
        read_record(copy / "result.json")


def test_a_record_of_the_previous_version_is_read_unless_it_has_a_set(copy):
    document = json.loads((copy / "result.json").read_text())
    old = {**document, "schema_version": SETS_OF_GRID_POSES}
    (copy / "result.json").write_text(json.dumps(old))
    assert read_record(copy / "result.json").hypotheses
    (copy / "result.json").write_text(json.dumps({**old, "pose_set": {"grid_poses": 3}}))
    with pytest.raises(ResultError, match=naming("result.json", f"version {SETS_OF_GRID_POSES}")):
        read_record(copy / "result.json")


@pytest.mark.parametrize(("text", "kind"), [("{", "JSON"), ("[1]", "list")])
def test_a_damaged_document_gives_a_one_sentence_error(tmp_path, text, kind):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ResultError, match=naming("result.json", kind)):
        read_document(tmp_path / "result.json")


@pytest.mark.parametrize("name", ["T_sensor_object", "log_p", "vertices_m", "touch_0_made_m", "touch_0_T_sensor_first"])
@pytest.mark.parametrize("damage", [lambda a: np.full_like(a, np.nan), lambda a: a[..., :-1], lambda a: a.astype(str)])
def test_arrays_of_wrong_shape_or_type_are_refused(run_folder, name, damage):
    with np.load(run_folder / "result.npz") as file:
        arrays = {key: file[key] for key in file.files}
    unpack_arrays(dict(arrays))
    with pytest.raises((ValueError, TactileLocError)):
        unpack_arrays({**arrays, name: damage(arrays[name])})


def test_a_surface_without_extent_is_refused(run_folder):
    with np.load(run_folder / "result.npz") as file:
        arrays = {key: file[key] for key in file.files}
    with pytest.raises(ObjectError, match="extent"):
        unpack_arrays({**arrays, "vertices_m": 0 * arrays["vertices_m"]})
