"""`tactile-loc replay`: locate the object in each image of a recording, or of a folder with sensor poses."""

from __future__ import annotations

import logging
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError, OutputError, RecordingError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.store.files import require_writable, shorten_name
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, list_verdicts, say, say_reasons, say_written, warn_of_uncertain
from tactile_loc_cli.failures import NOT_AS_REQUIRED, Finding
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.io.config import RunConfig
    from tactile_loc.io.streams.recordings import Contents
    from tactile_loc.tracking.frame_fusion import RestPose
    from tactile_loc.tracking.replay import ReplaySource
    from tactile_loc.tracking.replay_files import Replayed, ReplayOutput

logger = logging.getLogger(__name__)

SCATTER_MM = 2.0  # poses that scatter more give a hint that an object at rest can be located better

Source = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING|FOLDER",
        show_default=False,
        help="An MCAP file, a ROS 1 bag (.bag), or the folder of a ROS 2 bag. With --poses: a folder of images or "
        "contact shapes.",
    ),
]
PoseTopic = Annotated[str, declare("--pose-topic TOPIC", "Topic of the written poses.")]
VerdictTopic = Annotated[str, declare("--verdict-topic TOPIC", "Topic of the written verdicts.")]
Track = Annotated[
    bool, declare("--track", "Track the object through the images. Default: locate each image separately.")
]
Fuse = Annotated[bool, declare("--fuse", "The object is at rest: locate touches together, and write one pose.")]
Require = Annotated[
    options.Required | None,
    declare("--require", "Write only poses with this verdict. End with exit code 3 if no pose has it."),
]
PosesOnly = Annotated[bool, declare("--poses-only", "Write only the poses, without the recorded messages.")]
Out = Annotated[
    Path | None,
    declare(
        "--out FILE.mcap|FILE.csv",
        "New recording; with --poses, a table. Default: RECORDING-poses.mcap or FOLDER-poses.csv, in this folder.",
    ),
]
Given = Annotated[
    RunOptions,
    options.Takes(
        *options.OF_FRAMES,
        "drop_outliers",
        object=options.TOUCHED,
        drop_outliers="With --fuse: leave out a touch that contradicts all others.",
    ),
]


@dataclass(frozen=True)
class OfRecording:
    """The options that a recording needs, and a folder of images does not take."""

    image_topic: Annotated[
        str | None, declare("--image-topic TOPIC", "Topic of the images. Default: the only one with images.")
    ] = None
    frame: Annotated[
        str | None,
        declare("--frame FRAME", "The sensor's frame (z out of the gel). Default: from the images' headers."),
    ] = None
    base_frame: Annotated[
        str | None,
        declare("--base-frame FRAME", "Write poses in this frame of the recording's TF. Default: the sensor's."),
    ] = None


def replay(
    recording: Source,
    *,
    given: Given,
    chosen: OfRecording,
    poses: options.SensorPoses = None,
    track: Track = False,
    fuse: Fuse = False,
    require: Require = None,
    pose_topic: PoseTopic = "/object/pose",
    verdict_topic: VerdictTopic = "/object/verdict",
    poses_only: PosesOnly = False,
    out: Out = None,
    rerun: options.Rerun = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Locate an object in each image of a ROS recording, or of a folder.

    ROS is not needed. The new recording has a PoseWithCovarianceStamped for each image with a located object, and each
    image's verdict. The poses are also written as a table (.csv) and as JSON. After an interruption, the same command
    resumes; a track or a fused pose starts again.
    """
    from tactile_loc.locate.result.verdict import Verdict
    from tactile_loc.tracking.replay_files import ReplayOutput

    settings = options.make_config(given)
    options.require_object(settings, str(recording))
    options.require_rerun(rerun)
    _require_one_way(track, fuse, poses is not None or chosen.base_frame is not None)
    if given.drop_outliers and not fuse:
        raise ConfigError("--drop-outliers needs touches that are located together; give --fuse, or leave it out")
    written = ReplayOutput(
        _choose_out(recording, out, poses is not None),
        pose_topic,
        verdict_topic,
        poses_only,
        None if require is None else Verdict(require.value),
    )
    opened = (
        _open_recording(settings, recording, chosen, written, store)
        if poses is None
        else _open_folder(settings, recording, poses, chosen, store)
    )
    found = _locate(opened, written, track, fuse)
    if rerun is not None:
        from tactile_loc.view.rerun_log import write_replay

        found = replace(found, written=(*found.written, write_replay(rerun, opened.source, found.records)))
    _report(found, opened)
    result = {
        **asdict(found.summary),
        "resumed": found.resumed,
        "damage": opened.damage,
        "rest": None if found.rest is None else found.rest.describe(),
        "written": say_written(found.written),
    }
    if written.required is not None and all(record.T_frame_object is None for record in found.records):
        raise Finding(NOT_AS_REQUIRED, result)
    return result


@dataclass(frozen=True)
class _Opened:
    """Images to locate: their source, their number, and the damage of the recording, if any."""

    source: ReplaySource
    images: int
    damage: str = ""


def _require_one_way(track: bool, fuse: bool, has_base: bool) -> None:
    """Raise ConfigError unless the options say in one way how to use the images together."""
    if track and fuse:
        raise ConfigError("--track follows an object that moves, and --fuse locates one at rest; give one of them")
    if (track or fuse) and not has_base:
        flag = "--track" if track else "--fuse"
        raise ConfigError(f"{flag} needs the sensor's poses; give --base-frame, or --poses with a folder of images")


def _choose_out(recording: Path, out: Path | None, is_folder: bool) -> Path:
    """Return the path of the new recording or table. Raises OutputError if it cannot be written there."""
    name = recording.resolve().name
    default = f"{shorten_name(name)}-poses.csv" if is_folder else f"{shorten_name(recording.stem)}-poses.mcap"
    chosen = Path(default) if out is None else out
    if not is_folder:
        options.require_mcap("--out", chosen)
    elif chosen.suffix.lower() != ".csv":
        raise OutputError(f"--out {chosen.name} must end in .csv for a folder of images; choose another name")
    if chosen.resolve() == recording.resolve():
        raise OutputError(f"{chosen} is the recording to be read; choose another --out")
    if os.path.isdir(chosen):
        raise OutputError(f"{chosen} is a folder; choose another --out")
    require_writable(chosen.parent)
    return chosen


def _open_recording(
    settings: RunConfig, recording: Path, chosen: OfRecording, out: ReplayOutput, store: Path | None
) -> _Opened:
    """Open the images of a recording. Raises TactileLocError for bad input."""
    from tactile_loc.io.streams.recordings import Recording, choose_image_topic
    from tactile_loc.tracking.replay import Replay

    recorded = Recording(recording)
    contents = recorded.read_contents()
    topic = choose_image_topic(contents, recording, chosen.image_topic)
    frame, base_frame = chosen.frame, chosen.base_frame
    _require_free(contents, recording, out)
    tree = recorded.read_frame_tree() if base_frame is not None else None
    if tree is not None:
        tree.require(*(name for name in (base_frame, frame) if name is not None))
    if contents.damage:
        logger.warning("%s", contents.damage)
    localizer = options.open_localizer(settings, store)
    source = Replay(recorded, topic, localizer, frame, base_frame, tree)
    return _Opened(source, contents.counts[topic], contents.damage)


def _open_folder(
    settings: RunConfig, folder: Path, poses: Path, of_recording: OfRecording, store: Path | None
) -> _Opened:
    """Open the images of a folder. Raises TactileLocError for bad input."""
    from tactile_loc.io.streams.sensor_tracks import read_sensor_track
    from tactile_loc.tracking.replay import FolderReplay

    for name, given in vars(of_recording).items():
        if given is not None:
            raise ConfigError(f"--{name.replace('_', '-')} is for a recording; leave it out")
    sensor_track = read_sensor_track(poses)
    source = FolderReplay(folder, sensor_track, options.open_localizer(settings, store))
    return _Opened(source, len(source.images))


def _locate(opened: _Opened, out: ReplayOutput, track: bool, fuse: bool) -> Replayed:
    from tactile_loc.tracking.replay_files import fuse_to, locate_each_to, track_to

    if fuse:
        return fuse_to(out, opened.source)
    return track_to(out, opened.source, opened.images) if track else locate_each_to(out, opened.source, opened.images)


def _require_free(contents: Contents, recording: Path, out: ReplayOutput) -> None:
    """Raise RecordingError if recorded messages would mix with the poses or verdicts."""
    names = {topic.name for topic in contents.counts}
    for flag, topic in (("--pose-topic", out.pose_topic), ("--verdict-topic", out.verdict_topic)):
        if not out.poses_only and topic in names:
            raise RecordingError(
                f"{recording} already has messages on {topic}; choose another {flag}, or give --poses-only"
            )


def _report(found: Replayed, opened: _Opened) -> None:
    """Write the number of images by outcome, the fused pose, and the reasons of refusals; warn of doubtful results."""
    from tactile_loc.tracking.frame_fusion import measure_scatter_m

    summary, about = found.summary, opened.source.about
    finished = f"; {found.resumed} of them were already finished" if found.resumed else ""
    say(f"{about}: {format_count(summary.frames, 'image')}: {list_verdicts(asdict(summary))}{finished}")
    if found.rest is not None:
        _say_rest(found.rest)
    warn_of_uncertain(asdict(summary))
    if more := say_reasons(summary.reasons):
        say(f"{more} more reasons: see {found.written[1]}")
    scatter_mm = 1e3 * measure_scatter_m(found.records)
    if opened.source.has_base and scatter_mm > SCATTER_MM:
        logger.warning(
            "the poses scatter by %.1f mm in the base frame; if the object is at rest, give --fuse", scatter_mm
        )
    if summary.jumps_back:
        logger.warning(
            "the clock of the %s jumps back %d times; they are used in recorded order", about, summary.jumps_back
        )


def _say_rest(rest: RestPose) -> None:
    """Write the pose of an object at rest: verdict, pose, probability, and share of the touches that it explains."""
    from tactile_loc.core.geometry.pose_words import format_pose_words
    from tactile_loc.locate.result.verdict import explain_verdict

    words = format_pose_words(rest.T_base_object, rest.std)
    say(f"{rest.verdict}: {explain_verdict(rest.verdict)}")
    error = "" if rest.std is None else f", std {words.place_std} mm and {words.turn_std} about x, y, z"
    say(f"the object at rest: x, y, z {words.place} mm, rotated {words.turn} about {words.axis}, in the base{error}")
    say(
        f"from {format_count(len(rest.numbers), 'touch')} together, probability {format_percent(rest.probability)}; "
        f"the pose explains {format_percent(rest.explained)} of {format_count(len(rest.imprint_ious), 'touch')}"
    )
