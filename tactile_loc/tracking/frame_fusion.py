"""Replays that use all images of a recording: a track, or one fused pose of an object at rest."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.geometry.rigid import Floats, invert
from tactile_loc.core.runtime.errors import FrameError, NoContactError, RecordingError, TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.tracking.key_search import KeySearch, choose_telling
from tactile_loc.tracking.replay import ReplayedFrame, ReplayFrame, ReplaySource
from tactile_loc.tracking.tracker import Tracker

MOST_KEYS = 8  # touches that are located together
IMAGE = "image "  # before the number, in the names of key touches
LEAST_EXPLAINED = 0.8  # share of the touches that a pose at rest must explain


def require_base(source: ReplaySource) -> None:
    """Raise FrameError unless the sensor's poses in a base frame are known."""
    if not source.has_base:
        raise FrameError(
            f"the sensor's poses for the {source.about} are unknown, so the images cannot be used together; give "
            "`base_frame`"
        )


def track_frames(source: ReplaySource) -> Iterator[ReplayedFrame]:
    """Yield the results of all images, in order, followed by one tracker.

    Images without contact have the predicted pose. Images that cannot be read, or whose sensor pose is unknown, are
    refused. Raises FrameError if the source has no base frame.
    """
    require_base(source)
    tracker, time_s = Tracker(source.localizer), -np.inf
    for frame in source.read_frames():
        time_s = max(time_s, 1e-9 * frame.stamp_ns)  # a clock may be set back
        yield ReplayedFrame.of(frame, _track(tracker, time_s, frame))


def _track(tracker: Tracker, time_s: float, frame: ReplayFrame) -> LocatedFrame:
    problem = frame.problem
    if frame.T_base_sensor is None or not (problem is None or isinstance(problem, NoContactError)):
        return LocatedFrame.of_error(problem or FrameError("the sensor's pose is unknown"))
    try:
        found = tracker.update(time_s, frame.touch, frame.T_base_sensor)
    except TactileLocError as error:
        return LocatedFrame.of_error(error)
    return found if problem is None else replace(found, says=str(problem))


@dataclass(frozen=True, eq=False)
class RestPose:
    """The pose of an object at rest, from touches located together.

    `localization` is the result of the key touches, the images with the `numbers`. `T_base_object` (4, 4), metres, has
    the `covariance` (6, 6), as in RefinedPose, along the base's axes. `imprint_ious` (N,), 0 to 1, states how well the
    pose explains each touch of the recording.
    """

    localization: Localization
    numbers: tuple[int, ...]
    T_base_object: Floats
    covariance: Floats | None
    imprint_ious: Floats
    least_iou: float

    @property
    def explained(self) -> float:
        """The share of the touches that the pose explains, 0 to 1."""
        return float((self.imprint_ious >= self.least_iou).mean())

    @property
    def verdict(self) -> Verdict:
        """The verdict on the key touches; "poor fit" if the pose does not explain the other touches."""
        return self.localization.verdict if self.explained >= LEAST_EXPLAINED else Verdict.POOR_FIT

    @property
    def probability(self) -> float:
        """The probability of the pose, 0 to 1."""
        return self.localization.best.probability

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,) of x, y, z, metres, and of the rotations about them, radians; None if unknown."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    def describe(self) -> dict[str, Any]:
        """Return the pose as JSON values, in SI units."""
        return {
            "verdict": self.verdict,
            "probability": self.probability,
            "images": list(self.numbers),
            "explained": self.explained,
            "T_base_object": self.T_base_object.tolist(),
            "covariance": None if self.covariance is None else self.covariance.tolist(),
        }

    def view_frame(self, frame: ReplayFrame, imprint_iou: float) -> LocatedFrame:
        """Return the pose in the sensor's frame of an image, which it explains with an imprint IoU (NaN: no touch)."""
        T_sensor_base = invert(np.asarray(frame.T_base_sensor))
        C = None if self.covariance is None else rotate_covariance(self.covariance, T_sensor_base[:3, :3])
        verdict = Verdict.NO_CONTACT if frame.touch is None else self.verdict
        if imprint_iou < self.least_iou:  # False for NaN
            verdict = Verdict.POOR_FIT
        T, p = (T_sensor_base @ self.T_base_object)[None], np.array([self.probability])
        return LocatedFrame(verdict, T, p, C, imprint_iou, says="" if frame.problem is None else str(frame.problem))


def fuse_frames(source: ReplaySource) -> tuple[RestPose, list[ReplayedFrame]]:
    """Locate an object at rest from the images of a source together; return its pose, and the result of each image.

    Up to MOST_KEYS touches, far apart, are located together. The pose is then compared
    with all touches. Raises FrameError if the source has no base frame, RecordingError if no image has a touch and a
    sensor pose, and GridError if no pose fits the touches.
    """
    require_base(source)
    localizer = source.localizer
    options = localizer.config.tracker
    touches = (_name(frame) for frame in source.read_frames() if _is_usable(frame) and frame.touch is not None)
    kept = KeySearch(localizer).add_new_places(touches).touches
    keys = choose_telling(localizer, kept, np.empty((0, 4, 4)), MOST_KEYS)
    if not keys:
        says = f"none of the {source.about} shows contact at a known sensor pose"
        raise RecordingError(says + _explain_refusals(source))
    found = localize_together([(localizer, key) for key in keys])
    T_base_sensor = np.asarray(found.touch.T_base_sensor)
    T, C = T_base_sensor @ found.best.T_sensor_object, found.best.refined.covariance
    C = None if C is None else rotate_covariance(C, T_base_sensor[:3, :3])
    numbers = tuple(int(key.name.removeprefix(IMAGE)) for key in keys)
    frames, ious = [], []
    for frame in source.read_frames():
        ious.append(_compare(source, frame, T))
        frames.append(replace(frame, image=None))
    known = np.array([iou for iou in ious if not np.isnan(iou)])
    rest = RestPose(found, numbers, T, C, known, options.least_iou)
    return rest, [_record(rest, frame, iou) for frame, iou in zip(frames, ious, strict=True)]


def _explain_refusals(source: ReplaySource) -> str:
    """Return the most frequent reason why images are refused, to follow a message; "" if none is."""
    problems = Counter(str(frame.problem) for frame in source.read_frames() if frame.problem and not _is_usable(frame))
    return "".join(f"; most often: {problem}" for problem, _ in problems.most_common(1))


def _is_usable(frame: ReplayFrame) -> bool:
    """Return whether the sensor's pose is known, and the image is a touch or shows no contact."""
    known = frame.problem is None or isinstance(frame.problem, NoContactError)
    return known and frame.T_base_sensor is not None


def _name(frame: ReplayFrame) -> Touch:
    assert frame.touch is not None
    return replace(frame.touch, name=f"{IMAGE}{frame.number}")


def _compare(source: ReplaySource, frame: ReplayFrame, T_base_object: Floats) -> float:
    """Return the imprint IoU of a frame's touch with a pose (4, 4), metres; NaN without a touch."""
    if not _is_usable(frame) or frame.touch is None:
        return float("nan")
    T = invert(np.asarray(frame.T_base_sensor)) @ T_base_object
    scene = source.localizer.scene.match_touch(frame.touch)
    return float(scene.compare_imprints(T[None], frame.touch, source.localizer.config.tracker.image_px).imprint_ious[0])


def _record(rest: RestPose, frame: ReplayFrame, imprint_iou: float) -> ReplayedFrame:
    if not _is_usable(frame):
        return ReplayedFrame.of(frame, LocatedFrame.of_error(frame.problem or FrameError("no sensor pose")))
    return ReplayedFrame.of(frame, rest.view_frame(frame, imprint_iou))


def measure_scatter_m(records: Sequence[ReplayedFrame]) -> float:
    """Return the root mean square distance of the located origins from their mean, metres; 0 for fewer than two."""
    found = [record.T_frame_object[:3, 3] for record in records if record.T_frame_object is not None]
    return float(np.sqrt(np.var(found, axis=0).sum())) if len(found) > 1 else 0.0
