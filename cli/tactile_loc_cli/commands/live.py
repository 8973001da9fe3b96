"""`tactile-loc live`: locate the object in each frame of a camera, a folder or a video."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError, OutputError, TouchError
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, list_verdicts, say, say_reasons, say_written, warn_of_uncertain
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.io.streams.frame_sources import FrameSource
    from tactile_loc.io.streams.sensor_tracks import SensorTrack
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.tracking.live import LiveLocator, LiveResult, LiveSummary

    Show = Callable[[LiveResult], object]
    Output = AbstractContextManager[Show]

logger = logging.getLogger(__name__)

PORT = 8420

Source = Annotated[
    Path | None,
    typer.Argument(
        metavar="FOLDER|VIDEO", show_default=False, help="A folder that receives images or contact shapes, or a video."
    ),
]
Once = Annotated[
    bool, declare("--once", "Locate every frame already in the folder or video, then exit; not with --camera.")
]
Track = Annotated[
    bool,
    typer.Option(
        "--track/--alone",
        help="Track the object through the frames. The sensor must stand still, or --poses or the files "
        "(T_base_sensor) must give its poses. Default: locate each frame separately.",
    ),
]
Out = Annotated[
    Path | None, declare("--out FILE.jsonl", "Write each result as a line of JSON. Default: write no file.")
]
Port = Annotated[
    int,
    declare("--port N", f"Port of the view on this machine; 0 takes a free one. Default: {PORT}.", show_default=False),
]
View = Annotated[bool, typer.Option("--view/--no-view", help="Show frames and poses on a local web page.")]
Given = Annotated[RunOptions, options.Takes(*options.OF_FRAMES, object=options.TOUCHED)]


@dataclass(frozen=True)
class OfCamera:
    """The camera, and its settings to be fixed."""

    camera: Annotated[
        str | None,
        declare(
            "--camera N", "Use a camera: its number, from 0, its device, such as /dev/video2, or its serial number."
        ),
    ] = None
    exposure: Annotated[
        float | None, declare("--exposure N", "Fix the camera's exposure, in 0.1 ms on Linux. Default: as it is.")
    ] = None
    white_balance: Annotated[
        float | None, declare("--white-balance K", "Fix the camera's white balance, kelvin. Default: as it is.")
    ] = None


def live(
    source: Source = None,
    once: Once = False,
    *,
    chosen: OfCamera,
    given: Given,
    track: Track = False,
    poses: options.SensorPoses = None,
    out: Out = None,
    view: View = True,
    port: Port = PORT,
    rerun: options.Rerun = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Locate an object in each frame as it arrives.

    Frames come from a camera, a folder or a video. A local web page shows the results; --out writes them as lines of
    JSON. If frames arrive faster than they are located, only the newest is used. The command ends with the video or
    with Ctrl-C.
    """
    from tactile_loc.io.streams.cameras import CameraSettings
    from tactile_loc.io.streams.frame_sources import open_source
    from tactile_loc.tracking.live import LiveLocator, LiveSummary
    from tactile_loc.tracking.tracker import Tracker

    settings = options.make_config(given)
    opened = open_source(source, chosen.camera, once, CameraSettings(chosen.exposure, chosen.white_balance))
    options.require_object(settings, opened.about)
    _require_outputs(out, rerun)
    sensor_track = _read_poses(poses, track)
    localizer = options.open_localizer(settings, store)
    tracker = Tracker(localizer, live=not once) if track else None
    locator = LiveLocator(localizer, tracker, sensor_track)
    with ExitStack() as stack:
        shows = [
            stack.enter_context(one) for one in _open_outputs(localizer, opened, out, port if view else None, rerun)
        ]
        _run(locator, opened, shows)
    summary = LiveSummary.of(locator, opened.dropped)
    _report(summary, opened.about)
    written = say_written(path for path in (out, rerun) if path is not None)
    if summary.reasons and sum(count for _, count in summary.reasons) == summary.frames:
        raise TouchError(f"no frame of {opened.about} can be located; first reason: {summary.reasons[0][0]}")
    return {**asdict(summary), "written": written}


def _read_poses(poses: Path | None, track: bool) -> SensorTrack | None:
    """Read the sensor's poses. Raises ConfigError if they have no use."""
    from tactile_loc.io.streams.sensor_tracks import read_sensor_track

    if poses is None:
        return None
    if not track:
        raise ConfigError("--poses places the sensor for a track; give --track, or leave it out")
    return read_sensor_track(poses)


def _require_outputs(out: Path | None, rerun: Path | None) -> None:
    """Raise an error for an output that cannot be written, before anything is built."""
    options.require_rerun(rerun)
    if out is not None and out.suffix.lower() != ".jsonl":
        raise OutputError(f"--out {out.name} must end in .jsonl; choose another name")


def _open_outputs(
    localizer: Localizer, source: FrameSource, out: Path | None, port: int | None, rerun: Path | None
) -> Iterator[Output]:
    """Yield the outputs. Each output is a context manager that returns a function; the function takes each result."""
    if out is not None:
        yield _write_results(out)
    if rerun is not None:
        yield _log_results(localizer, rerun)
    if port is not None:
        yield _show_results(localizer, source.about, port)


@contextmanager
def _write_results(out: Path) -> Iterator[Show]:
    """Write each result as a line of a JSON Lines file."""
    from tactile_loc.store.line_files import open_json_lines

    with open_json_lines(out) as add_line:
        yield lambda result: add_line(json.dumps(result.to_json()))


@contextmanager
def _log_results(localizer: Localizer, path: Path) -> Iterator[Show]:
    """Write results to a Rerun file."""
    from tactile_loc.view.drawn_scene import DrawnScene, DrawnSensor
    from tactile_loc.view.rerun_log import RerunLog

    start_s: list[float] = []
    with RerunLog(path, localizer.scene) as log:

        def show(result: LiveResult) -> None:
            frame = result.frame
            start_s[:] = start_s or [frame.time_s]
            time_s = frame.time_s - start_s[0]
            sensor = DrawnSensor(localizer.scene.geometry, touch=result.touch, image=frame.image)
            log.add(frame.number, time_s, DrawnScene.of_frame(localizer.scene, result.located, sensor))

        yield show


@contextmanager
def _show_results(localizer: Localizer, about: str, port: int) -> Iterator[Show]:
    """Show results on a local web page."""
    from tactile_loc.reports.live_server import LiveServer
    from tactile_loc.reports.live_view import describe_frame, make_live_page, render_shape
    from tactile_loc.reports.page import render

    with LiveServer(render(make_live_page(localizer, about)), port) as server:
        say(f"view: {server.url}")
        sys.stdout.flush()

        def show(result: LiveResult) -> None:
            server.board.show(partial(describe_frame, result, render_shape(result, localizer), localizer))

        yield show


def _run(locator: LiveLocator, source: FrameSource, shows: Sequence[Show]) -> None:
    """Locate frames until the source ends or Ctrl-C is pressed."""
    frames = source.read_frames()
    locator.prepare()
    with suppress(KeyboardInterrupt), closing(frames):
        for frame in frames:
            result = locator.locate(frame, source.dropped)
            for show in shows:
                show(result)
            _log(result)


def _log(result: LiveResult) -> None:
    located = result.located
    if located.verdict is None:
        logger.warning("%s is refused: %s", result.frame.name, located.says)
    logger.info("%s: %s, %.0f ms, %.1f Hz", result.frame.name, located.word, 1e3 * located.seconds, result.rate_hz)


def _report(summary: LiveSummary, about: str) -> None:
    """Write the number of frames by outcome, and the reasons of refusals."""
    say(
        f"{about}: {format_count(summary.frames, 'frame')}: {list_verdicts(asdict(summary))}; {summary.dropped} dropped"
    )
    say_reasons(summary.reasons)
    warn_of_uncertain(asdict(summary))
