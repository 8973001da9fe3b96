"""The scripts of examples/ run, are short, find the right poses, and have a picture on examples.md (in docs)."""

import importlib.util
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from tactile_loc import PoseMetric, Verdict
from tactile_loc.core.geometry.lie import move
from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE
from tactile_loc.plugin.helpers import make_transform, rotation_about

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted((ROOT / "examples").glob("[0-9]*.py"))
PAGE = (ROOT / "docs" / "examples.md").read_text()
LONGEST = 60
LIBRARIES = {"04": "gtsam", "05": "rerun", "06": "rosbags", "08": "cv2"}


@pytest.fixture
def run(monkeypatch, store, tmp_path):
    """Run the script whose name starts with a number, and return its variables; "--picture" draws its picture."""
    mpl.use("Agg")
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))

    def start(number: str, *arguments: str) -> dict[str, Any]:
        pytest.importorskip(LIBRARIES.get(number, "numpy"))
        (script,) = (script for script in SCRIPTS if script.name.startswith(number))
        monkeypatch.setattr(sys, "argv", [str(script), *arguments])
        return runpy.run_path(str(script), run_name="__main__")

    return start


def error_m(found) -> float:
    return float(found.measure_errors_m(found.object)[0])


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_each_script_is_short_and_shown_with_its_picture(script):
    assert len(script.read_text().splitlines()) <= LONGEST
    picture = f"images/example-{script.stem[3:].replace('_', '-')}.png"
    assert f"examples/{script.name}" in PAGE
    assert f"({picture})" in PAGE
    assert Image.open(ROOT / "docs" / picture).width > 300
    assert not re.search(r"/(home|tmp|work)/", script.read_text())


@pytest.mark.slow
def test_a_depth_map_gives_the_same_pose_in_every_kind(run, tmp_path):
    made = run("01", "--picture", str(tmp_path / "depth.png"))
    poses = [result.best.T_sensor_object for result in made["results"].values()]
    assert len(poses) == 3
    np.testing.assert_allclose(poses, np.broadcast_to(made["simulated"].T_sensor_object, (3, 4, 4)), atol=5e-4)
    assert (tmp_path / "depth.png").exists()


@pytest.mark.slow
def test_two_sensors_find_the_pose_that_neither_finds_alone(run):
    made = run("02")
    assert min(map(error_m, made["alone"])) > 5e-3
    assert error_m(made["together"]) < 2e-4
    assert np.allclose(made["together"].best.T_base_object, made["T_base_object"], atol=5e-4)


@pytest.mark.slow
def test_a_pose_from_vision_resolves_the_touch(run):
    made = run("03")
    truth, obj = made["touch"].T_sensor_object, made["localizer"].object
    both = np.stack([made[name].best.T_sensor_object for name in ("alone", "with_prior")])
    assert ONE_MILLIMETRE.find_within(obj, truth, both).tolist() == [False, True]
    np.testing.assert_allclose(made["megapose"], made["foundation_pose"], atol=1e-12)
    np.testing.assert_allclose(made["bop"], made["foundation_pose"], atol=1e-12)


def test_the_gtsam_covariance_is_that_of_sampled_poses(run):
    """Poses are drawn with tactile-loc's errors. GTSAM's local coordinates of these poses have the converted one."""
    gtsam, made, rng = pytest.importorskip("gtsam"), run("04"), np.random.default_rng(0)
    half = rng.normal(size=(6, 6)) * np.array([[1e-3] * 3 + [5e-3] * 3]).T
    T, covariance = make_transform(rotation_about([1, 2, 3], 1.0), [0.4, -0.1, 0.2]), half @ half.T
    drawn = [gtsam.Pose3(move(T, error)) for error in rng.multivariate_normal(np.zeros(6), covariance, 20_000)]
    local = np.array([gtsam.Pose3(T).localCoordinates(pose) for pose in drawn])
    noise = made["make_noise"](T, covariance)
    white = np.array([noise.whiten(xi) for xi in local])
    np.testing.assert_allclose(np.cov(white.T), np.eye(6), atol=0.05)
    back = made["swap_halves"](noise.covariance(), T[:3, :3])
    np.testing.assert_allclose(back, covariance, atol=1e-12)


def test_the_gtsam_graph_is_surer_than_the_camera(run):
    made = run("04")
    assert (made["stds"]["camera, touch and arm"] < 1.5).all()
    T_solved = made["solved"].atPose3(made["OBJECT"]).matrix()
    metric = PoseMetric(made["localizer"].object)
    assert metric.symmetric_distance(T_solved[None], made["T_base_object"][None])[0] < 1e-3


@pytest.mark.slow
def test_the_rerun_recording_is_written(run, tmp_path):
    made = run("05", "--out", str(tmp_path / "touch.rrd"))
    assert (tmp_path / "touch.rrd").stat().st_size > 10_000
    assert len(made["equal"]) > 1


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="with ROS, the script publishes the message")
def test_the_ros_message_survives_its_encoding(run):
    made = run("06")
    read = made["types"].deserialize_cdr(made["data"], made["NAME"])
    at, best = read.pose.pose, made["best"]
    assert [at.position.x, at.position.y, at.position.z] == pytest.approx(best.T_base_object[:3, 3])
    assert at.orientation.w == pytest.approx(best.base_quaternion_xyzw[3])
    np.testing.assert_array_equal(np.reshape(read.pose.covariance, (6, 6)), best.base_covariance)


@pytest.mark.slow
def test_the_touched_points_lie_on_the_mesh_in_open3d(run):
    made = run("07")
    assert np.median(made["gap_mm"]) < 0.1
    assert len(made["gap_mm"]) > 1000


@pytest.mark.slow
def test_opencv_projects_the_outline_onto_the_contact(run):
    made = run("08")
    assert all(made["inside"])
    columns, rows = np.rint((made["pixels"].reshape(-1, 2) + 0.5) / made["k"] - 0.5).astype(int).T
    contact = made["shape"].contact
    beside = [contact[row - 1 : row + 2, column - 1 : column + 2] for row, column in zip(rows, columns, strict=True)]
    assert np.mean([some.any() for some in beside]) > 0.95
    assert np.mean([not some.all() for some in beside]) > 0.8


def test_touches_are_repeated_until_the_verdict_is_certain(run):
    made = run("09")
    assert made["history"][0][0] is not Verdict.CERTAIN
    assert made["history"][-1][0] is Verdict.CERTAIN
