"""The files of a replay: a recording with the poses, a CSV table, and a JSON file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tactile_loc.io.streams.recordings import RecordingWriter, write_recording
from tactile_loc.io.streams.ros_messages import POSE, RosPose, make_pose
from tactile_loc.locate.results.located_frame import LocatedFrame
from tactile_loc.locate.touch_files import make_pose_cells, write_csv
from tactile_loc.store.files import write_json
from tactile_loc.tasks.replay import Estimator, FrameRecord, Replay, ReplaySummary, require_located
from tactile_loc.tasks.replay_journal import Journal, open_journal

log = logging.getLogger(__name__)

COLUMNS = (
    "number", "stamp_s", "verdict", "frame", "probability", "imprint_iou", "x_mm", "y_mm", "z_mm", "turn_deg", "axis_x",
    "axis_y", "axis_z", "std_mm", "std_deg", "says",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Replayed:
    """The results of a replay, frame by frame, and the files it wrote.

    `resumed` is the number of frames that an earlier, interrupted replay finished.
    """

    records: Sequence[FrameRecord]
    summary: ReplaySummary
    written: tuple[Path, ...]
    resumed: int


def replay_to(
    out: Path,
    replay: Replay,
    frames: int,
    pose_topic: str,
    poses_only: bool = False,
    estimator: Estimator | None = None,
) -> Replayed:
    """Locate each of a recording's `frames` images; write the results to `out`, and .csv and .json files beside it.

    A journal beside `out` keeps the finished frames until all files are written. If the replay is interrupted, the same
    call resumes it, but a tracker then forgets the earlier frames. Raises RecordingError if no frame has a pose, and
    OutputError if a file cannot be written.
    """
    path = out.with_name(f"{out.name}.journal")
    with open_journal(path, replay) as kept:
        if kept.stale:
            log.warning("%s is of another replay or of another version; all images are located again", path)
        resumed = len(kept.records)
        _finish(kept, replay, frames, estimator or (lambda touch: LocatedFrame.of(replay.localizer.localize(touch))))
        summary = ReplaySummary.of(kept.records)
        require_located(replay, kept.records, summary)
        written = (
            write_poses(out, replay, kept.records, pose_topic, poses_only),
            write_table(out.with_suffix(".csv"), kept.records),
            write_summary(out.with_suffix(".json"), replay, summary, kept.records),
        )
        path.unlink()
    return Replayed(tuple(kept.records), summary, written, resumed)


def _finish(kept: Journal, replay: Replay, frames: int, estimator: Estimator) -> None:
    finished = len(kept.records)
    with replay.localizer.progress.task(f"locating the images on {replay.topic.name}", frames) as advance:
        advance(finished)
        for record in replay.frames(estimator, finished):
            kept.append(record)
            advance(1)


def write_poses(
    path: Path, replay: Replay, records: Sequence[FrameRecord], pose_topic: str, alone: bool = False
) -> Path:
    """Write the recording's messages, with each pose after its image, or only the poses if `alone`; return the path.

    A pose has its image's stamp and log time. Raises OutputError.
    """

    def write(writer: RecordingWriter) -> None:
        poses = {record.number: record for record in records if record.T_frame_object is not None}
        number = 0
        for message in replay.recording.read_messages():
            if not alone:
                writer.copy(message)
            if message.topic.name == replay.topic.name:
                if number in poses:
                    _write_pose(writer, pose_topic, poses[number])
                number += 1
        for extra in () if alone else replay.recording.read_extras():
            writer.copy_extra(extra)

    return write_recording(path, write)


def _write_pose(writer: RecordingWriter, pose_topic: str, record: FrameRecord) -> None:
    covariance = None if record.covariance is None else np.array(record.covariance)
    message = make_pose(RosPose.of(record.T, covariance), record.stamp_ns, record.frame)
    writer.write(pose_topic, POSE, message, record.log_time_ns)


def write_table(path: Path, records: Sequence[FrameRecord]) -> Path:
    """Write one row per frame as CSV, in mm and degrees, and return the path. Raises OutputError."""
    return write_csv(path, COLUMNS, map(make_row, records))


def make_row(record: FrameRecord) -> dict[str, str]:
    """Return a frame's row of the table; a standard deviation is the root mean square over the three axes."""
    cells = {
        "number": str(record.number), "stamp_s": f"{record.stamp_ns / 1e9:.9f}", "verdict": record.verdict or "",
        "frame": record.frame, "says": record.says,
    }  # fmt: skip
    if record.T_frame_object is None:
        return cells
    cells |= {"probability": f"{record.probability:.4f}", "imprint_iou": f"{record.imprint_iou:.3f}"}
    cells |= make_pose_cells(record.T)
    if record.covariance is not None:
        variances = np.diag(record.covariance)
        std_m, std_rad = np.sqrt(variances[:3].mean()), np.sqrt(variances[3:].mean())
        cells |= {"std_mm": f"{1e3 * std_m:.3f}", "std_deg": f"{np.degrees(std_rad):.3f}"}
    return cells


def write_summary(path: Path, replay: Replay, summary: ReplaySummary, records: Sequence[FrameRecord]) -> Path:
    """Write the replay's summary and all its frames as JSON in SI units; return the path. Raises OutputError."""
    about = {"recording": str(replay.recording.path), "image_topic": replay.topic.name}
    frames = [record.model_dump(mode="json") for record in records]
    return write_json(path, {**about, **asdict(summary), "poses": frames})
