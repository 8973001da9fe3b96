"""TOML: poses in millimetres, degrees and quaternions become (4, 4) metres; a configuration is written."""

import math
import os
import tomllib

import numpy as np
import pytest
from message_helpers import naming
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import rotation_to_quaternion_xyzw
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.config import RunConfig
from tactile_loc.io.toml import Matrix, PoseKeys, format_toml, parse_value, read_toml
from tactile_loc.store.files import write_text


class Keys(PoseKeys):
    T: Matrix | None = None


def read_pose(**keys):
    return Keys(**keys).read_pose("T")


def test_angles_rotate_about_fixed_axes_with_roll_first():
    T = read_pose(xyz_mm=[1, -2.5, 30], rpy_deg=[10, -20, 70])
    np.testing.assert_allclose(T[:3, 3], [0.001, -0.0025, 0.030], atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_euler("xyz", [10, -20, 70], degrees=True).as_matrix())
    quarter = read_pose(xyz_mm=[0, 0, 0], rpy_deg=[90, 0, 90])
    np.testing.assert_allclose(quarter[:3, :3] @ [0, 1, 0], [0, 0, 1], atol=1e-12)  # y to z by the roll, z stays


def test_four_notations_give_the_same_pose():
    angles = read_pose(xyz_mm=[1, 2, 3], rpy_deg=[10, -20, 70])
    w_last = Rotation.from_matrix(angles[:3, :3]).as_quat()
    rounded = [round(float(v), 4) for v in [w_last[3], *w_last[:3]]]
    quaternion = read_pose(xyz_mm=[1, 2, 3], quaternion_wxyz=rounded)
    np.testing.assert_allclose(quaternion, angles, atol=2e-4)
    assert np.linalg.det(quaternion[:3, :3]) == pytest.approx(1, abs=1e-12)
    np.testing.assert_array_equal(read_pose(T=angles.tolist()), angles)
    exact = {"xyz_m": [1e-3, 2e-3, 3e-3], "quaternion_xyzw": rotation_to_quaternion_xyzw(angles[:3, :3]).tolist()}
    np.testing.assert_allclose(read_pose(**exact), angles, atol=1e-12)  # as results give it
    assert read_pose() is None


XYZ, RPY = {"xyz_mm": [0, 0, 0]}, {"rpy_deg": [0, 0, 0]}
XYZW, WXYZ = {"quaternion_xyzw": [0, 0, 0, 1]}, {"quaternion_wxyz": [1, 0, 0, 0]}


@pytest.mark.parametrize(
    ("keys", "values"),
    [
        ({"xyz_mm": [0, 0, 0]}, ("T", "no rotation", "rpy_deg", "quaternion_wxyz")),
        ({"rpy_deg": [0, 0, 0]}, ("T", "xyz_mm", "rpy_deg", "no position")),
        (XYZ | RPY | WXYZ, ("more than one rotation", "rpy_deg", "quaternion_wxyz")),
        (XYZ | XYZW | WXYZ, ("more than one rotation", "quaternion_xyzw", "quaternion_wxyz")),
        (XYZ | {"xyz_m": [0, 0, 0]} | RPY, ("more than one position", "xyz_mm", "xyz_m")),
        ({"quaternion_xyzw": [0, 0, 0, 1]}, ("T", "xyz_m", "quaternion_xyzw", "no position")),
        ({"xyz_mm": [0, 0, 0], "quaternion_wxyz": [1, 1, 0, 0]}, ("quaternion_wxyz", "1.414")),
        ({"xyz_m": [0, 0, 0], "quaternion_xyzw": [1, 1, 0, 0]}, ("quaternion_xyzw", "1.414")),
        ({"xyz_m": [0, 0, 0], "T": np.eye(4).tolist()}, ("T", "xyz_m")),
        ({"xyz_mm": [0, 0, 0], "T": np.eye(4).tolist()}, ("T", "xyz_mm")),
        ({"T": (2 * np.eye(4)).tolist()}, ("T", "rigid")),
        ({"T": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, ("T", "rigid")),
    ],
)
def test_an_incomplete_pose_and_two_poses_are_refused(keys, values):
    with pytest.raises((ValueError, ConfigError), match=naming(*values)):
        read_pose(**keys)


def test_a_written_configuration_is_read_back_unchanged():
    config = RunConfig.from_dict(
        {"object": {"path": 'a "b"\\é.stl'}, "grid": {"name": "face", "tilt_deg": 3.5}, "top": 4, "seed": 9}
    )
    text = format_toml(config.resolve())
    again = RunConfig.from_dict(tomllib.loads(text))
    assert again.resolve() == config.resolve()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (1.5, "1.5"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        ([1, [2, "a"]], '[1, [2, "a"]]'),
        ({"a": 1, "b c": None}, "{ a = 1 }"),
    ],
)
def test_values_are_written_as_toml(value, text):
    table = {"s": {"key": value}} if isinstance(value, dict) else {"key": value}
    assert format_toml(table).endswith(f"key = {text}\n")


def test_values_that_are_not_set_are_omitted():
    assert format_toml({"touch": {"path": None, "noise": "none"}}) == '[touch]\nnoise = "none"\n'


@pytest.mark.parametrize("text", [f"a = {'9' * 5000}", f"a = {'[' * 5000}"], ids=["digits", "nesting"])
def test_endless_numbers_and_endless_nesting_are_refused(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ConfigError, match=naming("a.toml", "TOML")):
        read_toml(tmp_path / "a.toml")
    assert parse_value(text.removeprefix("a = ")) == text.removeprefix("a = ")


def test_a_text_that_toml_does_not_allow_is_escaped(tmp_path):
    path = write_text(tmp_path / "names.toml", format_toml({"a": '\x7f\n"', "b": os.fsdecode(b"Geh\xe4use")}))
    assert read_toml(path) == {"a": '\x7f\n"', "b": r"Geh\xe4use"}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_files_of_other_editors_are_read(tmp_path, encoding, end):
    path = tmp_path / "a.toml"
    path.write_bytes(end.join(["name = 'ü'", "[grid]", "n = 3", ""]).encode(encoding))
    assert read_toml(path) == {"name": "ü", "grid": {"n": 3}}
