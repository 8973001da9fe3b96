"""The arrays of a result: they are read as written, and a damaged file gives an error of one sentence."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import ContactShape, Localization, PoseGrid, PoseMetric, PosePosterior, SensorGeometry, Touch
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.io.config import TouchConfig
from tactile_loc.locate.result.result_arrays import find_most_probable, pack_arrays, unpack_posterior, unpack_touches
from tactile_loc.locate.result.result_json import write_touch
from tactile_loc.plugin.helpers import make_transform


@pytest.fixture
def copy(run_folder: Path, tmp_path: Path) -> Path:
    """A result that a test may change."""
    return shutil.copytree(run_folder, tmp_path / "copy")


def resave(folder: Path, **changed: object) -> None:
    """Write the arrays again with changes; None omits an array."""
    with np.load(folder / "result.npz") as file:
        arrays = {name: file[name] for name in file.files} | changed
    np.savez(folder / "result.npz", **{name: value for name, value in arrays.items() if value is not None})


def test_packed_arrays_are_read_back(box):
    rng = np.random.default_rng(0)
    rectangle_m, observed = (-0.003, 0.003, -0.002, 0.002), rng.random((6, 8)) > 0.2
    geometry = SensorGeometry("orthographic", 8, 6, 1000.0, 900.0, 4.2, 3.1, 0.01, 0.002, rectangle_m, observed)
    depth = rng.uniform(0, 0.0016, (6, 8)).astype(np.float32).clip(0, 0.0015)
    image = rng.integers(0, 255, (6, 8, 3), np.uint8)
    touch = Touch(ContactShape(depth, 0.0015, 0.0018, 1e-4), geometry, "a", image=image)
    mask = Touch.from_mask(depth < 0.001, sensor=geometry, name="b")
    T = make_transform(np.eye(3), [[0.1, 0.2, 0.3], [0.1, 0.2, 0.4]])
    arrays = pack_arrays(PosePosterior(PoseGrid(T, PoseMetric(box)), np.log([0.25, 0.75])), (touch, mask))
    posterior = unpack_posterior(arrays, box, 1, 0.0)
    assert posterior.grid.T_sensor_object == pytest.approx(T[::-1], rel=1e-6)
    assert posterior.probabilities == pytest.approx([0.75, 0.25], rel=1e-6)
    documents = [write_touch(one, TouchConfig()) for one in (touch, mask)]
    for found, given in zip(unpack_touches(arrays, "touch", documents), (touch, mask), strict=True):
        assert found.geometry.describe() == given.geometry.describe()
        assert (found.geometry.observed_mask == given.geometry.observed_mask).all()
        assert (found.contact_shape.depth_m == given.contact_shape.depth_m).all()
        for name in ("name", "press_depth_m", "indentation_m", "has_depths"):
            assert getattr(found, name) == getattr(given, name)
        assert found.contact_shape.indentation_std_m == given.contact_shape.indentation_std_m
        assert (found.image is None) if given.image is None else (found.image == given.image).all()


def test_only_the_most_probable_poses_are_kept(box):
    T = make_transform(np.eye(3), np.arange(30)[:, None] * np.array([1e-3, 0, 0]))
    log_p = np.random.default_rng(0).normal(size=30)
    log_p[3] = -np.inf
    posterior = PosePosterior(PoseGrid(T, PoseMetric(box)), log_p)
    kept = find_most_probable(posterior, 10)
    assert kept.tolist() == np.argsort(-log_p)[:10].tolist()
    assert len(find_most_probable(posterior, 100)) == 29  # without the excluded one


def alter(whole: bytes) -> bytes:
    middle = len(whole) // 2
    return whole[:middle] + bytes(400) + whole[middle + 400 :]


def pickle(whole: bytes) -> bytes:
    """Return another archive, whose array is a pickled object."""
    np.savez(file := io.BytesIO(), log_p=np.array([{"a": 1}], dtype=object))
    return file.getvalue()


@pytest.mark.parametrize("damage", [*(lambda whole, keep=keep: whole[:keep] for keep in (0, 10, 5000)), alter, pickle])
def test_a_truncated_altered_or_pickled_file_gives_a_one_sentence_error(copy, damage):
    (copy / "result.npz").write_bytes(damage((copy / "result.npz").read_bytes()))
    with pytest.raises(ResultError, match=naming("result.npz", "damaged")):
        Localization.load(copy)


@pytest.mark.parametrize("version", [None, np.array(99), np.array("old")])
def test_another_version_of_the_arrays_gives_a_one_sentence_error(copy, version):
    resave(copy, schema_version=version)
    with pytest.raises(ResultError, match=naming("result.npz", f"version {version}", "version 5")):
        Localization.load(copy)


def test_two_files_of_different_results_are_refused(copy):
    text = (copy / "result.json").read_text()
    document = json.loads(text)
    (copy / "result.json").write_text(json.dumps(document, indent=4))
    Localization.load(copy)  # the layout of the text does not matter
    document["normalised_entropy"] += 0.01
    (copy / "result.json").write_text(json.dumps(document))
    with pytest.raises(ResultError, match=naming("result.npz", ".json")):
        Localization.load(copy)


WRONG = (lambda a: np.full_like(a, np.nan), lambda a: a[..., :-1], lambda a: a.astype(str))


@pytest.mark.parametrize(
    "changed",
    [
        {"faces": None},
        {"touch_0_geometry": None},
        {"touch_0_geometry": np.array("{")},
        {"log_p": np.zeros(3)},
        {"faces": np.array([[0, 1, 10**6]])},
        {"touch_0_depth_m": np.zeros((3, 3), np.float32)},
        {"touch_0_image": np.zeros((3, 3), np.uint8)},
        *({name: damage} for name in ("T_sensor_object", "log_p", "vertices_m") for damage in WRONG),
        {"vertices_m": lambda a: 0 * a},  # a surface without extent
    ],
)
def test_inconsistent_arrays_give_a_one_sentence_error(copy, changed):
    with np.load(copy / "result.npz") as file:
        changed = {name: value(file[name]) if callable(value) else value for name, value in changed.items()}
    resave(copy, **changed)
    with pytest.raises(ResultError, match=r"result\.json.*damaged"):
        Localization.load(copy)
