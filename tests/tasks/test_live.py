"""Frames as they come: located, tracked, without contact or refused, each with a record that says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactile_loc.core.errors import TouchError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.frame_sources import ImageFolder, SourceFrame
from tactile_loc.io.touches import write_touch
from tactile_loc.tasks.live import FrameState, LiveLocator, LiveRecord, LiveSummary
from tactile_loc.tasks.tracker import Tracker

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


def test_a_frame_is_located_as_its_touch_is(localizer, touch, tmp_path):
    (frame,) = frames_of(tmp_path / "in", touch)
    result = LiveLocator(localizer).located(frame, dropped=4)
    best = localizer.localize(touch).best
    record = result.record
    assert (record.state, record.name, record.dropped, record.says) == ("located", "0.npz", 4, "")
    np.testing.assert_allclose(record.T_sensor_object, best.T_sensor_object, atol=1e-6)
    assert record.probability == pytest.approx(best.probability, abs=1e-3)
    np.testing.assert_allclose(record.std, np.sqrt(np.diag(best.refined.covariance)), rtol=1e-3)
    assert LiveRecord.model_validate_json(record.model_dump_json()) == record
    assert len(result.estimate.T_sensors_object) == len(result.estimate.probabilities) > 1


def test_no_contact_is_said_and_what_cannot_be_read_is_refused(localizer, touch, tmp_path):
    frames = frames_of(tmp_path / "in", touch, None)
    damaged = replace(frames[0], problem=TouchError("it is\ndamaged"))
    wrong = SourceFrame(3, 0.0, "photo", np.zeros((200, 200, 3), np.uint8))
    locator = LiveLocator(localizer)
    records = [locator.located(frame).record for frame in (*frames, damaged, wrong)]
    assert [record.state for record in records] == ["located", "no contact", "refused", "refused"]
    assert "mm" in records[1].says
    assert records[2].says == "it is damaged"
    assert "--sensor" in records[3].says
    assert all(record.T_sensor_object is None for record in records[1:])
    summary = LiveSummary.of(locator, dropped=7)
    assert (summary.frames, summary.located, summary.no_contact, summary.refused, summary.dropped) == (4, 1, 1, 2, 7)
    assert {reason for reason, _ in summary.reasons} == {records[2].says, records[3].says}


def test_the_rate_is_that_of_the_last_frames(localizer, tmp_path, monkeypatch):
    (frame,) = frames_of(tmp_path / "in", None)
    clock = iter(np.arange(0, 100, 0.05))  # each frame asks it twice
    monkeypatch.setattr("tactile_loc.tasks.live.time.perf_counter", lambda: next(clock))
    locator = LiveLocator(localizer)
    assert [locator.located(frame).rate_hz for _ in range(3)] == pytest.approx([0, 10, 10])


def test_at_rest_one_pose_is_tracked_and_predicted_without_contact(localizer, touch, tmp_path):
    """The track begins at the truth, so that nothing needs to be searched for."""
    tracker = Tracker(localizer)
    tracker.start(touch.T_sensor_object, np.diag([1e-4**2] * 3 + [1e-2**2] * 3))
    locator = LiveLocator(localizer, tracker)
    frames = [replace(frame, time_s=t) for frame, t in zip(frames_of(tmp_path / "in", touch, touch, None, touch),
                                                           (5.0, 5.1, 5.05, 5.2), strict=True)]  # fmt: skip
    results = [locator.located(frame) for frame in frames]
    assert [result.record.state for result in results] == ["tracking", "tracking", "no contact", "tracking"]
    for result in results:
        np.testing.assert_allclose(
            np.array(result.record.T_sensor_object)[:3, 3], touch.T_sensor_object[:3, 3], atol=5e-4
        )
    without = results[2].record
    assert without.imprint_iou is None
    assert "mm" in without.says
    assert (without.std > results[1].record.std * 0.99).all()


def test_a_track_goes_where_files_say_that_the_sensor_was(localizer, touch, tmp_path):
    """The same place of the object, touched by a sensor that moved with it, is another place in the base frame."""
    T = np.eye(4)
    T[:3, 3] = [0.1, 0.0, 0.2]
    (frame,) = frames_of(tmp_path / "in", replace(touch, T_base_sensor=T))
    tracker = Tracker(localizer)
    tracker.start(T @ touch.T_sensor_object, np.diag([1e-4**2] * 3 + [1e-2**2] * 3))
    record = LiveLocator(localizer, tracker).located(frame).record
    assert record.state is FrameState.TRACKING
    np.testing.assert_allclose(np.array(record.T_sensor_object)[:3, 3], touch.T_sensor_object[:3, 3], atol=5e-4)
