"""Replay of a recording, or of a folder of images with the sensor's poses: the images are located in order."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.runtime.errors import (
    FrameError,
    NoContactError,
    RecordingError,
    SourceError,
    StoreError,
    TactileLocError,
)
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.json_keys import Key, Keys, read_keys, write_keys
from tactile_loc.io.streams.recordings import Message, Recording
from tactile_loc.io.streams.ros_messages import Topic, decode_image, read_stamp_ns
from tactile_loc.io.streams.sensor_tracks import SensorTrack, read_time_s
from tactile_loc.io.touches import list_touches, read_touch, touch_from_image
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.located_frame import LOCATED, LocatedFrame, count_frames
from tactile_loc.locate.result.verdict import Verdict, explain_verdict

log = logging.getLogger(__name__)

Estimator = Callable[[Touch], LocatedFrame]  # locates a touch with a localizer or a tracker


REPLAYED: Keys = {  # one image in the files of a replay, in SI units
    "number": Key("integer", "number of the image on its topic or in its folder, from 0"),
    **LOCATED,
    "name": Key("text", "the image's file; empty for a recording"),
    "stamp_ns": Key("integer", "the image's stamp, ns"),
    "log_time_ns": Key("integer", "when the image was logged, ns"),
    "frame": Key("text", "the frame that the pose is in"),
    "T_frame_object": Key("4 x 4 numbers or null", "the object's pose in it, m"),
}


@dataclass(frozen=True, eq=False)
class ReplayedFrame:
    """The result of one image of a replay. `located` has poses in the frame with the name `frame`, not the sensor's.

    `number` counts the images from 0. `name` is the image's file; it is empty for a recording.
    """

    number: int
    stamp_ns: int
    log_time_ns: int
    frame: str
    located: LocatedFrame
    name: str = ""

    @classmethod
    def of(cls, image: ReplayFrame, located: LocatedFrame) -> ReplayedFrame:
        """Make the result of an image from its result in the sensor's frame."""
        moved = located if image.T_base_sensor is None else located.view_from(image.T_base_sensor)
        return cls(image.number, image.stamp_ns, image.log_time_ns, image.frame, moved, show_name(image.name))

    @property
    def T_frame_object(self) -> NDArray[np.float64] | None:  # noqa: N802 - the transform's name
        """The object's pose (4, 4), metres, in `frame`; None if there is no pose."""
        return self.located.T_sensor_object

    def to_json(self) -> dict[str, Any]:
        """Return the values of REPLAYED, as JSON values."""
        return write_keys(REPLAYED, self, **self.located.to_json())

    @classmethod
    def of_json(cls, document: Any) -> ReplayedFrame:
        """Make a result from the values of REPLAYED. Raises ValueError."""
        values = read_keys(REPLAYED, document)
        located = LocatedFrame.of_json(values, values["T_frame_object"])
        return cls(
            values["number"], values["stamp_ns"], values["log_time_ns"], values["frame"], located, values["name"]
        )


@dataclass(frozen=True, eq=False)
class ReplayFrame:
    """One image of a replay and its touch, or the `problem` because of which it has no touch.

    `number` counts the images from 0. `name` is the image's file; it is empty for a recording. Poses are reported in
    `frame`. `T_base_sensor` (4, 4), metres, is the sensor's pose in it; None if `frame` is the sensor's, or if the pose
    is unknown. `image` is (H, W, 3) or (H, W).
    """

    number: int
    stamp_ns: int
    log_time_ns: int
    frame: str
    name: str = ""
    T_base_sensor: NDArray[np.float64] | None = None
    image: NDArray[Any] | None = None
    touch: Touch | None = None
    problem: TactileLocError | None = None


@dataclass(frozen=True, eq=False)
class Replay:
    """Locates the images on a `topic` of a recording with a localizer's sensor.

    Poses are in `frame`, by default the frame named in each image's header. With `base_frame`, poses are transformed to
    the base frame by `frame_tree` (see `read_frame_tree`). The localizer's configuration of a touch gives the unit, the
    kind and the press depth of depths.
    """

    recording: Recording
    topic: Topic
    localizer: Localizer
    frame: str | None = None
    base_frame: str | None = None
    frame_tree: FrameTree | None = None

    @property
    def about(self) -> str:
        """The images in words."""
        return f"images on {self.topic.name} in {self.recording.path}"

    @property
    def has_base(self) -> bool:
        """Whether poses are in a base frame."""
        return self.base_frame is not None and self.frame_tree is not None

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the frames except the localizer, as JSON values."""
        return {
            "recording": identify_files(self.recording.path),
            "topic": self.topic.name,
            "frame": self.frame,
            "base_frame": self.base_frame,
        }

    def frames(self, estimator: Estimator, first: int = 0) -> Iterator[ReplayedFrame]:
        """Yield the results of the images from number `first` on.

        Raises RecordingError for images that cannot be read at all, and FrameError if the frames are not connected.
        """
        for frame in self.read_frames(first):
            yield ReplayedFrame.of(frame, estimate(frame, estimator))

    def read_frames(self, first: int = 0) -> Iterator[ReplayFrame]:
        """Yield the images from number `first` on, in order, each with its touch.

        Raises RecordingError for images that cannot be read at all, and FrameError if the frames are not connected.
        """
        for number, message in enumerate(self.recording.read_messages(self.topic.name)):
            if number >= first:
                yield self._read_frame(number, message)

    def _read_frame(self, number: int, message: Message) -> ReplayFrame:
        image = message.decode()
        frame = self._find_frame(image)
        stamp_ns = read_stamp_ns(image.header)
        found = ReplayFrame(number, stamp_ns, message.log_time_ns, self.base_frame or frame)
        try:
            if self.has_base and self.frame_tree is not None:
                T = self.frame_tree.look_up(str(self.base_frame), frame, stamp_ns)
                found = replace(found, T_base_sensor=T)
        except FrameError as error:
            found = replace(found, problem=error)
        try:
            pixels = decode_image(image)
            found = replace(found, image=pixels)
            asked, sensor = self.localizer.config.touch, self.localizer.sensor
            touch = touch_from_image(pixels, sensor, asked.press_depth_m, f"image {number}", asked.unit, asked.kind)
        except (RecordingError, StoreError):  # the frame is not at fault, so the journal must not record it as refused
            raise
        except TactileLocError as error:
            return replace(found, problem=error)
        return replace(found, touch=replace(touch, T_base_sensor=found.T_base_sensor))

    def _find_frame(self, image: Any) -> str:
        frame = self.frame or str(image.header.frame_id)
        if self.base_frame and self.frame_tree is not None:
            if not frame:
                raise FrameError(f"the images on {self.topic.name} have no frame in their headers; give `frame`")
            self.frame_tree.require(self.base_frame, frame)
        return frame


@dataclass(frozen=True, eq=False)
class FolderReplay:
    """Locates images or contact shapes of a `folder`, with the sensor's poses from a CSV file (`read_sensor_track`).

    With file names, the images are those of the rows, in the rows' order. Otherwise the images are named by their times
    in seconds, such as `12.5.png`, and are sorted by these times. Poses are in the base frame of the sensor's poses.
    The localizer's configuration of a touch gives the unit, the kind and the press depth of depths.
    """

    folder: Path
    sensor_track: SensorTrack
    localizer: Localizer

    has_base: ClassVar[bool] = True

    @property
    def about(self) -> str:
        """The images in words."""
        return f"images in {self.folder}"

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the frames except the localizer, as JSON values."""
        return {"folder": identify_files(self.folder), "poses": identify_files(self.sensor_track.path)}

    @cached_property
    def images(self) -> tuple[tuple[str, float], ...]:
        """The images' file names and times, seconds, in order. Raises FrameError if a file is missing or misnamed."""
        names, track = list_touch_files(self.folder), self.sensor_track
        if track.names:
            known = {show_name(name): name for name in names}
            missing = [name for name in track.names if name not in known]
            if missing:
                raise FrameError(f"{track.path} names {missing[0]}, which is not in {self.folder}; correct its row")
            if len(names) > len(track.names):
                log.warning(
                    "%s names %d of the %d images in %s; the others are left out",
                    *(track.path, len(track.names), len(names), self.folder),
                )
            return tuple(zip((known[name] for name in track.names), track.times_s.tolist(), strict=True))
        timed = [(name, read_time_s(name)) for name in names]
        for name, time_s in timed:
            if time_s is None:
                raise FrameError(
                    f"{track.path} gives poses by time, but the name {name} is not a time in seconds, such as "
                    "12.5.png; rename the images, or add a column file"
                )
        return tuple(sorted(((name, time_s) for name, time_s in timed if time_s is not None), key=lambda one: one[1]))

    def read_frames(self, first: int = 0) -> Iterator[ReplayFrame]:
        """Yield the images from number `first` on, in order, each with its touch."""
        for number, (name, time_s) in enumerate(self.images[first:], first):
            stamp_ns = round(1e9 * time_s)
            found = ReplayFrame(number, stamp_ns, stamp_ns, "base", name)
            try:
                found = replace(found, T_base_sensor=self.sensor_track.look_up(name, time_s))
                asked, path = self.localizer.config.touch, self.folder / name
                touch = read_touch(path, self.localizer.sensor, asked.unit, asked.press_depth_m, asked.kind)
                yield replace(found, touch=replace(touch, T_base_sensor=found.T_base_sensor), image=touch.image)
            except StoreError:
                raise
            except TactileLocError as error:
                yield replace(found, problem=error)


def list_touch_files(folder: Path) -> list[str]:
    """Return the names of the images and contact shapes in a folder, in order. Raises SourceError for a bad folder."""
    try:
        return [path.name for path in list_touches(folder)]
    except OSError as error:
        raise SourceError(f"{folder} cannot be read ({error.strerror}); check that the folder exists") from error


def identify_files(path: Path) -> list[Any]:
    """Return values that identify a file, or a folder's files, and change when they grow, without reading them."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return [[file.name, file.stat().st_size, file.stat().st_mtime_ns] for file in files if file.is_file()]


def estimate(frame: ReplayFrame, estimator: Estimator) -> LocatedFrame:
    """Locate a frame's touch with an estimator; a frame with a problem gives a result with the reason."""
    if frame.problem is not None or frame.touch is None:
        return LocatedFrame.of_error(frame.problem or NoContactError("nothing touches the sensor"))
    try:
        return estimator(frame.touch)
    except (RecordingError, StoreError):
        raise
    except TactileLocError as error:
        return LocatedFrame.of_error(error)


ReplaySource = Replay | FolderReplay  # images in order, to be located with a localizer


@dataclass(frozen=True)
class ReplaySummary:
    """The number of frames with each result, and the `reasons` why frames have no pose, the most frequent first."""

    frames: int
    located: int
    certain: int
    ambiguous: int
    poor_fit: int
    not_found: int
    no_contact: int
    refused: int
    reasons: tuple[tuple[str, int], ...]
    jumps_back: int

    @classmethod
    def of(cls, records: Iterable[ReplayedFrame]) -> ReplaySummary:
        """Count the frames' results, and the frames whose stamp is earlier than the stamp of the frame before."""
        records = list(records)
        found = [record.located for record in records]
        without = (one for one in found if one.T_sensor_object is None and one.verdict is not Verdict.NO_CONTACT)
        reasons = Counter(one.says or explain_verdict(one.verdict) for one in without)
        stamps = np.array([record.stamp_ns for record in records])
        return cls(
            **count_frames(one.verdict for one in found),
            reasons=tuple(reasons.most_common()),
            jumps_back=int((np.diff(stamps) < 0).sum()),
        )


def require_located(source: ReplaySource, records: Sequence[ReplayedFrame], summary: ReplaySummary) -> None:
    """Raise RecordingError, with the most frequent reason, if no frame has a pose."""
    if any(record.T_frame_object is not None for record in records):
        return
    why = f"most often: {summary.reasons[0][0]}" if summary.reasons else "none of them shows contact"
    raise RecordingError(f"none of the {summary.frames} {source.about} can be located; {why}")
