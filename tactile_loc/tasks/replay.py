"""Replay of a recording: the images of a topic are located in order. An interrupted replay can be resumed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.errors import FrameError, RecordingError, StoreError, TactileLocError
from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.streams.recordings import Message, Recording
from tactile_loc.io.streams.ros_messages import Topic, decode_image, read_stamp_ns
from tactile_loc.io.toml import Matrix
from tactile_loc.io.touches import touch_from_image
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.results.located_frame import LocatedFrame, LocatedRecord, count_frames, record_fields
from tactile_loc.locate.results.verdict import Verdict

Estimator = Callable[[Touch], LocatedFrame]  # locates a touch with a localizer or a tracker


class FrameRecord(LocatedRecord):
    """One image of the recording and its result. SI units. `number` counts the images of the topic from 0."""

    stamp_ns: int = Field(description="the image's stamp, ns")
    log_time_ns: int = Field(description="when the image was logged, ns")
    frame: str = Field(description="the frame that the pose is in")
    T_frame_object: Matrix | None = Field(default=None, description="the object's pose in it, (4, 4), m")

    @property
    def T(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name
        """The object's pose (4, 4), metres, in `frame`. Use it only if the object was located."""
        return np.array(self.T_frame_object)


@dataclass(frozen=True, eq=False)
class FrameView:
    """An image of a recording, (H, W, 3) or (H, W), and the pose of its frame in the base frame, (4, 4), metres.

    The pose is None if no base frame was chosen or the pose is unknown.
    """

    image: NDArray[Any]
    T_base_frame: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class Replay:
    """Locates the images on a `topic` of a recording with a localizer's sensor.

    Poses are in `frame`, by default the frame named in each image's header. With `base_frame`, poses are transformed to
    the base frame by `frame_tree` (see `read_frame_tree`). `press_depth_m` is as for `read_touch`.
    """

    recording: Recording
    topic: Topic
    localizer: Localizer
    frame: str | None = None
    base_frame: str | None = None
    frame_tree: FrameTree | None = None
    press_depth_m: float | None = None

    def frames(self, estimator: Estimator, first: int = 0) -> Iterator[FrameRecord]:
        """Yield the results of the images from number `first` on.

        Raises RecordingError for images that cannot be read at all, and FrameError if the frames are not connected.
        """
        for number, message in enumerate(self.recording.read_messages(self.topic.name)):
            if number >= first:
                yield self._locate(number, message, estimator)

    def views(self) -> Iterator[FrameView]:
        """Yield the topic's images, in order. Raises RecordingError for images that cannot be read."""
        for message in self.recording.read_messages(self.topic.name):
            image = message.decode()
            T = None
            if self.base_frame:
                with suppress(FrameError):
                    T = self._find_base_pose(self._find_frame(image), read_stamp_ns(image.header))
            yield FrameView(decode_image(image), T)

    def touch(self, image: NDArray[Any]) -> Touch:
        """Return the touch in an image of the sensor.

        Raises NoContactError for an image without contact, and TouchError for an image that cannot be read.
        """
        return touch_from_image(image, self.localizer.sensor, self.press_depth_m)

    def _locate(self, number: int, message: Message, estimator: Estimator) -> FrameRecord:
        image = message.decode()
        frame = self._find_frame(image)
        given: dict[str, Any] = {
            "number": number, "stamp_ns": read_stamp_ns(image.header), "log_time_ns": message.log_time_ns,
            "frame": self.base_frame or frame,
        }  # fmt: skip
        T_base_frame = np.eye(4)
        try:
            touch = self.touch(decode_image(image))
            T_base_frame = self._find_base_pose(frame, given["stamp_ns"])
            located = estimator(touch)
        except (RecordingError, StoreError):  # the frame is not at fault, so the journal must not record it as refused
            raise
        except TactileLocError as error:
            located = LocatedFrame.of_error(error)
        moved = located.view_from(T_base_frame)
        T = moved.T_sensor_object
        return FrameRecord(**given, T_frame_object=None if T is None else T.tolist(), **record_fields(moved))

    def _find_frame(self, image: Any) -> str:
        frame = self.frame or str(image.header.frame_id)
        if self.base_frame and self.frame_tree is not None:
            if not frame:
                raise FrameError(f"the images on {self.topic.name} have no frame in their headers; give `frame`")
            self.frame_tree.require(self.base_frame, frame)
        return frame

    def _find_base_pose(self, frame: str, stamp: int) -> NDArray[np.float64]:
        if not self.base_frame or self.frame_tree is None:
            return np.eye(4)
        return self.frame_tree.look_up(self.base_frame, frame, stamp)


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
    def of(cls, records: Iterable[FrameRecord]) -> ReplaySummary:
        """Count the frames' results, and the frames whose stamp is earlier than the stamp of the frame before."""
        records = list(records)
        without = (one for one in records if one.T_frame_object is None and one.verdict is not Verdict.NO_CONTACT)
        reasons = Counter(record.says for record in without)
        stamps = np.array([record.stamp_ns for record in records])
        return cls(
            **count_frames(record.verdict for record in records), reasons=tuple(reasons.most_common()),
            jumps_back=int((np.diff(stamps) < 0).sum()),
        )  # fmt: skip


def require_located(replay: Replay, records: Sequence[FrameRecord], summary: ReplaySummary) -> None:
    """Raise RecordingError, with the most frequent reason, if no frame has a pose."""
    if any(record.T_frame_object is not None for record in records):
        return
    why = f"most often: {summary.reasons[0][0]}" if summary.reasons else "none of them shows contact"
    raise RecordingError(
        f"none of the {summary.frames} images on {replay.topic.name} in {replay.recording.path} can be located; {why}"
    )
