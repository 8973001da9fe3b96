"""Resolve an ambiguous touch with a pose from vision: FoundationPose, MegaPose or BOP."""

import argparse

import numpy as np
from scipy.spatial.transform import Rotation

from tactile_loc import GaussianPrior, Localizer, draw_result, save_figure

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the result as PNG")
picture = parser.parse_args().picture

localizer = Localizer.create("hook", sensor="gelsight-mini")
touch = localizer.simulate(seed=13)[0]
T_base_camera = np.array(
    [[0, -1, 0, 0.5], [-1, 0, 0, 0.0], [0, 0, -1, 0.6], [0, 0, 0, 1.0]]
)  # your hand-eye calibration
T_base_sensor = np.array([[1, 0, 0, 0.5], [0, -1, 0, 0.1], [0, 0, -1, 0.1], [0, 0, 0, 1.0]])  # from the robot


def read_megapose(record: dict) -> np.ndarray:
    """Return T_camera_object of an entry of outputs/object_data.json: quaternion (x, y, z, w) and metres."""
    quaternion_xyzw, translation_m = record["TWO"]  # MegaPose's world is the camera
    return make_pose(Rotation.from_quat(quaternion_xyzw).as_matrix(), translation_m)


def read_bop(record: dict) -> np.ndarray:
    """Return T_camera_object of an entry of a BOP file, in metres. BOP has millimetres."""
    return make_pose(np.reshape(record["cam_R_m2c"], (3, 3)), 1e-3 * np.array(record["cam_t_m2c"]))


def make_pose(R: np.ndarray, t_m: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of a rotation (3, 3) and a translation (3,)."""
    return np.block([[R, np.reshape(t_m, (3, 1))], [np.zeros((1, 3)), 1]])


# All three have the camera frame of OpenCV (x right, y down, z forward) and the frame of the mesh file, as tactile-loc.
# Check the mesh's unit: FoundationPose takes it as metres. Here, the camera sees the true pose with an error.
T_camera_true = np.linalg.inv(T_base_camera) @ T_base_sensor @ touch.T_sensor_object
R, t_m = Rotation.from_euler("xyz", [4, -3, 5], degrees=True).as_matrix() @ T_camera_true[:3, :3], T_camera_true[:3, 3]
foundation_pose = make_pose(R, t_m + np.array([3e-3, -2e-3, 4e-3]))  # as `FoundationPose.register` returns it
megapose = read_megapose({"TWO": [Rotation.from_matrix(R).as_quat().tolist(), foundation_pose[:3, 3].tolist()]})
bop = read_bop({"cam_R_m2c": R.ravel().tolist(), "cam_t_m2c": (1e3 * foundation_pose[:3, 3]).tolist()})

T_sensor_object = np.linalg.inv(T_base_sensor) @ T_base_camera @ foundation_pose
prior = GaussianPrior(T_sensor_object, 0.005, np.radians(8), localizer.object.symmetry)  # the camera's usual errors

alone, with_prior = localizer.localize(touch), localizer.localize(touch, prior)
for name, result in (("touch alone", alone), ("touch and camera", with_prior)):
    near, error_mm = result.probability_within("1mm"), 1e3 * result.measure_errors_m(localizer.object)[0]
    stated = "" if near is None else f"within 1 mm with {near:.0%} probability, "
    print(f"{name}: {result.verdict}, {stated}in truth {error_mm:.2f} mm off")

if picture:
    save_figure(picture, draw_result(with_prior, localizer.scene.match_touch(touch), "A touch, and a pose from vision"))
