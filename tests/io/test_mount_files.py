"""Mount files: a written mount is read back, a pose from a drawing is enough, and wrong keys are named."""

import json

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.mount_files import HandEyeRecord, HandEyeTouchRecord, Mount, read_mount, write_mount

X = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.01, -0.02, 0.1])
COVARIANCE = np.diag([1e-8] * 3 + [4e-6] * 3)


def test_a_written_mount_is_read_back(tmp_path):
    touches = [
        HandEyeTouchRecord(name='a "b".npz', residual_m=1e-7, left_out="it slipped"),
        HandEyeTouchRecord(name="c"),
    ]
    poses = {"T_flange_sensor": X.tolist(), "covariance": COVARIANCE.tolist(), "T_base_object": X.tolist()}
    record = HandEyeRecord(**poses, object="pin", sensor="digit", variance_factor=1.5, touch=touches)
    path = write_mount(tmp_path / "mount.toml", record)
    found = read_mount(path)
    np.testing.assert_array_equal(found.T_flange_sensor, X)
    np.testing.assert_array_equal(found.covariance, COVARIANCE)
    assert path.read_text().count("[[touch]]") == 2


def test_a_nominal_mount_needs_only_a_pose(tmp_path):
    path = tmp_path / "nominal.toml"
    path.write_text("xyz_mm = [10, -20, 100]\nrpy_deg = [0, 0, 90]\n")
    found = read_mount(path)
    np.testing.assert_allclose(found.T_flange_sensor, X, atol=1e-15)
    assert found.find_std_at(np.zeros(3)) == (0.0, 0.0)


def test_the_error_of_a_rotation_grows_with_the_distance():
    near, far = (Mount(X, COVARIANCE).find_std_at(np.array([0, 0, z])) for z in (0.0, 0.1))
    assert near == pytest.approx((1e-4, 2e-3))
    assert far == pytest.approx((np.sqrt(1e-8 + 2 / 3 * 0.01 * 4e-6), 2e-3))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("", ("T_flange_sensor", "xyz_mm", "rpy_deg")),
        (f"T_flange_sensor = {(2 * np.eye(4)).tolist()}\n", ("T_flange_sensor", "rigid")),
        ("T_sensor_flange = 3\n", ("'T_sensor_flange'", "'T_flange_sensor'")),
        (f"T_flange_sensor = {X.tolist()}\ncovariance = [[1]]\n", ("covariance", "[[1]]")),
        (
            f"T_flange_sensor = {X.tolist()}\ncovariance = {json.dumps((-np.eye(6)).tolist())}\n",
            ("covariance", "symmetric"),
        ),
    ],
)
def test_a_wrong_file_gives_a_one_sentence_error(tmp_path, text, values):
    path = tmp_path / "mount.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=naming(*values)) as caught:
        read_mount(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match=naming(tmp_path / "none.toml")):
        read_mount(tmp_path / "none.toml")
