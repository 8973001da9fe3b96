"""Touches listed in a file: files and sensors in its folder, poses in metres, and errors that name touch and row."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import ContactShape, Touch, write_touch
from tactile_loc.io.touch_lists import read_labelled_touches, read_touch_list
from tactile_loc.plugin import ConfigError, TouchError
from tactile_loc.plugin.helpers import invert, make_transform, rotation_about

POSE = "xyz_mm = [100, -20, 300]\nrpy_deg = [0, 0, 90]\n"
T = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.1, -0.02, 0.3])
TRUE = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.001, -0.002, 0.025])
HALF = math.sqrt(0.5)
QUATERNION = f"1,-2,25,{HALF},0,0,{HALF}"
HEADER = "touch,x_mm,y_mm,z_mm,qw,qx,qy,qz"


@pytest.fixture
def folder(tmp_path, flat_camera) -> Path:
    """a.npz has no pose, b.npz has the sensor's pose and the true pose; c.png is empty."""
    depth = np.full(flat_camera.shape, 0.002, np.float32)
    depth[10:20, 20:30] = 0.001
    for name, pose, true in (("a", None, None), ("b", T, TRUE)):
        touch = Touch(ContactShape(depth, 0.002), flat_camera, T_base_sensor=pose, T_sensor_object=true)
        write_touch(tmp_path / f"{name}.npz", touch)
    (tmp_path / "c.png").touch()
    return tmp_path


def written(folder: Path, *tables: str) -> Path:
    path = folder / "touches.toml"
    path.write_text("\n".join(f"[[touch]]\n{table}" for table in tables))
    return path


def test_every_key_of_a_list_is_read(folder):
    (folder / "gel.toml").touch()
    every = 'path = "a.npz"\nsensor = "gel.toml"\nunit = "mm"\nkind = "height"\npress_depth_mm = 1.5\n' + POSE
    few = f'path = "c.png"\nsensor = "digit"\nT_base_sensor = {T.tolist()}\n'
    first, second = read_touch_list(written(folder, every, few))
    assert (first.path, first.sensor) == (folder / "a.npz", str(folder / "gel.toml"))
    assert (first.unit, first.kind) == ("mm", "height")
    assert (second.path, second.sensor, second.unit, second.kind) == (folder / "c.png", "digit", None, None)
    assert (first.press_depth_m, second.press_depth_m) == (pytest.approx(0.0015), None)
    np.testing.assert_allclose([first.T_base_sensor, second.T_base_sensor], [T, T], atol=1e-15)


@pytest.mark.parametrize(
    "pose",
    [
        "xyz_m = [400.0, 10.0, 90.0]\nrpy_deg = [0, 0, 90]\n",
        "T_base_sensor = [[1, 0, 0, 400.0], [0, 1, 0, 10.0], [0, 0, 1, 90.0], [0, 0, 0, 1]]\n",
    ],
)
def test_a_sensor_that_stands_hundreds_of_metres_away_has_another_unit(folder, pose):
    with pytest.raises(TouchError, match=naming("touch 1", "410 m", "unit")):
        read_touch_list(written(folder, 'path = "a.npz"\n' + pose))


def test_known_poses_hundreds_of_metres_away_have_another_unit(folder):
    rows = "touch,x_mm,y_mm,z_mm,qw,qx,qy,qz\na.npz,4e5,0,0,1,0,0,0\n"
    (folder / "poses.csv").write_text(rows)
    with pytest.raises(TouchError, match=naming("row 1", "400 m", "unit")):
        read_labelled_touches(folder / "poses.csv")
    far = np.diag([1.0, 1, 1, 1])
    far[0, 3] = 400.0
    (folder / "poses.json").write_text(json.dumps({"T_sensor_object": {"a": far.tolist()}}))
    with pytest.raises(TouchError, match=naming("poses.json", "400 m", "unit")):
        read_labelled_touches(folder / "poses.json")


def test_a_touch_takes_metres_and_a_quaternion_as_results_give_them(folder):
    pose = f"xyz_m = [0.1, -0.02, 0.3]\nquaternion_xyzw = [0, 0, {HALF}, {HALF}]\n"
    (touch,) = read_touch_list(written(folder, 'path = "a.npz"\n' + pose))
    np.testing.assert_allclose(touch.T_base_sensor, T, atol=1e-12)
    (single,) = read_touch_list(written(folder, 'path = "a.npz"\n'))
    assert single.T_base_sensor is None


@pytest.mark.parametrize(
    "pose",
    [POSE, POSE.replace("xyz_mm = [100, -20, 300]", "xyz_m = [0.1, -0.02, 0.3]"), f"T_base_sensor = {T.tolist()}\n"],
)
def test_a_touch_with_a_mount_takes_no_second_pose(folder, pose):
    (folder / "mount.toml").write_text(f"T_flange_sensor = {T.tolist()}\n")
    table = f'path = "a.npz"\nmount = "mount.toml"\nT_base_flange = {T.tolist()}\n'
    with pytest.raises(TouchError, match=naming("touch 1", "given twice", "T_base_flange")):
        read_touch_list(written(folder, table + pose))


def test_a_pose_in_the_list_overrides_the_pose_in_the_touch_file(folder):
    other = "xyz_mm = [0, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]\n"
    own, listed = read_touch_list(written(folder, 'path = "b.npz"\n', 'path = "b.npz"\n' + other))
    np.testing.assert_allclose(own.T_base_sensor, T)
    np.testing.assert_array_equal(listed.T_base_sensor, np.eye(4))


def test_the_sensors_pose_follows_from_the_flanges_pose_and_the_mount(folder):
    (folder / "mount.toml").write_text(f"T_flange_sensor = {T.tolist()}\n")
    (folder / "other.toml").write_text("xyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 0]\n")
    flange = f"T_base_flange = {T.tolist()}\n"
    path = written(folder, 'path = "a.npz"\n' + flange, 'path = "b.npz"\nmount = "other.toml"\n' + flange)
    path.write_text('mount = "mount.toml"\n' + path.read_text())
    first, second = read_touch_list(path)
    np.testing.assert_allclose(first.T_base_sensor, T @ T, atol=1e-15)
    np.testing.assert_allclose(second.T_base_sensor[:3, 3], T[:3, 3] + [-2e-3, 1e-3, 3e-3], atol=1e-15)
    assert first.mount is not None
    (folder / "mount.toml").unlink()
    of_flange = read_touch_list(path, of_flange=True)
    np.testing.assert_array_equal([touch.T_base_flange for touch in of_flange], [T, T])
    (folder / "lacks.toml").write_text('[[touch]]\npath = "a.npz"\n')
    with pytest.raises(TouchError, match=naming("touch 1", "T_base_flange")):
        read_touch_list(folder / "lacks.toml", of_flange=True)
    with pytest.raises(ConfigError, match=naming(path.name, "mount.toml")):
        read_touch_list(path)


def test_a_folder_of_touches_may_have_the_name_of_its_sensor(folder):
    (folder / "digit").mkdir()
    (folder / "mine").mkdir()
    (folder / "mine" / "calibration.json").touch()
    for name, sensor in (("digit", "digit"), ("mine", str(folder / "mine")), ("./digit", str(folder / "digit"))):
        (touch,) = read_touch_list(written(folder, f'path = "a.npz"\nsensor = "{name}"\n'))
        assert touch.sensor == sensor


@pytest.mark.parametrize(
    ("tables", "values"),
    [
        (['path = "a.npz"\n' + POSE, 'path = "a.npz"\n'], ("touch 2", "T_base_sensor", "xyz_mm")),
        (['path = "z.npz"\n'], ("touch 1", "z.npz")),
        (['path = "b.npz"\n', 'path = "bad.npz"\n'], ("touch 2", "bad.npz")),
        (["unit = 'mm'\n"], ("touch 1", "path")),
        (['path = "a.npz"\nunits = "mm"\n'], ("touch 1", "'units'", "'unit'")),
        (['path = "a.npz"\nkind = "depth"\n'], ("kind", "'depth'", "'distance'", "'indentation'", "'height'")),
        (['path = "a.npz"\nunit = "cm"\n'], ("unit", "'cm'", "'m'", "'mm'", "'um'")),
        (['path = "a.npz"\npress_depth_mm = -1\n'], ("press_depth_mm", -1)),
        (['path = "a.npz"\nsensor = "no.toml"\n'], ("sensor", "no.toml")),
        (['path = "a.npz"\nxyz_mm = [0, 0, 0]\n'], ("T_base_sensor", "xyz_mm", "rpy_deg")),
        (['path = "a.npz"\nxyz_mm = [0, nan, 0]\n'], ("xyz_mm", "[0, nan, 0]")),
        (['path = "a.npz"\nT_base_sensor = [[1, 0], [0, 1]]\n'], ("T_base_sensor", "[[1, 0], [0, 1]]")),
        ([f'path = "a.npz"\nT_base_sensor = {(2 * np.eye(4)).tolist()}\n'], ("T_base_sensor", "rigid")),
        ([f'path = "a.npz"\nT_base_flange = {(2 * np.eye(4)).tolist()}\n'], ("T_base_flange", "rigid")),
        ([f'path = "a.npz"\nT_base_flange = {T.tolist()}\n'], ("T_base_flange", "mount.toml")),
        (['path = "a.npz"\nmount = "mount.toml"\n'], ("mount", "T_base_flange")),
        ([f'path = "a.npz"\nmount = "no.toml"\nT_base_flange = {T.tolist()}\n'], ("no.toml",)),
    ],
)
def test_a_wrong_table_is_refused_with_its_list_and_number(folder, tables, values):
    (folder / "bad.npz").write_bytes(b"PK\x03\x04 nonsense")
    path = written(folder, *tables)
    with pytest.raises(TouchError, match=naming(*values)) as caught:
        read_touch_list(path)
    assert str(caught.value).startswith(f"{path}, touch ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("", ("[[touch]]",)),
        ("touch = 3", ("[[touch]]",)),
        ('[touch]\npath = "a.npz"', ("[[touch]]",)),
        ('[[touches]]\npath = "a.npz"', ("'touches'", "'touch'")),
        ("[[touch", ("TOML",)),
        ('mount = 3\n[[touch]]\npath = "a.npz"', ("mount", 3)),
    ],
)
def test_a_file_that_is_not_a_list_is_refused(folder, text, values):
    path = folder / "touches.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=naming("touches.toml", *values)):
        read_touch_list(path)
    with pytest.raises(ConfigError, match=naming(folder / "none.toml")):
        read_touch_list(folder / "none.toml")


def write_csv(folder: Path, *rows: str) -> Path:
    path = folder / "poses.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_table_with_quaternions_gives_poses_in_metres(folder):
    ((one,), (two,)) = read_labelled_touches(write_csv(folder, HEADER, f"a.npz,{QUATERNION}", f"b.npz,{QUATERNION}"))
    assert (one.path, two.path) == (folder / "a.npz", folder / "b.npz")
    np.testing.assert_allclose([one.T_sensor_object, two.T_sensor_object], [TRUE, TRUE], atol=1e-12)


def test_the_table_that_run_writes_is_read(folder):
    path = write_csv(
        folder,
        "touch,verdict,probability,x_mm,y_mm,z_mm,turn_deg,axis_x,axis_y,axis_z,says",
        "a.npz,certain,0.9000,1.000,-2.000,25.000,90.00,0.0000,0.0000,1.0000,",
    )
    ((one,),) = read_labelled_touches(path)
    np.testing.assert_allclose(one.T_sensor_object, TRUE, atol=1e-12)


def test_rows_with_the_same_example_belong_together(folder):
    rows = [f"{name}.npz,{QUATERNION},{example}" for name, example in (("a", "x"), ("b", "y"), ("b", "x"), ("a", ""))]
    read = read_labelled_touches(write_csv(folder, f"{HEADER},example", *rows))
    assert [[one.path.stem for one in example] for example in read] == [["a", "b"], ["b"], ["a"]]


def test_the_folder_and_the_poses_of_simulate_are_read(folder):
    (folder / "poses.json").write_text(json.dumps({"T_sensor_object": {"a": TRUE.tolist(), "b": TRUE.tolist()}}))
    for path in (folder, folder / "poses.json"):
        read = read_labelled_touches(path)
        assert [example[0].path.name for example in read] == ["a.npz", "b.npz"]
        np.testing.assert_array_equal(read[0][0].T_sensor_object, TRUE)


def test_a_list_is_one_example_and_poses_are_stated_or_follow_from_the_sensors_poses(folder):
    moved = T @ make_transform(np.eye(3), [0.01, 0, 0])
    path = folder / "touches.toml"
    first, second = '[[touch]]\npath = "b.npz"\n', '[[touch]]\npath = "a.npz"\n'  # b.npz has both poses
    path.write_text(f"{first}{second}T_base_sensor = {moved.tolist()}\n")
    ((b, a),) = read_labelled_touches(path)
    np.testing.assert_array_equal(b.T_sensor_object, TRUE)
    np.testing.assert_allclose(a.T_sensor_object, invert(moved) @ T @ TRUE, atol=1e-12)
    path.write_text(f"{second}T_sensor_object = {TRUE.tolist()}\n")
    ((stated,),) = read_labelled_touches(path)
    np.testing.assert_array_equal(stated.T_sensor_object, TRUE)
    path.write_text(second)
    with pytest.raises(TouchError, match=naming("touch 1", "T_sensor_object")):
        read_labelled_touches(path)


def test_in_a_folder_a_list_comes_before_the_poses_of_simulate(folder):
    (folder / "poses.json").write_text(json.dumps({"T_sensor_object": {"a": TRUE.tolist(), "b": TRUE.tolist()}}))
    rows = [f'[[touch]]\npath = "{name}.npz"\nT_base_sensor = {T.tolist()}\n' for name in "ab"]
    (folder / "touches.toml").write_text("".join(rows))
    assert [len(example) for example in read_labelled_touches(folder)] == [2]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], ("poses.csv",)),
        (["file,x_mm,y_mm,z_mm,qw,qx,qy,qz", f"a.npz,{QUATERNION}"], ("touch",)),
        (["touch,x_m,y_mm,z_mm,qw,qx,qy,qz", f"a.npz,{QUATERNION}"], ("x_mm",)),
        (["touch,x_mm,y_mm,z_mm", "a.npz,1,2,3"], ("qw", "turn_deg")),
        (["touch,x_mm,y_mm,z_mm,qw,qx,qy", "a.npz,1,2,3,1,0,0"], ("qz",)),
        ([HEADER, f"a.npz,{QUATERNION}", f"none.npz,{QUATERNION}"], ("row 2", "none.npz")),
        ([HEADER, f",{QUATERNION}"], ("row 1", "touch")),
        ([HEADER, "a.npz,1,-2,,1,0,0,0"], ("row 1", "z_mm")),
        ([HEADER, "a.npz,1,-2,25,1,1,0,0"], ("row 1", "length")),
    ],
)
def test_errors_name_the_table_and_the_row(folder, rows, words):
    with pytest.raises(TouchError, match=naming(*words)):
        read_labelled_touches(write_csv(folder, *rows))


def test_missing_files_other_kinds_of_files_and_damaged_poses_are_refused(folder):
    for path in (folder / "none.csv", folder / "a.npz", folder):
        with pytest.raises(TouchError, match=naming(path.name)):
            read_labelled_touches(path)
    poses = [{"a": [[1]]}, {"gone": TRUE.tolist()}]
    for text in ("{", "[]", "{}", *(json.dumps({"T_sensor_object": one}) for one in poses)):
        (folder / "poses.json").write_text(text)
        with pytest.raises(TouchError, match=naming("poses.json")):
            read_labelled_touches(folder)


def test_a_list_whose_object_is_not_at_rest_is_refused(folder):
    path = folder / "touches.toml"
    shifted = make_transform(np.eye(3), [0.05, 0, 0]) @ T
    second = f'[[touch]]\npath = "a.npz"\nT_base_sensor = {shifted.tolist()}\nT_sensor_object = {TRUE.tolist()}\n'
    path.write_text(f'[[touch]]\npath = "b.npz"\n{second}')
    with pytest.raises(TouchError, match=naming("50.0 mm")):
        read_labelled_touches(path)
