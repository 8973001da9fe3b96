"""Lists of approaches: poses in either frame, and one sentence for each error."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.approach_files import Approach, read_approaches, write_approaches

START = make_transform(rotation_about([0, 0, 1], 0.3), [0.1, 0.2, 0.3])
MOTION = make_transform(rotation_about([1, 0, 0], 0.4), [0.0, 0.02, 0.0])


@pytest.fixture
def listed(tmp_path):
    def write(text: str):
        (tmp_path / "poses.toml").write_text(text)
        return tmp_path / "poses.toml"

    return write


def test_an_approach_is_a_pose_in_the_base_or_a_motion_from_the_last_touch(listed):
    path = listed(
        f'[[approach]]\nT_base_sensor = {START.tolist()}\n[[approach]]\nname = "left"\nT_sensor_next = '
        f"{MOTION.tolist()}\npress_depth_mm = 0.8\ntravel_mm = 40\ncost = inf\n"
        "[[approach]]\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 90]\n"
    )
    first, left, third = read_approaches(path, START)
    assert np.allclose(first.T_base_sensor, START)
    assert (first.name, first.press_m, first.travel_m, first.cost) == ("approach 1", None, 0.1, 1.0)
    assert np.allclose(left.T_base_sensor, START @ MOTION)
    assert (left.name, left.press_m, left.travel_m, left.cost) == ("left", 8e-4, 0.04, np.inf)
    assert np.allclose(third.T_base_sensor[:3, 3], [1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("", ("poses.toml", "[[approach]]")),
        ("[[approach]]\n", ("approach 1", "T_base_sensor", "xyz_mm", "T_sensor_next")),
        ("[[approach]]\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 0]\ncost = 0\n", ("approach 1", "cost", 0)),
        ("[[approach]]\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 0]\nspeed = 0\n", ("approach 1", "'speed'", "travel_mm")),
        (
            f"[[approach]]\nT_base_sensor = {START.tolist()}\nT_sensor_next = {MOTION.tolist()}\n",
            ("approach 1", "T_sensor_next", "base"),
        ),
    ],
)
def test_a_wrong_approach_gives_a_one_sentence_error(listed, text, values):
    with pytest.raises(ConfigError, match=naming(*values)):
        read_approaches(listed(text), START)


def test_a_pose_in_the_base_needs_the_last_pose_of_the_sensor_and_a_motion_does_not(listed):
    (only,) = read_approaches(listed(f"[[approach]]\nT_sensor_next = {MOTION.tolist()}\n"))
    assert np.allclose(only.T_base_sensor, MOTION)
    with pytest.raises(ConfigError, match=naming("poses.toml", "approach 1", "T_sensor_next")):
        read_approaches(listed("[[approach]]\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 0]\n"))
    with pytest.raises(ConfigError, match=r"nowhere\.toml"):
        read_approaches("nowhere.toml")


@pytest.mark.parametrize("T_base_first", [None, START])
def test_written_approaches_are_read_again(tmp_path, T_base_first):
    """They are in the frame of the last touch if its pose in the base is unknown."""
    written = [Approach(MOTION, 8e-4, 0.04, np.inf, "left"), Approach(START @ MOTION, cost=2.0)]
    path = write_approaches(tmp_path / "approaches.toml", written, in_base=T_base_first is not None)
    read = read_approaches(path, T_base_first)
    assert [one.name for one in read] == ["left", "approach 2"]  # a name is made up
    for one, other in zip(written, read, strict=True):
        np.testing.assert_array_equal(other.T_base_sensor, one.T_base_sensor)
        assert (other.press_m, other.travel_m, other.cost) == (one.press_m, pytest.approx(one.travel_m), one.cost)
