"""A recording, located frame by frame: what each image of a topic comes to, in order, resumed where it was left off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.errors import FrameError, NoContactError, RecordingError, StoreError, TactileLocError
from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.geometry.rigid import covariance_along
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.mount_files import Covariance
from tactile_loc.io.recordings import Message, Recording
from tactile_loc.io.ros_messages import Topic, image_array, read_stamp_ns
from tactile_loc.io.toml import Matrix
from tactile_loc.io.touches import touch_from_image
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result import Hypothesis

Estimator = Callable[[Touch], Hypothesis]  # what a touch comes to: a localizer's best, or what a tracker makes of it


class Outcome(StrEnum):
    """What became of a frame."""

    LOCATED = "located"
    NO_CONTACT = "no contact"
    REFUSED = "refused"


class FrameRecord(BaseModel):
    """One image of the recording and what it came to. SI units."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    number: int = Field(description="of the image on its topic, from 0")
    stamp_ns: int = Field(description="the image's stamp, ns")
    log_time_ns: int = Field(description="when the image was logged, ns")
    outcome: Outcome = Field(description="located, no contact, or refused")
    says: str = Field(default="", description="why it was not located; empty if it was")
    frame: str = Field(description="the frame that the pose is in")
    T_frame_object: Matrix | None = Field(default=None, description="the object's pose there, (4, 4), m")
    covariance: Covariance | None = Field(
        default=None,
        description="(6, 6), of x, y, z of the object's origin (m) and rotations about the frame's axes (rad); null "
        "when it is not known",
    )
    probability: float | None = Field(default=None, description="of the pose among all, 0 to 1")
    imprint_iou: float | None = Field(default=None, description="how well the pose explains the image, 0 to 1")

    @property
    def T(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name
        """The object's pose (4, 4), metres, of a frame that was located."""
        return np.array(self.T_frame_object)


@dataclass(frozen=True, eq=False)
class FrameView:
    """An image of a recording (H, W, 3) or (H, W), and where its frame is in the base frame, (4, 4), metres, if a base
    frame was asked for and that is known."""

    image: NDArray[Any]
    T_base_frame: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class Replay:
    """What is located: the images on a `topic` of a recording, by a localizer's sensor.

    Poses are in `frame`, by default the one that each image's header names; with `base_frame` they are moved there by
    the `read_frame_tree`. `press_depth_m` is as for `read_touch`.
    """

    recording: Recording
    topic: Topic
    localizer: Localizer
    frame: str | None = None
    base_frame: str | None = None
    frame_tree: FrameTree | None = None
    press_depth_m: float | None = None

    def frames(self, estimator: Estimator, first: int = 0) -> Iterator[FrameRecord]:
        """Yield what the images come to, from number `first` on.

        Raises RecordingError for images that cannot be read at all, FrameError where the frames are not connected.
        """
        for number, message in enumerate(self.recording.read_messages(self.topic.name)):
            if number >= first:
                yield self._located(number, message, estimator)

    def views(self) -> Iterator[FrameView]:
        """Yield the topic's images, in order. Raises RecordingError for those that cannot be read."""
        for message in self.recording.read_messages(self.topic.name):
            image = message.decode()
            T = None
            with suppress(FrameError):
                T = self._base_from(self._frame_of(image), read_stamp_ns(image.header)) if self.base_frame else None
            yield FrameView(image_array(image), T)

    def touch(self, image: NDArray[Any]) -> Touch:
        """Return what the sensor reads in an image. Raises NoContactError or TouchError."""
        return touch_from_image(image, self.localizer.sensor, self.press_depth_m)

    def _located(self, number: int, message: Message, estimator: Estimator) -> FrameRecord:
        image = message.decode()
        frame = self._frame_of(image)
        given: dict[str, Any] = {
            "number": number, "stamp_ns": read_stamp_ns(image.header), "log_time_ns": message.log_time_ns,
            "frame": self.base_frame or frame,
        }  # fmt: skip
        try:
            touch = self.touch(image_array(image))
            T_base_frame = self._base_from(frame, given["stamp_ns"])
            return _record(given, estimator(touch), T_base_frame)
        except (RecordingError, StoreError):  # of no frame's making: they would be refused for good
            raise
        except NoContactError as error:
            return FrameRecord(**given, outcome=Outcome.NO_CONTACT, says=str(error))
        except TactileLocError as error:
            return FrameRecord(**given, outcome=Outcome.REFUSED, says=str(error))

    def _frame_of(self, image: Any) -> str:
        frame = self.frame or str(image.header.frame_id)
        if self.base_frame and self.frame_tree is not None:
            if not frame:
                raise FrameError(f"the images on {self.topic.name} name no frame; say by --frame where they were taken")
            self.frame_tree.require(self.base_frame, frame)
        return frame

    def _base_from(self, frame: str, stamp: int) -> NDArray[np.float64]:
        if not self.base_frame or self.frame_tree is None:
            return np.eye(4)
        return self.frame_tree.lookup(self.base_frame, frame, stamp)


def _record(given: dict[str, Any], best: Hypothesis, T_base_frame: NDArray[np.float64]) -> FrameRecord:
    covariance = best.refined.covariance
    along = None if covariance is None else covariance_along(covariance, T_base_frame[:3, :3]).tolist()
    return FrameRecord(
        **given, outcome=Outcome.LOCATED, T_frame_object=(T_base_frame @ best.T_sensor_object).tolist(),
        covariance=along, probability=best.probability, imprint_iou=best.imprint_iou,
    )  # fmt: skip


@dataclass(frozen=True)
class ReplaySummary:
    """How many frames came to what; `reasons` why frames were refused, the most frequent first."""

    frames: int
    located: int
    no_contact: int
    refused: int
    reasons: tuple[tuple[str, int], ...]
    jumps_back: int

    @classmethod
    def of(cls, records: Iterable[FrameRecord]) -> ReplaySummary:
        """Count what frames came to, and how often the clock of their stamps went back."""
        records = list(records)
        outcomes = Counter(record.outcome for record in records)
        reasons = Counter(record.says for record in records if record.outcome is Outcome.REFUSED)
        stamps = np.array([record.stamp_ns for record in records])
        return cls(
            len(records), outcomes[Outcome.LOCATED], outcomes[Outcome.NO_CONTACT], outcomes[Outcome.REFUSED],
            tuple(reasons.most_common()), int((np.diff(stamps) < 0).sum()),
        )  # fmt: skip


def require_located(replay: Replay, summary: ReplaySummary) -> None:
    """Raise RecordingError, with the most frequent reason, when no frame was located."""
    if summary.located:
        return
    why = f"most often: {summary.reasons[0][0]}" if summary.reasons else "none of them shows contact"
    raise RecordingError(
        f"none of the {summary.frames} images on {replay.topic.name} in {replay.recording.path} can be located; {why}"
    )
