"""Live frames: located, tracked, without contact or refused, each with a record."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from message_helpers import missing

from tactile_loc import Localizer, LocatedFrame, Touch, Tracker, Verdict, read_sensor_track, write_touch
from tactile_loc.io.json_keys import read_keys
from tactile_loc.io.streams.frame_sources import ImageFolder, SourceFrame
from tactile_loc.plugin import GridError, TouchError
from tactile_loc.plugin.helpers import make_translation
from tactile_loc.tracking.live import LIVE, LiveLocator, LiveSummary

NOTHING = np.full((200, 200), 0.002, np.float32)


@pytest.fixture(scope="module")
def touch(localizer) -> Touch:
    return localizer.simulate(1, seed=1)[0]


def frames_of(folder: Path, *touches: Touch | None) -> list[SourceFrame]:
    """Frames of files: touches, and None for no contact."""
    folder.mkdir()
    for k, touch in enumerate(touches):
        if touch is None:
            np.savez(folder / f"{k}.npz", depth=NOTHING, unit="m", press_depth=0.001)
        else:
            write_touch(folder / f"{k}.npz", touch)
    return list(ImageFolder(folder, every=True).read_frames())


def started(localizer: Localizer, T_base_object: np.ndarray) -> Tracker:
    tracker = Tracker(localizer)
    tracker.start(T_base_object, np.diag([1e-4**2] * 3 + [1e-2**2] * 3))
    return tracker


def require_position(located: LocatedFrame, expected_m: np.ndarray) -> None:
    np.testing.assert_allclose(np.array(located.T_sensor_object)[:3, 3], expected_m, atol=5e-4)


def test_a_frame_is_located_like_its_touch(localizer, touch, tmp_path):
    (frame,) = frames_of(tmp_path / "in", touch)
    result = LiveLocator(localizer).locate(frame, dropped=4)
    expected = localizer.localize(touch)
    best = expected.best
    record, document = result.located, json.loads(json.dumps(result.to_json()))
    assert (record.verdict, record.says) == (expected.verdict, "")
    assert read_keys(LIVE, document) == document
    assert (document["number"], document["name"], document["dropped"]) == (0, "0.npz", 4)
    np.testing.assert_allclose(record.T_sensor_object, best.T_sensor_object, atol=1e-6)
    assert record.probability == pytest.approx(best.probability, abs=1e-3)
    np.testing.assert_allclose(record.std, np.sqrt(np.diag(best.refined.covariance)), rtol=1e-3)
    assert len(result.located.T_sensor_object_modes) == len(result.located.probabilities) > 1


def test_frames_without_contact_are_reported_and_unreadable_frames_refused(localizer, touch, tmp_path):
    frames = frames_of(tmp_path / "in", touch, None)
    damaged = replace(frames[0], problem=TouchError("it is\ndamaged"))
    wrong = SourceFrame(3, 0.0, "photo", np.zeros((200, 200, 3), np.uint8))
    locator = LiveLocator(localizer)
    records = [locator.locate(frame).located for frame in (*frames, damaged, wrong)]
    assert [record.verdict for record in records[1:]] == [Verdict.NO_CONTACT, None, None]
    assert records[0].verdict is localizer.localize(touch).verdict
    assert [record.word for record in records[1:]] == ["no contact", "refused", "refused"]
    assert "mm" in records[1].says
    assert records[2].says == "it is damaged"
    assert "`sensor`" in records[3].says
    assert all(record.T_sensor_object is None for record in records[1:])
    summary = LiveSummary.of(locator, dropped=7)
    assert (summary.frames, summary.located, summary.no_contact, summary.refused, summary.dropped) == (4, 1, 1, 2, 7)
    assert {reason for reason, _ in summary.reasons} == {records[2].says, records[3].says}


def test_a_touch_that_fits_no_pose_is_not_found_with_a_reason(localizer, touch, tmp_path, monkeypatch):
    def fail(self, touch):
        raise GridError("no pose explains the touch")

    monkeypatch.setattr(type(localizer), "localize", fail)
    (frame,) = frames_of(tmp_path / "in", touch)
    locator = LiveLocator(localizer)
    record = locator.locate(frame).located
    assert (record.verdict, record.says) == (Verdict.NOT_FOUND, "no pose explains the touch")
    summary = LiveSummary.of(locator, dropped=0)
    assert (summary.located, summary.not_found, summary.refused) == (0, 1, 0)
    assert summary.reasons == (("no pose explains the touch", 1),)


def test_the_rate_is_the_rate_of_the_last_frames(localizer, tmp_path, monkeypatch):
    (frame,) = frames_of(tmp_path / "in", None)
    clock = iter(np.arange(0, 100, 0.05))  # each frame reads the clock twice
    monkeypatch.setattr("tactile_loc.tracking.live.time.perf_counter", lambda: next(clock))
    locator = LiveLocator(localizer)
    assert [locator.locate(frame).rate_hz for _ in range(3)] == pytest.approx([0, 10, 10])


def test_a_static_object_is_tracked_and_predicted_without_contact(localizer, touch, tmp_path):
    """The track begins at the truth, so that no search is needed."""
    tracker = started(localizer, touch.T_sensor_object)
    locator = LiveLocator(localizer, tracker)
    seen, times_s = frames_of(tmp_path / "in", touch, touch, None, touch), (5.0, 5.1, 5.05, 5.2)
    frames = [replace(frame, time_s=time_s) for frame, time_s in zip(seen, times_s, strict=True)]
    results = [locator.locate(frame) for frame in frames]
    assert [result.located.verdict for result in results] == ["certain", "certain", "no contact", "certain"]
    for result in results:
        require_position(result.located, touch.T_sensor_object[:3, 3])
    without = results[2].located
    assert np.isnan(without.imprint_iou)
    assert "mm" in without.says
    assert (without.std > results[1].located.std * 0.99).all()


def test_a_track_uses_the_sensor_poses_of_a_csv_file(localizer, touch, tmp_path):
    """A frame without a row is refused, and the others follow the sensor."""
    frames = frames_of(tmp_path / "in", touch, None, touch)
    (tmp_path / "poses.csv").write_text(
        "file,x_mm,y_mm,z_mm,qx,qy,qz,qw\n0.npz,100,0,200,0,0,0,1\n1.npz,100,0,210,0,0,0,1\n"
    )
    T = make_translation([0.1, 0.0, 0.2])
    tracker = started(localizer, T @ touch.T_sensor_object)
    locator = LiveLocator(localizer, tracker, sensor_track=read_sensor_track(tmp_path / "poses.csv"))
    records = [locator.locate(frame).located for frame in frames]
    assert [record.verdict for record in records] == [Verdict.CERTAIN, Verdict.NO_CONTACT, None]
    require_position(records[0], touch.T_sensor_object[:3, 3])
    require_position(records[1], touch.T_sensor_object[:3, 3] - [0.0, 0.0, 0.01])
    assert not missing(records[2].says, "2.npz", "poses.csv")


def test_a_track_uses_the_sensor_poses_in_the_files(localizer, touch, tmp_path):
    """If the sensor moves with the object, the touch stays equal and the pose in the base frame changes."""
    T = make_translation([0.1, 0.0, 0.2])
    (frame,) = frames_of(tmp_path / "in", replace(touch, T_base_sensor=T))
    tracker = started(localizer, T @ touch.T_sensor_object)
    record = LiveLocator(localizer, tracker).locate(frame).located
    assert record.verdict is Verdict.CERTAIN
    require_position(record, touch.T_sensor_object[:3, 3])
