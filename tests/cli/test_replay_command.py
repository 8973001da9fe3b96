"""`tactile-loc replay`: poses from a simulated recording, in files that another library reads."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_refused, succeed
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from message_helpers import missing
from rerun_helpers import read

from tactile_loc.core.geometry.lie import compute_pose_errors
from tactile_loc.evaluation.slides import T_BASE_OBJECT, T_FLANGE_GEL
from tactile_loc.io.streams.recordings import Recording, write_recording
from tactile_loc.io.streams.ros_messages import (
    IMAGE,
    TF,
    RosPose,
    make_image,
    make_transforms,
    read_pose,
    read_stamp_ns,
    read_transform,
)

HEAD = ["--object", "head", "--sensor", "gelslim"]
LOCATED = [*HEAD, *TINY, "-o", "temperature=0.001"]  # no temperature is fitted
IMAGES = 14


@pytest.fixture(scope="module")
def slide(tmp_path_factory) -> Path:
    """A recording of a slide over the head, drawn by another renderer."""
    from tactile_loc_cli.main import app
    from typer.testing import CliRunner

    path = tmp_path_factory.mktemp("slide") / "slide.mcap"
    words = ["simulate", *HEAD, *TINY, "--renderer", "zbuffer", "--seed", 3, "--count", IMAGES, "--recording", path]
    done = CliRunner().invoke(app, [*map(str, words)], prog_name="tactile-loc")
    assert done.exit_code == 0, done.stderr
    return path


def decoded(path: Path | str, topic: str) -> list:
    with Path(path).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(m.message.log_time, m.decoded_message) for m in reader.iter_decoded_messages(topics=[topic])]


def test_poses_are_near_the_truth_in_the_base_frame(cli, slide):
    done = succeed(cli("replay", slide, "--image-topic", "/gel/image", *LOCATED, "--base-frame", "base", "--json"))
    said = json.loads(done.stdout)
    assert said["written"] == ["slide-poses.mcap", "slide-poses.csv", "slide-poses.json"]
    assert (said["frames"], said["no_contact"], said["refused"], said["resumed"]) == (IMAGES, 2, 0, 0)
    images, poses = decoded("slide-poses.mcap", "/gel/image"), decoded("slide-poses.mcap", "/object/pose")
    assert len(images) == IMAGES
    assert [time for time, _ in poses] == [time for time, _ in images[1:-1]]
    errors = np.array([compute_pose_errors(read_pose(pose).T, T_BASE_OBJECT) for _, pose in poses])
    assert np.median(np.linalg.norm(errors[:, :3], axis=1)) < 1e-3
    for (_, image), (_, pose) in zip(images[1:-1], poses, strict=True):
        assert read_stamp_ns(pose.header) == read_stamp_ns(image.header)
        assert pose.header.frame_id == "base"
        assert np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6))).min() > 0
    rows = list(csv.DictReader(Path("slide-poses.csv").read_text().splitlines()))
    frames = json.loads(Path("slide-poses.json").read_text())["poses"]
    assert [row["verdict"] for row in rows] == [frame["verdict"] for frame in frames]
    assert float(rows[5]["x_mm"]) == pytest.approx(1e3 * frames[5]["T_frame_object"][0][3], abs=1e-3)
    assert float(rows[5]["x_mm"]) == pytest.approx(1e3 * poses[4][1].pose.pose.position.x, abs=1e-3)


def test_the_simulated_recording_contains_the_true_poses(slide):
    """With the TF, the poses in the sensor frame give one constant pose in the base frame."""
    tree = Recording(slide).read_frame_tree()
    for _, message in decoded(slide, "/object/truth"):
        p, q = message.pose.position, message.pose.orientation
        T_gel_object = read_transform(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))
        T_base_gel = tree.look_up("base", "gel", read_stamp_ns(message.header))
        np.testing.assert_allclose(T_base_gel @ T_gel_object, T_BASE_OBJECT, atol=1e-9)
    np.testing.assert_allclose(tree.look_up("flange", "gel", 0), T_FLANGE_GEL, atol=1e-12)


def test_a_rerun_file_contains_the_poses_in_the_base_frame(cli, slide):
    """The file stores the object's pose in the sensor frame, and the sensor's pose in the base frame."""
    pytest.importorskip("rerun", reason="rerun is not installed")
    done = succeed(cli("replay", slide, *LOCATED, "--base-frame", "base", "--rerun", "slide.rrd", "--out", "out.mcap"))
    assert not missing(done.stdout, "out.json", "slide.rrd")
    found = read(Path("slide.rrd"))
    below = found["base/sensor/object"]["Transform3D:translation"]
    places, turns = (found["base/sensor"][f"Transform3D:{name}"] for name in ("translation", "mat3x3"))
    frames = [f for f in json.loads(Path("out.json").read_text())["poses"] if f["T_frame_object"] is not None]
    assert len(frames) == len(below) == len(places) == IMAGES - 2
    for frame, (t,), (place,), (turn,) in zip(frames, below, places, turns, strict=True):
        R = np.reshape(turn, (3, 3)).T
        np.testing.assert_allclose(R @ t + place, np.array(frame["T_frame_object"])[:3, 3], atol=1e-6)
    assert len(found["image"].get("Image:buffer", [])) == 0  # the recording contains depth images
    assert len(found["contact_shape"]["DepthImage:buffer"]) == IMAGES - 2


def test_an_object_at_rest_gets_one_pose(cli, slide):
    done = succeed(cli("replay", slide, *LOCATED, "--base-frame", "base", "--fuse", "--json", "--out", "rest.mcap"))
    said = json.loads(done.stdout)
    rest = json.loads(Path("rest.json").read_text())["rest"]
    assert said["rest"] == rest
    assert (said["frames"], said["no_contact"]) == (IMAGES, 2)
    poses = [read_pose(pose).T for _, pose in decoded("rest.mcap", "/object/pose")]
    assert len(poses) == IMAGES
    np.testing.assert_allclose(poses, np.broadcast_to(rest["T_base_object"], (IMAGES, 4, 4)), atol=1e-6)
    assert np.linalg.norm(compute_pose_errors(poses[0], T_BASE_OBJECT)[:3]) < 1e-3
    verdicts = [verdict.data for _, verdict in decoded("rest.mcap", "/object/verdict")]
    assert verdicts.count("no contact") == 2
    assert len(verdicts) == IMAGES


def test_a_track_and_a_required_verdict(cli, slide):
    """The exit code is 3 if no pose has the required verdict."""
    words = ["replay", slide, *LOCATED, "--base-frame", "base", "--track", "--out", "track.mcap", "--poses-only"]
    done = cli(*words, "--require", "certain")
    frames = json.loads(Path("track.json").read_text())["poses"]
    certain = [frame for frame in frames if frame["verdict"] == "certain"]
    assert done.exit_code == (0 if certain else 3), done.stderr
    assert len(decoded("track.mcap", "/object/pose")) == len(certain)
    assert len(decoded("track.mcap", "/object/verdict")) == IMAGES


@pytest.fixture
def folder(slide, tmp_path) -> Path:
    """The slide's images as files, with the sensor's poses in poses.csv."""
    folder, tree = tmp_path / "images", Recording(slide).read_frame_tree()
    folder.mkdir()
    lines = ["file,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw"]
    for number, message in enumerate(Recording(slide).read_messages("/gel/image")):
        image = message.decode()
        depth = np.frombuffer(bytes(image.data), "<f4").reshape(image.height, image.width)
        np.savez(folder / f"{number:02d}.npz", depth=depth, unit="m")
        stamp_ns = read_stamp_ns(image.header)
        pose = RosPose.of(tree.look_up("base", "gel", stamp_ns), None)
        place = ",".join(f"{1e3 * v:.6f}" for v in pose.position_m)
        turn = ",".join(f"{v:.9f}" for v in pose.quaternion_xyzw)
        lines.append(f"{number:02d}.npz,{stamp_ns / 1e9:.9f},{place},{turn}")
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.slow
def test_a_folder_with_sensor_poses_gives_the_same_pose_as_the_recording(cli, slide, folder):
    words = [*LOCATED, "--fuse", "--json"]
    done = succeed(cli("replay", folder, "--poses", folder.parent / "poses.csv", *words))
    said = json.loads(done.stdout)
    assert said["written"] == ["images-poses.csv", "images-poses.json"]
    recorded = json.loads(cli("replay", slide, *words, "--base-frame", "base").stdout)
    np.testing.assert_allclose(said["rest"]["T_base_object"], recorded["rest"]["T_base_object"], atol=3e-4)
    assert said["rest"]["verdict"] == recorded["rest"]["verdict"]
    rows = list(csv.DictReader(Path("images-poses.csv").read_text().splitlines()))
    assert [row["name"] for row in rows] == [f"{number:02d}.npz" for number in range(IMAGES)]
    done = succeed(cli("replay", folder, "--poses", folder.parent / "poses.csv", *LOCATED, "--track", "--out", "t.csv"))
    assert len(json.loads(Path("t.json").read_text())["poses"]) == IMAGES


def test_bad_sensor_poses_and_options_are_one_sentence(cli, slide, folder):
    poses = folder.parent / "poses.csv"
    (folder.parent / "bad.csv").write_text(poses.read_text().replace("03.npz", "33.npz"))
    (folder.parent / "timed.csv").write_text(poses.read_text().replace("file,", "name,"))
    (folder / "extra.npz").write_bytes(b"")
    for words, mentioned in (
        ([folder, "--poses", folder.parent / "bad.csv"], "33.npz"),
        ([folder, "--poses", folder.parent / "timed.csv"], "extra.npz"),
        ([folder, "--poses", "none.csv"], "none.csv"),
        (["none", "--poses", poses], "none"),
        ([folder, "--poses", poses, "--base-frame", "base"], "--base-frame"),
        ([folder, "--poses", poses, "--out", "o.mcap"], "o.mcap"),
        ([folder, "--poses", poses, "--track", "--fuse"], "--fuse"),
        ([slide, "--fuse"], "--base-frame"),
        ([slide, "--track"], "--base-frame"),
        ([slide, "--drop-outliers"], "--drop-outliers"),
        ([slide, "--verdict-topic", "/object/truth"], "--verdict-topic"),
    ):
        assert_refused(cli("replay", *words, *LOCATED), mentioned)
    assert_refused(cli("live", folder, "--once", "--no-view", "--poses", poses, *LOCATED), "--track")


def test_an_interrupted_replay_is_resumed(cli, slide, monkeypatch):
    from tactile_loc.locate.localizer import Localizer

    whole, calls = Localizer.localize, []

    def interrupted(self, touch, *rest, **options):
        calls.append(touch)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return whole(self, touch, *rest, **options)

    words = ["replay", slide, *LOCATED, "--out", "out.mcap", "--poses-only"]
    with monkeypatch.context() as patch:
        patch.setattr(Localizer, "localize", interrupted)
        done = cli(*words)
    assert (done.exit_code, Path("out.mcap").exists()) == (130, False)
    assert "resume" in done.stderr
    done = succeed(cli(*words))
    assert not missing(done.stdout, 6)
    assert len(decoded("out.mcap", "/object/pose")) == IMAGES - 2
    assert decoded("out.mcap", "/gel/image") == []
    assert sorted(path.name for path in Path().iterdir()) == ["out.csv", "out.json", "out.mcap"]


def test_the_existing_part_of_a_truncated_recording_is_located(cli, slide):
    Path("cut.mcap").write_bytes(slide.read_bytes()[: slide.stat().st_size // 2])
    done = succeed(cli("replay", "cut.mcap", *LOCATED, "--frame", "sensor"))
    assert re.search(r"^warning: .*\bcut\.mcap\b", done.stderr, re.MULTILINE)
    poses = decoded("cut-poses.mcap", "/object/pose")
    assert 0 < len(poses) < IMAGES - 2
    assert {pose.header.frame_id for _, pose in poses} == {"sensor"}


def test_bad_input_is_one_sentence(cli, slide):
    def images(name: str, encoding: str) -> str:
        message = make_image(np.zeros((200, 200), np.uint8), "mono8", 0, "gel")
        message.encoding = encoding
        return str(write_recording(Path(name), lambda w: w.write("/gel/image", IMAGE, message, 0)))

    moving = write_recording(Path("tf.mcap"), lambda w: w.write("/tf", TF, make_transforms({}, 0), 0))
    for words, mentioned in (
        (["none.mcap"], "none.mcap"),
        ([slide, "--image-topic", "/gel/imag"], "'/gel/image'"),
        ([slide, "--base-frame", "bass"], "'bass'"),
        ([slide, "--base-frame", "base", "--frame", "gol"], "'gol'"),
        ([slide, "--pose-topic", "/object/truth"], "/object/truth"),
        ([slide, "--out", slide], slide.name),
        ([slide, "--out", "poses.csv"], "poses.csv"),
        ([moving], "sensor_msgs/msg/Image"),
        ([images("yuv.mcap", "yuv422")], "'yuv422'"),
        ([images("grey.mcap", "mono8")], "--sensor"),
    ):
        assert_refused(cli("replay", *words, *LOCATED), mentioned)
    assert_refused(cli("simulate", *HEAD, "--recording", "slide.bag"), "slide.bag", ".mcap")
    assert_refused(cli("simulate", *HEAD, "--recording", "slide.mcap", "--out", "here"), "--out")
    assert sorted(path.name for path in Path().iterdir()) == ["grey.mcap", "tf.mcap", "yuv.mcap"]
