"""A recording, located frame by frame: poses in the sensor's or the base's frame, and other images."""

import csv
import errno
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import missing, naming

from tactile_loc import Localizer, LocatedFrame, Touch, Verdict
from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.runtime.errors import FrameError, GridError, OutputError, RecordingError, StoreError
from tactile_loc.io.config import TouchConfig
from tactile_loc.io.streams.recordings import Recording, RecordingWriter, choose_image_topic, write_recording
from tactile_loc.io.streams.ros_messages import IMAGE, TF, make_image, make_transforms, read_pose, read_stamp_ns
from tactile_loc.plugin.helpers import make_transform, rotation_about
from tactile_loc.tracking.replay import Replay, ReplaySummary
from tactile_loc.tracking.replay_files import Replayed, ReplayOutput, locate_each_to
from tactile_loc.tracking.replay_journal import VERSION, open_journal

S = 1_000_000_000
FIRST, LAST = (make_transform(rotation_about([0, 0, 1], yaw), [x, 0, 0.1]) for x, yaw in ((0.0, 0.0), (0.3, 0.6)))
MOUNT = make_transform(rotation_about([1, 0, 0], 1.0), [0, 0, 0.05])
C = np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4])
NOTHING, UPSIDE_DOWN = np.full((200, 200), 0.002, np.float32), np.full((200, 200), -1.0, np.float32)


def list_json(records):
    return [record.to_json() for record in records]


@pytest.fixture(scope="module")
def touches(localizer) -> list[Touch]:
    return localizer.simulate(3, seed=1)


def write_images(path: Path, images: list[np.ndarray], before=lambda writer: None, stamps_s=range(9)) -> Path:
    def write(writer: RecordingWriter) -> None:
        before(writer)
        for k, (image, stamp_s) in enumerate(zip(images, stamps_s, strict=False)):
            writer.write("/gel/image", IMAGE, make_image(image, "32FC1", stamp_s * S, "gel"), k * S + 5)

    return write_recording(path, write)


@pytest.fixture
def recorded(tmp_path, touches) -> Path:
    """Three touches, then no contact, then an impossible image, then a touch after the last transform."""
    depths = [touch.contact_shape.depth_m for touch in touches]

    def move(writer: RecordingWriter) -> None:
        writer.write("/tf_static", TF, make_transforms({("flange", "gel"): MOUNT}, 0), 0)
        for stamp, T in ((0, FIRST), (4 * S, LAST)):
            writer.write("/tf", TF, make_transforms({("base", "flange"): T}, stamp), stamp)

    return write_images(tmp_path / "drive.mcap", [*depths, NOTHING, UPSIDE_DOWN, depths[0]], move)


def replay_of(path: Path, localizer: Localizer, base: str | None = None, frame: str | None = None) -> Replay:
    recording = Recording(path)
    topic = choose_image_topic(recording.read_contents(), path, None)
    return Replay(recording, topic, localizer, frame, base, recording.read_frame_tree() if base else None)


def replay_to(out: Path, replay: Replay, estimator, poses_only: bool = False) -> Replayed:
    """Locate each of the 6 recorded images with an estimator, and write the results."""
    return locate_each_to(ReplayOutput(out, "/pose", poses_only=poses_only), replay, 6, estimator)


def reading(localizer: Localizer, **touch: Any) -> Localizer:
    """Return the localizer with other settings of a touch."""
    config = localizer.config.model_copy(update={"touch": TouchConfig(**touch)})
    return Localizer(config, localizer.object, localizer.store)


def at_truth(touch: Touch) -> LocatedFrame:
    """An estimator that always returns the same pose and covariance."""
    T = make_transform(rotation_about([1, 1, 0], 0.3), [0.001, 0.002, 0.025])
    return LocatedFrame(Verdict.AMBIGUOUS, T[None], np.array([0.5]), C, 0.9)


T_GEL_OBJECT = at_truth(None).T_sensor_object  # type: ignore[arg-type]


def test_recorded_depths_may_have_another_unit_and_kind(localizer, touches, tmp_path):
    shape = touches[0].contact_shape
    images = {"mm": 1e3 * shape.depth_m, "indentation": shape.press_depth_m - shape.depth_m, "mask": shape.contact}
    for name, image in images.items():
        path = write_images(tmp_path / f"{name}.mcap", [image.astype(np.float32)])
        given = {"unit": "mm"} if name == "mm" else {"kind": name}
        replay = replay_of(path, reading(localizer, press_depth_mm=1e3 * shape.press_depth_m, **given))
        (frame,) = replay.read_frames()
        assert frame.problem is None
        seen = frame.touch.contact_shape
        np.testing.assert_array_equal(seen.contact, shape.contact)
        if name != "mask":
            np.testing.assert_allclose(seen.depth_m, shape.depth_m, atol=1e-9)


def test_the_localizer_finds_the_recorded_touches(recorded, localizer, touches, tmp_path):
    replay = replay_of(recorded, reading(localizer, press_depth_mm=1e3 * touches[0].press_depth_m))
    found = replay_to(tmp_path / "out.mcap", replay, None)
    for record, touch in zip(found.records[:3], touches, strict=True):
        best = localizer.localize(touch).best
        np.testing.assert_allclose(record.T_frame_object, best.T_sensor_object, atol=1e-9)
        assert record.frame == "gel"
    expected = [localizer.localize(touch).verdict for touch in touches]
    verdicts = [record.located.verdict for record in found.records]
    assert verdicts == [*expected, Verdict.NO_CONTACT, None, expected[0]]
    assert not missing(found.records[4].located.says, "-1 m")
    assert found.summary.reasons == ((found.records[4].located.says, 1),)


def test_poses_and_covariances_are_transformed_to_the_base(recorded, localizer, tmp_path):
    out = tmp_path / "out.mcap"
    found = replay_to(out, replay_of(recorded, localizer, "base"), at_truth)
    T_base_flange = make_transform(rotation_about([0, 0, 1], 0.3), [0.15, 0, 0.1])  # at 2 s, halfway
    T_base_gel = T_base_flange @ MOUNT
    (third,) = [m for m in Recording(out).read_messages("/pose") if m.log_time_ns == 2 * S + 5]
    message = third.decode()
    assert (read_stamp_ns(message.header), message.header.frame_id) == (2 * S, "base")
    np.testing.assert_allclose(read_pose(message).T, T_base_gel @ T_GEL_OBJECT, atol=1e-9)
    covariance = np.reshape(read_pose(message).covariance, (6, 6))
    np.testing.assert_allclose(covariance, rotate_covariance(C, T_base_gel[:3, :3]), atol=1e-12)
    assert found.records[5].located.verdict is None  # 5 s is after the last transform
    assert not missing(found.records[5].located.says, "0.000 s", "4.000 s", "5.000 s")


def test_poses_are_written_after_their_images_or_alone(recorded, localizer, tmp_path):
    replay = replay_of(recorded, localizer)
    replay_to(tmp_path / "all.mcap", replay, at_truth)
    replay_to(tmp_path / "alone.mcap", replay, at_truth, poses_only=True)
    before, written, alone = (
        [(m.topic, m.log_time_ns, m.data) for m in Recording(path).read_messages()]
        for path in (recorded, tmp_path / "all.mcap", tmp_path / "alone.mcap")
    )
    poses = [one for one in written if one[0].name == "/pose"]
    verdicts = [one for one in written if one[0].name == "/object/verdict"]
    assert [one for one in written if one not in poses and one not in verdicts] == before
    assert alone == [one for one in written if one in poses or one in verdicts]
    decoded = [m.decode().data for m in Recording(tmp_path / "alone.mcap").read_messages("/object/verdict")]
    assert decoded == ["ambiguous"] * 3 + ["no contact", "ambiguous"]  # the refused image has none
    assert [time for _, time, _ in verdicts] == [5, S + 5, 2 * S + 5, 3 * S + 5, 5 * S + 5]
    assert [time for _, time, _ in poses] == [5, S + 5, 2 * S + 5, 5 * S + 5]
    after = [written[written.index(pose) - 1][:2] for pose in poses]
    assert [(topic.name, time) for topic, time in after] == [("/gel/image", time) for _, time, _ in poses]


def test_an_estimator_that_finds_no_pose_gives_an_error(recorded, localizer, tmp_path):
    def lost(touch: Touch) -> LocatedFrame:
        raise GridError("hopeless")

    with pytest.raises(RecordingError, match=naming(6, "/gel/image", "drive.mcap", "hopeless")):
        replay_to(tmp_path / "out.mcap", replay_of(recorded, localizer), lost)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_missing_frames_give_an_error_at_once(recorded, localizer):
    with pytest.raises(FrameError, match=naming("'gol'", "base", "flange", "'gel'")):
        next(replay_of(recorded, localizer, "base", "gol").frames(at_truth))


@pytest.mark.parametrize(("located", "finished"), [(0, 0), (1, 1), (3, 5)])  # two images need no estimator
def test_finished_frames_are_not_located_again(recorded, localizer, tmp_path, located, finished):
    calls = []

    def counting(touch: Touch) -> LocatedFrame:
        calls.append(touch)
        return at_truth(touch)

    def interrupted(touch: Touch) -> LocatedFrame:
        if len(calls) == located:
            raise KeyboardInterrupt
        return counting(touch)

    out, replay = tmp_path / "out.mcap", replay_of(recorded, localizer)
    whole = replay_to(tmp_path / "whole.mcap", replay, at_truth)
    with pytest.raises(KeyboardInterrupt):
        replay_to(out, replay, interrupted)
    assert not out.exists()
    found = replay_to(out, replay, counting)
    assert (found.resumed, len(calls)) == (finished, 4)
    assert list_json(found.records) == list_json(whole.records)
    assert out.read_bytes() == (tmp_path / "whole.mcap").read_bytes()
    assert not list(tmp_path.glob("*.journal"))


def test_a_frame_that_failed_with_a_full_store_is_tried_again(recorded, localizer, tmp_path):
    estimates = iter([at_truth])

    def starved(touch: Touch) -> LocatedFrame:
        for estimate in estimates:
            return estimate(touch)
        raise StoreError("full")

    out, replay = tmp_path / "out.mcap", replay_of(recorded, localizer)
    with pytest.raises(StoreError, match="full"):
        replay_to(out, replay, starved)
    found = replay_to(out, replay, at_truth)
    assert (found.resumed, found.summary.located) == (1, 4)


def test_a_truncated_journal_keeps_its_complete_lines(recorded, localizer, tmp_path):
    replay, path = replay_of(recorded, localizer), tmp_path / "out.mcap.journal"
    with open_journal(path, replay) as kept:
        for record in replay.frames(at_truth):
            kept.append(record)
    data = path.read_bytes()
    for length in {0, 5, data.index(b"\n"), *range(data.index(b"\n") + 1, len(data), 97), len(data)}:
        path.write_bytes(data[:length])
        with open_journal(path, replay) as found:
            assert list_json(found.records) == list_json(kept.records[: len(found.records)])
            assert len(found.records) == max(0, data[:length].count(b"\n") - 1)
        assert not found.records or data.startswith(path.read_bytes())


def test_a_full_disk_leaves_a_journal_of_complete_lines(recorded, localizer, tmp_path, monkeypatch):
    replay, path, write = replay_of(recorded, localizer), tmp_path / "out.mcap.journal", os.write

    def full(descriptor: int, text: bytes) -> int:
        if len(text) > 9:
            return write(descriptor, text[:-9])
        raise OSError(errno.ENOSPC, "ENOSPC")

    with open_journal(path, replay) as kept, monkeypatch.context() as patch:
        first, second, *_ = replay.frames(at_truth)
        kept.append(first)
        before = path.read_bytes()
        patch.setattr(os, "write", full)
        with pytest.raises(OutputError, match=naming("out.mcap.journal", "ENOSPC", "`out`")):
            kept.append(second)
        assert path.read_bytes() == before
        assert list_json(kept.records) == list_json([first])


@pytest.mark.parametrize(("base", "version", "reason"), [("base", VERSION, ""), (None, 1, "another version")])
def test_the_journal_of_another_replay_or_version_is_replaced(
    recorded, localizer, tmp_path, monkeypatch, caplog, base, version, reason
):
    replay, path = replay_of(recorded, localizer), tmp_path / "out.mcap.journal"
    with monkeypatch.context() as patch:
        patch.setattr("tactile_loc.tracking.replay_journal.VERSION", version)
        with open_journal(path, replay) as kept:
            kept.append(next(replay.frames(at_truth)))
    found = replay_to(tmp_path / "out.mcap", replay_of(recorded, localizer, base), at_truth)
    assert found.resumed == 0
    assert len(caplog.records) == 1
    assert not missing(caplog.text, path, reason)


def test_frames_that_are_not_found_are_counted_separately(recorded, localizer, tmp_path):
    """A pose that the search probably missed is still written; a touch without a pose has a row with the reason."""
    calls = []

    def find_little(touch: Touch) -> LocatedFrame:
        calls.append(touch)
        if len(calls) == 1:
            raise GridError("hopeless")
        return replace(at_truth(touch), verdict=Verdict.NOT_FOUND)

    found = replay_to(tmp_path / "out.mcap", replay_of(recorded, localizer), find_little)
    summary = found.summary
    assert (summary.located, summary.not_found, summary.no_contact, summary.refused) == (0, 4, 1, 1)
    assert [record.T_frame_object is not None for record in found.records] == [False, True, True, False, False, True]
    rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
    assert [row["verdict"] for row in rows] == ["not found"] * 3 + ["no contact", "", "not found"]
    assert rows[0]["says"] == "hopeless"


def test_two_processes_cannot_write_the_same_journal(recorded, localizer, tmp_path):
    replay, path = replay_of(recorded, localizer), tmp_path / "out.mcap.journal"
    refused = pytest.raises(OutputError, match=naming("process", "out.mcap.journal", "`out`"))
    with open_journal(path, replay), refused, open_journal(path, replay):
        pass


def test_backward_steps_of_the_clock_are_counted(tmp_path, localizer, touches):
    images = [touches[0].contact_shape.depth_m] * 4
    path = write_images(tmp_path / "drive.mcap", images, stamps_s=(10, 11, 2, 3))
    records = list(replay_of(path, localizer).frames(at_truth))
    assert [record.stamp_ns for record in records] == [10 * S, 11 * S, 2 * S, 3 * S]
    assert ReplaySummary.of(records).jumps_back == 1


def test_only_poses_with_the_required_verdict_are_written(recorded, localizer, tmp_path):
    verdicts = iter([Verdict.CERTAIN, Verdict.AMBIGUOUS, Verdict.POOR_FIT, Verdict.CERTAIN])

    def judged(touch: Touch) -> LocatedFrame:
        return replace(at_truth(touch), verdict=next(verdicts))

    out = ReplayOutput(tmp_path / "out.mcap", "/pose", poses_only=True, required=Verdict.CERTAIN)
    found = locate_each_to(out, replay_of(recorded, localizer), 6, judged)
    assert [record.T_frame_object is not None for record in found.records] == [True, False, False, False, False, True]
    assert found.records[1].located.verdict is Verdict.AMBIGUOUS
    assert not missing(found.records[1].located.says, "certain")
    assert (found.summary.certain, found.summary.ambiguous, found.summary.poor_fit) == (2, 1, 1)
    assert len(list(Recording(out.path).read_messages("/pose"))) == 2
    assert len(list(Recording(out.path).read_messages("/object/verdict"))) == 5
    rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
    assert [bool(row["x_mm"]) for row in rows] == [True, False, False, False, False, True]
