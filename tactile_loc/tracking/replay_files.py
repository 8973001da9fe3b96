"""The files of a replay: a recording with the poses, a CSV table, and a JSON file."""

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.io.streams.recordings import RecordingWriter, write_recording
from tactile_loc.io.streams.ros_messages import POSE, TEXT, RosPose, make_pose, make_text
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.touch_files import make_pose_cells, write_csv
from tactile_loc.store.files import write_json
from tactile_loc.tracking.frame_fusion import RestPose, fuse_frames, track_frames
from tactile_loc.tracking.replay import (
    Estimator,
    FolderReplay,
    Replay,
    ReplayedFrame,
    ReplaySource,
    ReplaySummary,
    estimate,
    require_located,
)
from tactile_loc.tracking.replay_journal import open_journal

log = logging.getLogger(__name__)

COLUMNS = (
    "number",
    "name",
    "stamp_s",
    "verdict",
    "frame",
    "probability",
    "imprint_iou",
    "x_mm",
    "y_mm",
    "z_mm",
    "turn_deg",
    "axis_x",
    "axis_y",
    "axis_z",
    "std_mm",
    "std_deg",
    "says",
)


@dataclass(frozen=True, eq=False)
class Replayed:
    """The results of a replay, frame by frame, and the files it wrote.

    `resumed` is the number of frames that an earlier, interrupted replay finished. `rest` is the fused pose of an
    object at rest, if it was requested.
    """

    records: Sequence[ReplayedFrame]
    summary: ReplaySummary
    written: tuple[Path, ...]
    resumed: int = 0
    rest: RestPose | None = None


@dataclass(frozen=True)
class ReplayOutput:
    """The files of a replay: a recording or, for a folder of images, a table at `path`, and .csv and .json beside it.

    The recording has the poses on `pose_topic` and the verdicts on `verdict_topic`. It also has the recorded messages,
    unless `poses_only`. If a verdict is `required`, poses with another verdict are not written.
    """

    path: Path
    pose_topic: str = "/object/pose"
    verdict_topic: str = "/object/verdict"
    poses_only: bool = False
    required: Verdict | None = None


def locate_each_to(
    out: ReplayOutput, source: ReplaySource, frames: int, estimator: Estimator | None = None
) -> Replayed:
    """Locate each of a source's `frames` images alone, and write the results.

    A journal beside the output keeps the finished frames until all files are written. If the replay is interrupted, the
    same call resumes it. Raises RecordingError if no frame has a pose, and OutputError if a file cannot be written.
    """
    path = out.path.with_name(f"{out.path.name}.journal")
    with open_journal(path, source) as kept:
        if kept.stale:
            log.warning("%s is of another replay or of another version; all images are located again", path)
        resumed = len(kept.records)
        locate = estimator or (lambda touch: LocatedFrame.of(source.localizer.localize(touch)))
        with source.localizer.progress.task(f"locating the {source.about}", frames) as advance:
            advance(resumed)
            for frame in source.read_frames(resumed):
                kept.append(ReplayedFrame.of(frame, estimate(frame, locate)))
                advance(1)
        done = _write(out, source, kept.records)
        path.unlink()
    return replace(done, resumed=resumed)


def track_to(out: ReplayOutput, source: ReplaySource, frames: int) -> Replayed:
    """Follow the object through a source's `frames` images with a tracker, and write the results.

    An interrupted track starts again with the first image. Raises FrameError if the source has no base frame,
    RecordingError if no frame has a pose, and OutputError if a file cannot be written.
    """
    records = []
    with source.localizer.progress.task(f"tracking through the {source.about}", frames) as advance:
        for record in track_frames(source):
            records.append(record)
            advance(1)
    return _write(out, source, records)


def fuse_to(out: ReplayOutput, source: ReplaySource) -> Replayed:
    """Locate an object at rest from a source's images together (`fuse_frames`), and write the results.

    Raises FrameError if the source has no base frame, RecordingError or GridError if the object cannot be located, and
    OutputError if a file cannot be written.
    """
    rest, records = fuse_frames(source)
    return replace(_write(out, source, records, {"rest": rest.describe()}), rest=rest)


def _write(
    out: ReplayOutput, source: ReplaySource, records: Sequence[ReplayedFrame], more: dict[str, Any] | None = None
) -> Replayed:
    """Write the files of a replay."""
    summary = ReplaySummary.of(records)
    require_located(source, records, summary)
    kept = records if out.required is None else [keep_required(record, out.required) for record in records]
    written = [write_poses(out, source, kept)] if isinstance(source, Replay) else []
    written.append(write_table(out.path.with_suffix(".csv"), kept))
    written.append(write_summary(out.path.with_suffix(".json"), source, summary, kept, more or {}))
    return Replayed(tuple(kept), summary, tuple(written))


def keep_required(record: ReplayedFrame, required: Verdict) -> ReplayedFrame:
    """Return a record without its pose, and with the reason, if its verdict is not the required one."""
    located = record.located
    if located.verdict is required or record.T_frame_object is None:
        return record
    says = located.says or f"the verdict is not {required}, which was required"
    without = replace(located, T_sensor_object_modes=np.empty((0, 4, 4)), covariance=None, says=says)
    return replace(record, located=without)


def write_poses(out: ReplayOutput, replay: Replay, records: Sequence[ReplayedFrame]) -> Path:
    """Write the recording's messages, with each pose and verdict after its image; return the path.

    A pose has its image's stamp and log time. Raises OutputError.
    """

    def write(writer: RecordingWriter) -> None:
        number = 0
        for message in replay.recording.read_messages():
            if not out.poses_only:
                writer.copy(message)
            if message.topic.name == replay.topic.name:
                _write_frame(writer, out, records[number])
                number += 1
        for extra in () if out.poses_only else replay.recording.read_extras():
            writer.copy_extra(extra)

    return write_recording(out.path, write)


def _write_frame(writer: RecordingWriter, out: ReplayOutput, record: ReplayedFrame) -> None:
    """Write a frame's pose, if it has one, and its verdict, unless it was refused."""
    T, verdict = record.T_frame_object, record.located.verdict
    if T is not None:
        message = make_pose(RosPose.of(T, record.located.covariance), record.stamp_ns, record.frame)
        writer.write(out.pose_topic, POSE, message, record.log_time_ns)
    if verdict is not None:
        writer.write(out.verdict_topic, TEXT, make_text(verdict), record.log_time_ns)


def write_table(path: Path, records: Sequence[ReplayedFrame]) -> Path:
    """Write one row per frame as CSV, in mm and degrees, and return the path. Raises OutputError."""
    return write_csv(path, COLUMNS, map(make_row, records))


def make_row(record: ReplayedFrame) -> dict[str, str]:
    """Return a frame's row of the table; a standard deviation is the root mean square over the three axes."""
    located, T = record.located, record.T_frame_object
    cells = {
        "number": str(record.number),
        "name": record.name,
        "stamp_s": f"{record.stamp_ns / 1e9:.9f}",
        "verdict": located.verdict or "",
        "frame": record.frame,
        "says": located.says,
    }
    if T is None:
        return cells
    cells |= {"probability": f"{located.probability:.4f}"}
    cells |= {} if np.isnan(located.imprint_iou) else {"imprint_iou": f"{located.imprint_iou:.3f}"}
    cells |= make_pose_cells(T)
    if located.covariance is not None:
        variances = np.diag(located.covariance)
        std_m, std_rad = np.sqrt(variances[:3].mean()), np.sqrt(variances[3:].mean())
        cells |= {"std_mm": f"{1e3 * std_m:.3f}", "std_deg": f"{np.degrees(std_rad):.3f}"}
    return cells


def write_summary(
    path: Path, source: ReplaySource, summary: ReplaySummary, records: Sequence[ReplayedFrame], more: dict[str, Any]
) -> Path:
    """Write the replay's summary, `more`, and all its frames as JSON in SI units; return the path.

    Raises OutputError.
    """
    about = {"folder": str(source.folder)} if isinstance(source, FolderReplay) else {}
    if isinstance(source, Replay):
        about = {"recording": str(source.recording.path), "image_topic": source.topic.name}
    frames = [record.to_json() for record in records]
    return write_json(path, {**about, **asdict(summary), **more, "poses": frames})
