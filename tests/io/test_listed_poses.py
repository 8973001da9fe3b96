"""Lists of poses have the same content in each format, and bad lists are refused."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from message_helpers import naming
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.listed_poses import ListedPoses, read_detections, read_listed_poses

POSES = make_transform(draw_rotations(3, np.random.default_rng(0)), [[0.1, 0.2, 0.5], [0.1, 0.2, 0.6], [0, 0, 1]])
SCORES = np.array([0.5, 0.25, 0.25])


def scale(factor: float) -> np.ndarray:
    """Return the poses with translations in another unit."""
    return make_transform(POSES[:, :3, :3], factor * POSES[:, :3, 3])


def write_bop(path: Path, poses: np.ndarray = POSES, **changes: str) -> Path:
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for k, (T, score) in enumerate(zip(poses, SCORES, strict=True)):
        R, t = (" ".join(f"{v:.12g}" for v in part.ravel()) for part in (T[:3, :3], 1e3 * T[:3, 3]))
        row = {"scene_id": "1", "im_id": "2", "obj_id": "3", "score": str(score), "R": R, "t": t, "time": "-1"}
        lines.append(",".join((row | changes if k == 1 else row).values()))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_arrays(path: Path, **changes: object) -> Path:
    np.savez(path, **{"poses": POSES, "scores": SCORES, **changes})
    return path


def detect() -> dict:
    """Return the fields of a Detection3DArray: one detection with two hypotheses, and one with the third."""
    results = []
    for T, score in zip(POSES, SCORES, strict=True):
        position = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
        orientation = dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat().tolist(), strict=True))
        pose = {"pose": {"position": position, "orientation": orientation}, "covariance": [0.0] * 36}
        results.append({"hypothesis": {"class_id": "hook", "score": float(score)}, "pose": pose})
    return {"header": {}, "detections": [{"results": results[:2]}, {"results": results[2:]}]}


def write_json(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_each_format_has_the_same_poses_and_scores(tmp_path):
    files = [
        write_bop(tmp_path / "bop.csv"),
        write_arrays(tmp_path / "poses.npz"),
        write_json(tmp_path / "detections.json", detect()),
    ]
    for path in files:
        found = read_listed_poses(path)
        np.testing.assert_allclose(found.T_camera_object, POSES, atol=1e-9, err_msg=path.name)
        np.testing.assert_array_equal(found.scores, SCORES)


def test_detections_may_be_a_message(tmp_path):
    message = json.loads(json.dumps(detect()), object_hook=lambda fields: SimpleNamespace(**fields))
    np.testing.assert_allclose(read_detections(message).T_camera_object, POSES, atol=1e-9)


def test_scores_become_probabilities():
    listed = ListedPoses(POSES, 4 * SCORES)
    np.testing.assert_allclose(listed.weigh("proportional"), SCORES)
    np.testing.assert_allclose(ListedPoses(POSES, np.log(SCORES) - 700).weigh("log"), SCORES)
    np.testing.assert_allclose(listed.weigh("equal"), 1 / 3)
    unscored = ListedPoses(POSES, None)
    np.testing.assert_allclose(unscored.weigh("equal"), 1 / 3)
    with pytest.raises(ConfigError, match="equal"):
        unscored.weigh("proportional")
    for scores in ([-1.0, 2.0, 3.0], [0.0, 0.0, 0.0]):
        with pytest.raises(ConfigError, match=naming("log", "equal")):
            ListedPoses(POSES, np.array(scores)).weigh("proportional")


@pytest.mark.parametrize(
    ("name", "write", "named"),
    [
        ("a.csv", lambda path: write_bop(path, obj_id="4"), ["obj_id", "2"]),
        ("a.csv", lambda path: write_bop(path, R="1 0 0"), ["row 2", "R"]),
        ("a.csv", lambda path: write_bop(path, t="far away from"), ["row 2", "t"]),
        ("a.csv", lambda path: write_bop(path, score="nan"), ["score"]),
        ("a.csv", lambda path: write_bop(path, R="2 0 0 0 2 0 0 0 2"), ["pose 2"]),
        ("a.csv", lambda path: path.write_text("x,y\n1,2\n"), ["score"]),
        ("a.csv", lambda path: path.write_text("scene_id,im_id,obj_id,score,R,t,time\n"), ["no pose"]),
        ("a.csv", lambda path: write_bop(path, scale(1e-3)), ["mm in .csv"]),
        ("a.npz", lambda path: write_arrays(path, poses=scale(1e3)), ["metres in .npz"]),
        ("a.npz", lambda path: np.savez(path, scores=SCORES), ["poses"]),
        ("a.npz", lambda path: write_arrays(path, scores=np.ones(2)), ["3", "2"]),
        ("a.npz", lambda path: write_arrays(path, poses=POSES[0]), ["(4, 4)"]),
        ("a.npz", lambda path: write_arrays(path, poses=np.array(["a", "b"])), []),
        ("a.npz", lambda path: path.write_bytes(b"PK\3\4 damaged"), []),
        ("a.json", lambda path: write_json(path, {"detections": 3}), []),
        ("a.json", lambda path: write_json(path, [1]), ["detections"]),
        ("a.json", lambda path: path.write_text("{"), []),
        ("a.txt", lambda path: path.write_text(""), [".csv"]),
        ("missing.npz", lambda path: None, []),
    ],
)
def test_a_bad_list_is_refused(tmp_path, name, write, named):
    path = tmp_path / name
    write(path)
    with pytest.raises(ConfigError, match=naming(name, *named)):
        read_listed_poses(path)


def test_a_spreadsheets_list_is_read_and_arrays_may_lack_scores(tmp_path):
    path = write_bop(tmp_path / "bop.csv")
    path.write_text(path.read_text().replace(",", ";"))
    np.testing.assert_allclose(read_listed_poses(path).T_camera_object, POSES, atol=1e-9)
    np.savez(tmp_path / "poses.npz", poses=POSES)
    assert read_listed_poses(tmp_path / "poses.npz").scores is None


@pytest.mark.parametrize("length", [0.0, 0.7])
def test_detections_of_several_objects_or_with_an_impossible_quaternion_are_refused(length):
    several, no_turn = detect(), detect()
    several["detections"][1]["results"][0]["hypothesis"]["class_id"] = "pin"
    with pytest.raises(ConfigError, match=naming("hook", "pin")):
        read_detections(several)
    no_turn["detections"][0]["results"][0]["pose"]["pose"]["orientation"] = dict.fromkeys("xyzw", length / 2)
    with pytest.raises(ConfigError, match="orientation"):
        read_detections(no_turn)
