"""The conversions of docs/other-tools.md agree with the other tools, or with scipy where a tool is absent."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from page_helpers import read_page
from scipy.spatial.transform import Rotation

from tactile_loc import RosPose
from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about

PAGE = read_page("other-tools.md")
T = make_transform(rotation_about([1, 2, -1], 1.1), np.array([0.4, -0.05, 0.12]))
A = np.random.default_rng(0).normal(size=(6, 6))
COVARIANCE = 1e-6 * (A @ A.T + 6 * np.eye(6))
VERTEX_M = np.array([0.01, 0.02, -0.03])
MESHES = ("Open3D", "trimesh")  # tools that move a mesh


@dataclass
class Found:
    """The part of a hypothesis that the conversions use."""

    T_base_object: np.ndarray
    base_covariance: np.ndarray


def convert(tool: str, **given: object) -> dict[str, object]:
    """Run the code below the heading of a tool, and return its variables."""
    (code,) = re.findall(rf"^## {tool}\n.*?^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[:1]
    names = {"best": Found(T, COVARIANCE), "T": T, "covariance": COVARIANCE, **given}
    exec(compile(code, f"other-tools.md: {tool}", "exec"), names)
    return names


def test_every_tool_of_the_page_is_tested():
    tools = set(re.findall(r"^## (.+)$", PAGE, re.MULTILINE))
    tested = re.findall(r'convert\("([^"]+)"', Path(__file__).read_text())
    assert tools - {"The pose and its covariance", "Differences at a glance", "Mistakes"} == {*tested, *MESHES}


def test_ros_gets_scalar_last_quaternions_and_an_unchanged_covariance():
    found = convert("ROS")
    expected = RosPose.of(T, COVARIANCE)
    assert np.allclose(found["position"], expected.position_m)
    assert np.allclose(Rotation.from_quat(found["orientation"]).as_matrix(), T[:3, :3])
    assert np.allclose(np.reshape(found["row_major"], (6, 6)), COVARIANCE)
    assert np.allclose(found["T_again"], T)


def test_gtsam_gets_the_pose_and_the_covariance_of_its_own_tangent_space():
    gtsam = pytest.importorskip("gtsam")
    found = convert("GTSAM")
    assert np.allclose(found["pose"].matrix(), T)
    step = 1e-6  # the columns of the Jacobian from our errors to those of Pose3
    moved = [gtsam.Pose3(move(T, step * error)) for error in np.eye(6)]
    J = np.transpose([found["pose"].localCoordinates(pose) / step for pose in moved])
    assert np.allclose(found["gtsam_covariance"], J @ COVARIANCE @ J.T, rtol=1e-4, atol=1e-10)
    assert np.allclose(found["covariance_again"], COVARIANCE)


def test_opencv_gets_a_rotation_vector_that_projects_like_our_camera():
    cv2 = pytest.importorskip("cv2")
    T_sensor_object = make_transform(rotation_about([0, 1, 1], 0.3), np.array([0.001, 0.002, 0.025]))
    found = convert("OpenCV", T=T_sensor_object)
    K = np.array([[290.0, 0, 235], [0, 289, 235], [0, 0, 1]])
    (pixel,), _ = cv2.projectPoints(VERTEX_M[None], found["rvec"], found["tvec"], K, None)
    x, y, z = T_sensor_object[:3, :3] @ VERTEX_M + T_sensor_object[:3, 3]
    assert np.allclose(pixel, [290 * x / z + 235, 289 * y / z + 235])
    assert np.allclose(found["T_again"], T_sensor_object)
    assert np.allclose(found["K_opencv"][:2, 2], [234.5, 234.5])


@pytest.mark.parametrize("tool", MESHES)
def test_a_mesh_is_moved_to_the_pose(tool):
    if tool == "Open3D":
        o3d = pytest.importorskip("open3d")
        mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector([1e3 * VERTEX_M]), o3d.utility.Vector3iVector())
    else:
        mesh = trimesh.Trimesh(1e3 * np.array([VERTEX_M]), process=False)
    found = convert(tool, mesh_in_mm=mesh)
    assert np.allclose(np.asarray(found["mesh"].vertices)[0], T[:3, :3] @ VERTEX_M + T[:3, 3])


def test_bop_rows_are_in_millimetres_and_row_major():
    found = convert("BOP", T_camera_object=T)
    columns = found["row"].split(",")
    assert columns[:4] == ["1", "3", "5", "0.92"]
    assert np.allclose(np.reshape([float(w) for w in columns[4].split()], (3, 3)), T[:3, :3])
    assert np.allclose([float(w) for w in columns[5].split()], 1e3 * T[:3, 3])
    assert columns[6] == "-1"
    assert np.allclose(found["T_again"], T)


def test_a_pose_of_a_camera_becomes_a_prior_in_the_base_frame():
    T_base_camera = make_transform(rotation_about([1, 0, 0], 2.5), np.array([0.6, 0.1, 0.9]))
    found = convert("FoundationPose and MegaPose", T_base_camera=T_base_camera, pose=invert(T_base_camera) @ T)
    assert np.allclose(found["T_base_object"], T)


def test_mujoco_quaternions_are_scalar_first():
    found = convert("MuJoCo")
    w, *xyz = found["quat"]
    assert np.allclose(Rotation.from_quat([*xyz, w]).as_matrix(), T[:3, :3])
    assert np.allclose(found["pos"], T[:3, 3])


def test_pytorch3d_matrices_move_row_vectors():
    found = convert("PyTorch3D")
    moved = np.array([*VERTEX_M, 1.0]) @ found["matrix"]
    assert np.allclose(moved[:3], T[:3, :3] @ VERTEX_M + T[:3, 3])


def test_our_covariance_is_that_of_shifts_and_fixed_axis_rotations():
    error = np.array([1e-4, 0, 0, 0, 0, 1e-3])
    assert np.allclose(compute_pose_errors(move(T, error)[None], T[None])[0], error, atol=1e-9)
