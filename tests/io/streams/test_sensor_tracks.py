"""Sensor poses from a CSV file: by file or by time, in metres or mm, and one sentence for each mistake."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.runtime.errors import FrameError
from tactile_loc.io.streams.sensor_tracks import read_sensor_track, read_time_s

HALF = 0.5**0.5
BY_FILE = (
    f"file,time_s,x_m,y_m,z_m,qx,qy,qz,qw\na.npz,10.0,0.1,0.2,0.3,0,0,0,1\nb.npz,10.5,0.2,0.2,0.3,0,0,{HALF},{HALF}\n"
)


def write(folder: Path, text: str) -> Path:
    path = folder / "poses.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_poses_are_found_by_file_name(tmp_path):
    track = read_sensor_track(write(tmp_path, BY_FILE))
    assert (track.names, track.times_s.tolist()) == (("a.npz", "b.npz"), [10.0, 10.5])
    expected = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.2, 0.2, 0.3])
    np.testing.assert_allclose(track.look_up("b.npz"), expected, atol=1e-12)
    with pytest.raises(FrameError, match=naming("poses.csv", "c.npz")):
        track.look_up("c.npz")


@pytest.mark.parametrize(("names", "scale"), [("x_m,y_m,z_m", 1), ("x,y,z", 1), ("x_mm,y_mm,z_mm", 1000)])
def test_the_unit_is_in_the_column_names(tmp_path, names, scale):
    text = f"time_s,{names},qx,qy,qz,qw\n1,{0.1 * scale},{0.2 * scale},{0.3 * scale},0,0,0,1\n"
    track = read_sensor_track(write(tmp_path, text))
    np.testing.assert_allclose(track.T_base_sensor[0, :3, 3], [0.1, 0.2, 0.3], atol=1e-12)


def test_poses_are_interpolated_at_the_time_in_the_name_or_the_given_time(tmp_path):
    text = BY_FILE.replace("file,", "").replace("a.npz,", "").replace("b.npz,", "")
    track = read_sensor_track(write(tmp_path, text))
    expected = make_transform(rotation_about([0, 0, 1], np.pi / 4), [0.15, 0.2, 0.3])
    np.testing.assert_allclose(track.look_up("10.25.png"), expected, atol=1e-9)
    np.testing.assert_allclose(track.look_up("frame-000003", 10.25), expected, atol=1e-9)
    with pytest.raises(FrameError, match=naming("10.000 s", "10.500 s", "11.000 s")):
        track.look_up("11.npz")


def test_times_in_names_are_numbers():
    assert [read_time_s(name) for name in ("12.5.png", "3", "1700000000.25.npz")] == [12.5, 3.0, 1700000000.25]
    assert [read_time_s(name) for name in ("touch-1.png", "nan.png", "")] == [None] * 3


def test_rows_without_times_follow_each_other(tmp_path):
    track = read_sensor_track(write(tmp_path, "file,x,y,z,qx,qy,qz,qw\na,0,0,0,0,0,0,1\nb,0,0,0,0,0,0,1\n"))
    assert (np.diff(track.times_s) > 0).all()


@pytest.mark.parametrize(
    ("text", "mentioned"),
    [
        (BY_FILE.splitlines()[0], ["poses.csv", "no sensor pose"]),
        (BY_FILE.replace("file", "name").replace("time_s", "t"), ["poses.csv", "file", "time_s"]),
        (BY_FILE.replace("qw", "w"), ["poses.csv", "qw"]),
        (BY_FILE.replace("z_m", "h"), ["poses.csv", "z_m"]),
        (BY_FILE.replace("x_m,y_m,z_m", "a,b,c"), ["poses.csv", "x_mm"]),
        (BY_FILE.replace("qx,", "x_mm,"), ["poses.csv", "several"]),
        (BY_FILE.replace("0.2,0.2", "0.2,east"), ["row 2", "y_m", "east"]),
        (BY_FILE.replace("0.1,0.2,0.3", "410,20,300"), ["row 1", "x_mm"]),
        (BY_FILE.replace("0,0,0,1", "0,0,0,0"), ["row 1", "length"]),
        (BY_FILE.replace("b.npz", "a.npz"), ["row 2", "a.npz"]),
        (BY_FILE.replace("b.npz", ""), ["row 2", "file"]),
        (BY_FILE.replace("10.5", "9.5"), ["row 2", "time_s"]),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(tmp_path, text, mentioned):
    with pytest.raises(FrameError, match=naming(*mentioned)):
        read_sensor_track(write(tmp_path, text))
