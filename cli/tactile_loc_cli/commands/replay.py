"""`tactile-loc replay`: locate the object in each image of a recording."""

from __future__ import annotations

import logging
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.errors import OutputError, RecordingError
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say, say_reasons, say_written
from tactile_loc_cli.options import RunOptions
from tactile_loc_cli.verdict_counts import list_verdicts, warn_of_uncertain

if TYPE_CHECKING:
    from tactile_loc.io.streams.recordings import Contents
    from tactile_loc.tasks.replay_files import Replayed

logger = logging.getLogger(__name__)

RecordingFile = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING", show_default=False,
        help="An MCAP file, a ROS 1 bag (.bag), or the folder of a ROS 2 bag.",
    ),
]  # fmt: skip
ImageTopic = Annotated[
    str | None, options.declare("--image-topic", "TOPIC", "Topic of the images. Default: the only one with images.")
]
PoseTopic = Annotated[str, options.declare("--pose-topic", "TOPIC", "Topic of the written poses.")]
Frame = Annotated[
    str | None,
    options.declare("--frame", "FRAME", "The sensor's frame (z out of the gel). Default: from the images' headers."),
]
BaseFrame = Annotated[
    str | None,
    options.declare("--base-frame", "FRAME", "Write poses in this frame of the recording's TF. Default: the sensor's."),
]
PosesOnly = Annotated[bool, typer.Option("--poses-only", help="Write only the poses, without the recorded messages.")]
Out = Annotated[
    Path | None,
    options.declare("--out", "FILE.mcap", "New recording. Default: RECORDING-poses.mcap in the current folder."),
]
Given = Annotated[
    RunOptions,
    options.Takes(
        "object", "units", "symmetry", "press_depth", "sensor", "grid", "renderer", "encoder", "matcher", "refiner",
        "option", "config", "seed", object=options.TOUCHED,
    ),
]  # fmt: skip


def replay(
    recording: RecordingFile,
    image_topic: ImageTopic = None,
    *,
    given: Given,
    frame: Frame = None,
    base_frame: BaseFrame = None,
    pose_topic: PoseTopic = "/object/pose",
    poses_only: PosesOnly = False,
    out: Out = None,
    rerun: options.Rerun = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Locate an object in each image of a ROS recording.

    ROS is not needed. The new recording has a PoseWithCovarianceStamped for each image with a located object. The poses
    are also written as a table (.csv) and as JSON. After an interruption, the same command resumes.
    """
    from tactile_loc.io.streams.recordings import Recording
    from tactile_loc.io.streams.recordings import choose_image_topic as chosen
    from tactile_loc.tasks.replay import Replay
    from tactile_loc.tasks.replay_files import replay_to

    settings = options.make_config(given)
    options.require_object(settings, str(recording))
    options.require_rerun(rerun)
    out = _choose_out(recording, out)
    recorded = Recording(recording)
    contents = recorded.read_contents()
    topic = chosen(contents, recording, image_topic)
    _require_free(contents, recording, pose_topic, poses_only)
    tree = recorded.read_frame_tree() if base_frame is not None else None
    if tree is not None:
        tree.require(*(name for name in (base_frame, frame) if name is not None))
    if contents.damage:
        logger.warning("%s", contents.damage)
    localizer = options.open_localizer(settings, store)
    asked = Replay(recorded, topic, localizer, frame, base_frame, tree, settings.touch.press_depth_m)
    found = replay_to(out, asked, contents.counts[topic], pose_topic, poses_only)
    if rerun is not None:
        from tactile_loc.drawing.rerun_log import write_replay

        found = replace(found, written=(*found.written, write_replay(rerun, asked, found.records)))
    _report(found, topic.name)
    written = say_written(found.written)
    return {**asdict(found.summary), "resumed": found.resumed, "damage": contents.damage, "written": written}


def _choose_out(recording: Path, out: Path | None) -> Path:
    """Return the path of the new recording. Raises OutputError if the recording cannot be written there."""
    chosen = Path(f"{recording.stem}-poses.mcap") if out is None else out
    options.require_mcap("--out", chosen)
    if chosen.resolve() == recording.resolve():
        raise OutputError(f"{chosen} is the recording to be read; choose another --out")
    if os.path.isdir(chosen):
        raise OutputError(f"{chosen} is a folder; choose another --out")
    require_writable(chosen.parent)
    return chosen


def _require_free(contents: Contents, recording: Path, pose_topic: str, poses_only: bool) -> None:
    """Raise RecordingError if recorded messages would mix with the poses."""
    if not poses_only and pose_topic in {topic.name for topic in contents.counts}:
        raise RecordingError(
            f"{recording} already has messages on {pose_topic}; choose another --pose-topic, or give --poses-only"
        )


def _report(found: Replayed, topic: str) -> None:
    """Write the number of images by outcome, the reasons of refusals, and a warning about jumps of the clock."""
    summary = found.summary
    finished = f"; {found.resumed} of them were already finished" if found.resumed else ""
    say(f"{topic}: {format_count(summary.frames, 'image')}: {list_verdicts(summary)}{finished}")
    warn_of_uncertain(summary)
    if more := say_reasons(summary.reasons):
        say(f"{more} more reasons: see {found.written[1]}")
    if summary.jumps_back:
        logger.warning(
            "the clock of %s jumps back %d times; its images are located in recorded order", topic, summary.jumps_back
        )
