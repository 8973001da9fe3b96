"""The state behind the page: objects, presses, touches, results, and the independence of two visitors."""

import dataclasses
import json
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from tactile_loc import (
    DEMO_OBJECTS,
    Localization,
    NoContactError,
    PoseMetric,
    RunConfig,
    StageStore,
    TactileLocError,
    write_touch,
)
from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.images import encode_png
from tactile_loc.plugin import ConfigError, TouchError
from tactile_loc.plugin.helpers import make_translation
from test_uploads import pack

from tactile_loc_app.errors import AppError
from tactile_loc_app.export import _copy, _copy_object, _name_copies
from tactile_loc_app.session import Session, list_poses, place_at_edge
from tactile_loc_app.shared_localizers import SharedLocalizers

CONFIG = RunConfig.from_dict({"object": {"path": "pin"}, "sensor": "gelsight-mini"})
DEPTH_M = 8e-4
AT_CORNER = make_translation([0.014, 0.009, 0])  # of the block


@pytest.fixture(scope="module")
def localizers(tmp_path_factory) -> SharedLocalizers:
    return SharedLocalizers(tmp_path_factory.mktemp("uploads"), StageStore(tmp_path_factory.mktemp("store")))


@pytest.fixture
def session(localizers) -> Session:
    return Session(localizers, CONFIG)


@pytest.fixture(scope="module")
def located(localizers) -> Session:
    """A session with a result from two touches of the pin, the second on its side."""
    session = Session(localizers, CONFIG)
    session.press(session.T_base_sensor, DEPTH_M)
    session.add_touch()
    session.locate()
    session.press(session.suggest_next().approach.T_base_sensor, DEPTH_M)
    session.add_touch()
    session.locate()
    return session


def make_block() -> bytes:
    content: bytes = trimesh.creation.box((30, 20, 10)).export(file_type="stl")
    return content


def test_a_press_moves_the_finger_along_its_axis_to_the_object(session):
    high = session.T_base_sensor @ make_translation([0, 0, -0.03])
    press = session.press(high, DEPTH_M)
    assert press.touches
    moved = np.linalg.inv(high) @ press.T_base_sensor
    np.testing.assert_allclose(moved[:2, 3], 0, atol=1e-12)
    assert moved[2, 3] > 0.02
    assert press.shape.press_depth_m == DEPTH_M
    assert press.shape.depth_m.min() < 0.1 * DEPTH_M


def test_a_finger_beside_the_object_shows_no_contact_and_makes_no_touch(session):
    beside = make_translation([0.5, 0, 0]) @ session.T_base_sensor
    assert not session.press(beside, DEPTH_M).touches
    with pytest.raises(NoContactError):
        session.add_touch()
    assert session.touches == ()


def test_the_preview_and_the_touch_show_the_same_press(session):
    press = session.press(session.T_base_sensor, DEPTH_M)
    touch = session.add_touch()
    np.testing.assert_allclose(touch.T_base_sensor, press.T_base_sensor, atol=2e-5)
    np.testing.assert_allclose(touch.T_base_sensor @ touch.T_sensor_object, np.eye(4), atol=1e-9)
    few, many = (shape.contact.mean() for shape in (press.shape, touch.contact_shape))
    assert few == pytest.approx(many, rel=0.2)


def test_touches_are_located_in_the_objects_resting_frame(located):
    assert located.result is not None
    true = located.object.symmetry
    errors_m = located.result.measure_errors_m(located.object)
    assert errors_m is not None
    assert errors_m[0] < 1e-4
    best = list_poses(located.result)[0]
    np.testing.assert_allclose(best[:3, :3] @ true.centre_m + best[:3, 3], true.centre_m, atol=5e-4)
    assert [judged.touches for judged in located.history] == [1, 2]


def test_a_touch_is_removed_with_the_result_and_its_name_is_free_again(session, located):
    session.press(session.T_base_sensor, DEPTH_M)
    first, second, third = (session.add_touch() for _ in range(3))
    session.result, session.history = located.result, located.history
    session.remove_touch(1)
    assert session.touches == (first, third)
    assert (session.result, session.history) == (None, ())
    assert session.add_touch().name == second.name


def test_nothing_is_located_without_a_touch(session):
    with pytest.raises(TouchError):
        session.locate()
    with pytest.raises(AppError):
        session.suggest_next()


def test_a_better_touch_that_misses_the_object_is_not_suggested(located, monkeypatch):
    good = located.suggest_next()
    away = dataclasses.replace(good.approach, T_base_sensor=make_translation([1, 0, 0]) @ good.approach.T_base_sensor)
    ranked = dataclasses.replace(good, approach=away), good, dataclasses.replace(good)
    monkeypatch.setattr("tactile_loc_app.session.choose_next_touch", lambda *_: SimpleNamespace(ranked=ranked))
    assert located.suggest_next() is ranked[1]
    monkeypatch.setattr("tactile_loc_app.session.choose_next_touch", lambda *_: SimpleNamespace(ranked=ranked[:1]))
    assert located.suggest_next() is ranked[0]


def test_two_sessions_do_not_disturb_each_other_but_share_a_localizer(located, localizers):
    other = Session(localizers, CONFIG)
    assert other.localizer is located.localizer
    assert (other.touches, other.result, len(located.touches)) == ((), None, 2)
    other.load_object("head")
    assert (other.object.name, located.object.name) == ("head", "pin")
    assert other.inbox != located.inbox


def test_a_new_sensor_removes_the_touches(session):
    session.press(session.T_base_sensor, DEPTH_M)
    session.add_touch()
    session.choose_sensor("digit")
    assert session.touches == ()
    assert session.press_depth_m <= session.scene.geometry.max_depth_m


@pytest.mark.parametrize("name", DEMO_OBJECTS)
def test_the_first_finger_touches_more_than_a_flat_face(localizers, name):
    session = Session(localizers, RunConfig.from_dict({"object": {"path": name}, "sensor": "gelsight-mini"}))
    try:
        session.add_touch()  # raises for a flat face, and where nothing touches
        assert 1e-3 * session.touches[0].press_depth_m < np.ptp(session.touches[0].contact_shape.depth_m)
    finally:
        session.close()


def test_an_uploaded_mesh_is_read_in_its_unit_and_again_in_another(session):
    assert not session.choose_units("m"), "a demo object has its own unit"
    with pytest.raises(ObjectError):
        session.upload_object("part.stl", b"this is no mesh")
    assert session.object.name == "pin"
    session.upload_object("block.stl", make_block(), "mm")
    np.testing.assert_allclose(session.object.mesh.extents_m, [0.03, 0.02, 0.01], atol=1e-9)
    assert session.press(place_at_edge(session.object, session.scene), DEPTH_M).touches
    session.press(AT_CORNER @ session.T_base_sensor, DEPTH_M)
    session.add_touch()
    assert not session.choose_units("mm")
    assert len(session.touches) == 1
    assert session.choose_units("inch")
    np.testing.assert_allclose(session.object.mesh.extents_m, 25.4 * np.array([0.03, 0.02, 0.01]), rtol=1e-6)
    assert session.touches == ()


def test_an_upload_that_fails_is_read_again_with_the_right_setting(session):
    metres = trimesh.creation.box((0.03, 0.02, 0.01)).export(file_type="stl")
    with pytest.raises(ObjectError):
        session.upload_object("block.stl", metres, "mm")
    assert session.object.name == "pin"
    assert session.choose_units("m")
    np.testing.assert_allclose(session.object.mesh.extents_m, [0.03, 0.02, 0.01], rtol=1e-6)
    session.load_object("pin")
    assert not session.choose_units("cm"), "the own mesh is not the object any more"
    with pytest.raises(TouchError):
        session.read_touch_file("a.npy", save_depths(session))
    assert session.touches == ()
    assert session.read_touches_again("mm", "distance") == session.touches
    session.choose_sensor(session.localizer.config.sensor.name)
    assert session.touches == ()
    assert len(session.read_touches_again("mm", "distance")) == 1


def test_an_uploaded_touch_is_added_with_its_pose(session, tmp_path):
    session.press(session.T_base_sensor, DEPTH_M)
    touch = session.add_touch()
    content = write_touch(tmp_path / "touch.npz", touch).read_bytes()
    (read,) = session.read_touch_file("mine.npz", content)
    assert (read.name, len(session.touches)) == ("mine.npz", 2)
    np.testing.assert_allclose(read.T_base_sensor, touch.T_base_sensor)


def save_depths(session) -> bytes:
    """Write a contact shape, in mm, and return the content of its file."""
    depth = np.full(session.scene.geometry.shape, 0.8, np.float32)
    depth[50:90, 60:120] = 0.1
    np.save(session.inbox / "saved.npy", depth)
    return (session.inbox / "saved.npy").read_bytes()


LISTED = '[[touch]]\npath = "parts/a.npy"\nunit = "mm"\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 0]\n'


def test_a_list_places_the_touches_uploaded_before_or_those_of_its_archive(session):
    session.read_touch_file("a.npy", save_depths(session), "mm", "distance")
    (read,) = session.read_touch_file("touches.toml", LISTED.replace("parts/", "").encode())
    assert session.touches == (read,)
    np.testing.assert_allclose(read.T_base_sensor[:3, 3], [1e-3, 2e-3, 3e-3])
    session.remove_touch(0)
    content = pack({"mine/touches.toml": LISTED.encode(), "mine/parts/a.npy": save_depths(session)})
    (read,) = session.read_touch_file("mine.zip", content)
    assert session.touches == (read,)
    np.testing.assert_allclose(read.T_base_sensor[:3, 3], [1e-3, 2e-3, 3e-3])
    assert session.read_touch_file("again.zip", content)
    assert len(session.touches) == 1


@pytest.mark.parametrize("entry", ['path = "/etc/hostname"', 'path = "../a.npy"', 'path = "a.npy"\nsensor = "x/y"'])
def test_a_list_names_only_uploaded_files(session, entry):
    with pytest.raises(ConfigError):
        session.read_touch_file("touches.toml", f"[[touch]]\n{entry}\n".encode())


@pytest.mark.parametrize(
    ("files", "error"),
    [
        ({"a.npy": b""}, AppError),
        ({"touches.toml": LISTED.encode(), "b/touches.toml": LISTED.encode()}, AppError),
        ({"touches.toml": LISTED.encode()}, TouchError),
        ({"touches.toml": b"no list"}, ConfigError),
        ({"touches.toml": b'[[touch]]\npath = "../../a.npy"\n'}, ConfigError),
    ],
)
def test_an_archive_without_a_usable_list_is_refused(session, files, error):
    session.press(session.T_base_sensor, DEPTH_M)
    session.add_touch()
    with pytest.raises(error):
        session.read_touch_file("mine.zip", pack(files))
    assert len(session.touches) == 1


def test_a_frame_of_a_camera_becomes_a_touch(session, tmp_path):
    session.press(session.T_base_sensor, DEPTH_M)
    write_touch(tmp_path / "frame-1.npz", session.add_touch())
    touch = session.take_camera_touch(str(tmp_path))
    assert (touch.name, len(session.touches)) == ("frame-1.npz", 2)


def test_a_camera_needs_a_calibrated_sensor(session, tmp_path):
    (tmp_path / "photo.png").write_bytes(encode_png(np.full((60, 80, 3), 90, np.uint8)))
    with pytest.raises(TouchError):
        session.take_camera_touch(str(tmp_path))
    with pytest.raises(TactileLocError):
        session.take_camera_touch(str(tmp_path / "missing"))
    assert session.touches == ()


def test_a_closed_session_leaves_no_files_and_no_localizer(localizers):
    before = set(localizers.folder.iterdir())
    own = Session(localizers, CONFIG)
    own.upload_object("block.stl", make_block(), "mm")
    mesh = own.localizer.config.object.path
    assert mesh.startswith(str(own.folder))
    own.close()
    assert set(localizers.folder.iterdir()) == before
    assert all(known.config.object.path != mesh for known in localizers._known.values())


def test_a_prior_needs_the_pose_of_the_sensor(session):
    session.read_touch_file("a.npy", save_depths(session), "mm", "distance")
    session.set_prior(np.eye(4), 0.005, 0.2)
    with pytest.raises(TouchError):
        session.locate()
    with pytest.raises(ConfigError):
        session.set_prior(np.eye(4), 0.0, 0.2)


def test_a_prior_moves_the_probability_to_the_poses_near_it(located, localizers):
    session = Session(localizers, CONFIG)
    session.touches = located.touches[:1]
    far_m = 1e3  # standard deviation that says nothing
    session.set_prior(np.eye(4), far_m, far_m)
    pose = list_poses(session.locate())[1]
    session.set_prior(pose, 5e-4, 0.05)
    best = list_poses(session.locate())[0]
    assert PoseMetric(session.object).symmetric_distance(best[None], pose[None])[0] < 1e-3


def test_the_exported_script_computes_the_same_result(located, localizers, tmp_path, monkeypatch, capsys):
    located.set_prior(np.eye(4), 5e-3, 0.2)
    found = located.locate()
    written = {path.name for path in located.export(tmp_path)}
    located.set_prior(None, 1, 1)
    assert {"result.json", "result.npz", "report.html", "locate.py", "touch-1.npz", "touch-2.npz"} <= written
    monkeypatch.setenv("TACTILE_LOC_STORE", str(localizers.store.root))
    runpy.run_path(str(tmp_path / "locate.py"))
    assert capsys.readouterr().out.strip() == found.summary()
    first, again = (json.loads((tmp_path / part).read_text()) for part in ("result.json", "again/result.json"))
    assert (again["verdict"], again["hypotheses"]) == (first["verdict"], first["hypotheses"])


@pytest.mark.slow
def test_exported_files_of_an_uploaded_mesh_name_no_folder_of_the_server(session, tmp_path, store):
    session.upload_object("block.stl", make_block(), "mm")
    session.press(AT_CORNER @ session.T_base_sensor, DEPTH_M)
    session.add_touch()
    found = session.locate()
    session.export(tmp_path)
    assert json.loads((tmp_path / "result.json").read_text())["configuration"]["object"]["path"] == "object/block.stl"
    for path in filter(Path.is_file, tmp_path.rglob("*")):
        assert str(session.folder).encode() not in path.read_bytes(), path
    assert Localization.load(tmp_path).summary() == found.summary()


@pytest.mark.parametrize("name", ["block.stl", "it's {name!r} of \"\\n.stl", "locate.py.stl"])
def test_the_script_of_an_uploaded_mesh_holds_its_copy(session, tmp_path, name):
    session.upload_object(name, make_block(), "mm")
    copy = eval(_copy_object(tmp_path, session.localizer.config.object.path), {"HERE": tmp_path})
    assert copy.read_bytes() == make_block()
    assert _name_copies(session.localizer.config).object.path == str(copy.relative_to(tmp_path))


@pytest.mark.parametrize("name", ["locate.py", "result.json", "pin.toml"])
def test_the_copy_of_a_sensor_replaces_no_other_file(session, tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "inner").write_text("sensor")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("kept")
    copy = eval(_copy(tmp_path / "out", "sensor", str(folder)), {"HERE": tmp_path / "out"})
    assert (copy / "inner").read_text() == "sensor"
    assert (tmp_path / "out" / name).read_text() == "kept"
