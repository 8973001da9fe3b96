"""Touches with known poses: CSV tables, the poses of `simulate`, lists, and errors that name file and row."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.labelled_touches import read_labelled_touches
from tactile_loc.io.touches import write_touch

T = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.001, -0.002, 0.025])
BASE = make_transform(rotation_about([0, 1, 0], 0.4), [0.3, 0.1, 0.2])
HALF = float(np.sqrt(0.5))
QUATERNION = f"1,-2,25,{HALF},0,0,{HALF}"
HEADER = "touch,x_mm,y_mm,z_mm,qw,qx,qy,qz"


@pytest.fixture
def folder(tmp_path, flat_camera) -> Path:
    """a.npz has no pose, b.npz has the true pose and the sensor's pose."""
    depth = np.full(flat_camera.shape, 0.002, np.float32)
    depth[10:20, 20:30] = 0.001
    for name, true, base in (("a", None, None), ("b", T, BASE)):
        touch = Touch(ContactShape(depth, 0.002), flat_camera, T_base_sensor=base, T_sensor_object=true)
        write_touch(tmp_path / f"{name}.npz", touch)
    return tmp_path


def write(folder: Path, *rows: str) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_table_with_quaternions_gives_poses_in_metres(folder):
    ((one,), (two,)) = read_labelled_touches(write(folder, HEADER, f"a.npz,{QUATERNION}", f"b.npz,{QUATERNION}"))
    assert (one.listed.path, two.listed.path) == (folder / "a.npz", folder / "b.npz")
    np.testing.assert_allclose([one.T_sensor_object, two.T_sensor_object], [T, T], atol=1e-12)


def test_the_table_that_run_writes_is_read(folder):
    path = write(
        folder,
        "touch,verdict,probability,x_mm,y_mm,z_mm,turn_deg,axis_x,axis_y,axis_z,says",
        "a.npz,certain,0.9000,1.000,-2.000,25.000,90.00,0.0000,0.0000,1.0000,",
    )
    ((one,),) = read_labelled_touches(path)
    np.testing.assert_allclose(one.T_sensor_object, T, atol=1e-12)


def test_rows_with_the_same_example_belong_together(folder):
    rows = [f"{name}.npz,{QUATERNION},{example}" for name, example in (("a", "x"), ("b", "y"), ("b", "x"), ("a", ""))]
    read = read_labelled_touches(write(folder, f"{HEADER},example", *rows))
    assert [[one.listed.path.stem for one in example] for example in read] == [["a", "b"], ["b"], ["a"]]


def test_the_folder_and_the_poses_of_simulate_are_read(folder):
    (folder / "poses.json").write_text(json.dumps({"T_sensor_object": {"a": T.tolist(), "b": T.tolist()}}))
    for path in (folder, folder / "poses.json"):
        read = read_labelled_touches(path)
        assert [example[0].listed.path.name for example in read] == ["a.npz", "b.npz"]
        np.testing.assert_array_equal(read[0][0].T_sensor_object, T)


def test_a_list_is_one_example_and_poses_are_stated_or_follow_from_the_sensors_poses(folder):
    moved = BASE @ make_transform(np.eye(3), [0.01, 0, 0])
    path = folder / "touches.toml"
    first, second = '[[touch]]\npath = "b.npz"\n', '[[touch]]\npath = "a.npz"\n'  # b.npz has both poses
    path.write_text(f"{first}{second}T_base_sensor = {moved.tolist()}\n")
    ((b, a),) = read_labelled_touches(path)
    np.testing.assert_array_equal(b.T_sensor_object, T)
    np.testing.assert_allclose(a.T_sensor_object, invert(moved) @ BASE @ T, atol=1e-12)
    path.write_text(f"{second}T_sensor_object = {T.tolist()}\n")
    ((stated,),) = read_labelled_touches(path)
    np.testing.assert_array_equal(stated.T_sensor_object, T)
    path.write_text(second)
    with pytest.raises(TouchError, match=naming("touch 1", "T_sensor_object")):
        read_labelled_touches(path)


def test_in_a_folder_a_list_comes_before_the_poses_of_simulate(folder):
    (folder / "poses.json").write_text(json.dumps({"T_sensor_object": {"a": T.tolist(), "b": T.tolist()}}))
    rows = [f'[[touch]]\npath = "{name}.npz"\nT_base_sensor = {BASE.tolist()}\n' for name in "ab"]
    (folder / "touches.toml").write_text("".join(rows))
    assert [len(example) for example in read_labelled_touches(folder)] == [2]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], ("poses.csv",)),
        ([HEADER], ("poses.csv",)),
        (["file,x_mm,y_mm,z_mm,qw,qx,qy,qz", f"a.npz,{QUATERNION}"], ("touch",)),
        (["touch,x_m,y_mm,z_mm,qw,qx,qy,qz", f"a.npz,{QUATERNION}"], ("x_mm",)),
        (["touch,x_mm,y_mm,z_mm", "a.npz,1,2,3"], ("qw", "turn_deg")),
        (["touch,x_mm,y_mm,z_mm,qw,qx,qy", "a.npz,1,2,3,1,0,0"], ("qz",)),
        ([HEADER, f"a.npz,{QUATERNION}", f"none.npz,{QUATERNION}"], ("row 2", "none.npz")),
        ([HEADER, f",{QUATERNION}"], ("row 1", "touch")),
        ([HEADER, "a.npz,1,-2,,1,0,0,0"], ("row 1", "z_mm")),
        ([HEADER, "a.npz,1,-2,nan,1,0,0,0"], ("row 1", "z_mm")),
        ([HEADER, "a.npz,1,-2"], ("row 1", "z_mm")),
        ([HEADER, "a.npz,1,-2,25,1,1,0,0"], ("row 1", "length")),
    ],
)
def test_errors_name_the_table_and_the_row(folder, rows, words):
    with pytest.raises(TouchError, match=naming(*words)):
        read_labelled_touches(write(folder, *rows))


def test_missing_files_other_kinds_of_files_and_damaged_poses_are_refused(folder):
    for path in (folder / "none.csv", folder / "a.npz", folder):
        with pytest.raises(TouchError, match=naming(path.name)):
            read_labelled_touches(path)
    poses = [{"a": [[1]]}, {"gone": T.tolist()}]
    for text in ("{", "[]", "{}", *(json.dumps({"T_sensor_object": one}) for one in poses)):
        (folder / "poses.json").write_text(text)
        with pytest.raises(TouchError, match=naming("poses.json")):
            read_labelled_touches(folder)


def test_a_list_whose_object_is_not_at_rest_is_refused(folder):
    path = folder / "touches.toml"
    shifted = make_transform(np.eye(3), [0.05, 0, 0]) @ BASE
    second = f'[[touch]]\npath = "a.npz"\nT_base_sensor = {shifted.tolist()}\nT_sensor_object = {T.tolist()}\n'
    path.write_text(f'[[touch]]\npath = "b.npz"\n{second}')
    with pytest.raises(TouchError, match=naming("50.0 mm")):
        read_labelled_touches(path)
