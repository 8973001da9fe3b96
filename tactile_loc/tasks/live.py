"""Frames as they come, located one after the other: each for itself, or tracked from one to the next."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.errors import NoContactError, TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.frame_sources import SourceFrame
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result import Hypothesis
from tactile_loc.tasks.tracker import Tracker

Matrix = list[list[float]]
Floats = NDArray[np.float64]

RECENT = 20  # frames that the rate is of


class FrameState(StrEnum):
    """What became of a frame: those of a track are the tracker's."""

    LOCATED = "located"
    SEARCHING = "searching"
    TRACKING = "tracking"
    LOST = "lost"
    NO_CONTACT = "no contact"
    REFUSED = "refused"


class LiveRecord(BaseModel):
    """One frame and what it came to: a line of a live run's file. SI units."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    number: int = Field(description="of the frame among all of its source, from 0")
    name: str = Field(description="of the frame's file, or made of its number")
    time_s: float = Field(description="when it was taken: since 1970, in a video since its beginning, s")
    state: FrameState = Field(description="located; tracking, searching, lost; no contact; or refused")
    says: str = Field(default="", description="why there is no pose; empty if there is one")
    T_sensor_object: Matrix | None = Field(default=None, description="the most probable pose, (4, 4), m")
    covariance: Matrix | None = Field(
        default=None,
        description="(6, 6), of x, y, z of the object's origin (m) and rotations about the sensor's axes (rad); null "
        "when it is not known",
    )
    probability: float | None = Field(default=None, description="of that pose among all, 0 to 1")
    imprint_iou: float | None = Field(default=None, description="how well it explains the frame, 0 to 1")
    seconds: float = Field(description="that reading and locating it took")
    dropped: int = Field(description="frames that were dropped so far, because newer ones had come")

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,), metres and radians, of x, y, z and about them; None when they are not known."""
        return None if self.covariance is None else np.sqrt(np.diag(np.array(self.covariance)))


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of the pose: `T_sensors_object` (K, 4, 4), metres, the most probable first, their probabilities
    (K,), and the covariance (6, 6) and the imprint IoU of the first, NaN without a touch."""

    state: FrameState
    T_sensors_object: Floats
    probabilities: Floats
    covariance: Floats | None
    imprint_iou: float

    @classmethod
    def of(cls, hypotheses: Sequence[Hypothesis]) -> Estimate:
        """Return what hypotheses, the first one the best, say."""
        poses = np.stack([one.T_sensor_object for one in hypotheses])
        shares = np.array([one.probability for one in hypotheses])
        best = hypotheses[0]
        return cls(FrameState.LOCATED, poses, shares, best.refined.covariance, best.imprint_iou)

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,), metres and radians, of x, y, z and about them; None when they are not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class LiveResult:
    """A frame, its `touch` and the `estimate`, if there are any, its `record`, and how many a second there are now."""

    frame: SourceFrame
    record: LiveRecord
    touch: Touch | None
    estimate: Estimate | None
    rate_hz: float


@dataclass(eq=False)
class LiveLocator:
    """Locates the frames of one sensor. With a `tracker` each is taken for the next of one sequence, else for itself.

    Where the sensor is, a frame's file says (`Touch.T_base_sensor`); if none does, it is taken to stand still.
    `unit` and `press_depth_m` are as for `read_touch`.
    """

    localizer: Localizer
    tracker: Tracker | None = None
    unit: str | None = None
    press_depth_m: float | None = None
    counts: Counter[FrameState] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    _ends: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    _time_s: float = 0.0
    _T_base_sensor: Floats = field(default_factory=lambda: np.eye(4))

    def prepare(self) -> None:
        """Build, load and compile what locating takes, once: frames need not wait for it."""
        touch = self.localizer.simulate(1, self.localizer.config.seed)[0]
        self.localizer.localize(touch)
        if self.tracker is not None:
            Tracker(self.localizer).update(0.0, touch, np.eye(4))

    def located(self, frame: SourceFrame, dropped: int = 0) -> LiveResult:
        """Return what a frame comes to; never raises for what it shows. `dropped` are the frames dropped so far."""
        start = time.perf_counter()
        touch, estimate, says, state = None, None, "", FrameState.REFUSED
        try:
            touch = frame.read_touch(self.localizer.sensor, self.unit, self.press_depth_m)
            estimate = self._estimate(frame, touch)
        except NoContactError as error:
            state, says = FrameState.NO_CONTACT, str(error)
            estimate = self._predicted(frame)
        except TactileLocError as error:
            says = str(error)
            self.reasons[says] += 1
        state = state if estimate is None else estimate.state
        self.counts[state] += 1
        end = time.perf_counter()
        self._ends.append(end)
        record = LiveRecord(
            number=frame.number, name=frame.name, time_s=frame.time_s, state=state, says=says, seconds=end - start,
            dropped=dropped, **_told(estimate),
        )  # fmt: skip
        return LiveResult(frame, record, touch, estimate, self._rate_hz)

    @property
    def _rate_hz(self) -> float:
        """Frames a second, of the last ones; 0 before there are two."""
        return (len(self._ends) - 1) / (self._ends[-1] - self._ends[0]) if len(self._ends) > 1 else 0.0

    def _estimate(self, frame: SourceFrame, touch: Touch) -> Estimate:
        if self.tracker is None:
            return Estimate.of(self.localizer.localize(touch).hypotheses)
        if touch.T_base_sensor is not None:
            self._T_base_sensor = touch.T_base_sensor
        return self._tracked(frame, touch)

    def _predicted(self, frame: SourceFrame) -> Estimate | None:
        """Where a track goes on without contact."""
        return None if self.tracker is None else self._tracked(frame, None)

    def _tracked(self, frame: SourceFrame, touch: Touch | None) -> Estimate:
        assert self.tracker is not None
        self._time_s = max(self._time_s, frame.time_s)  # clocks are set back now and then
        found = self.tracker.update(self._time_s, touch, self._T_base_sensor)
        state = FrameState(found.state)
        return Estimate(state, found.T_sensors_object, found.probabilities, found.covariance, found.imprint_iou)


def _told(estimate: Estimate | None) -> dict[str, Any]:
    """The fields of a record that say where the object is."""
    if estimate is None or not len(estimate.T_sensors_object):
        return {}
    iou, covariance = estimate.imprint_iou, estimate.covariance
    return {
        "T_sensor_object": estimate.T_sensors_object[0].tolist(),
        "covariance": None if covariance is None else covariance.tolist(),
        "probability": float(estimate.probabilities[0]), "imprint_iou": None if np.isnan(iou) else float(iou),
    }  # fmt: skip


@dataclass(frozen=True)
class LiveSummary:
    """How many frames came to what; `reasons` why frames were refused, the most frequent first."""

    frames: int
    located: int
    no_contact: int
    refused: int
    dropped: int
    reasons: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, locator: LiveLocator, dropped: int) -> LiveSummary:
        """Count what a locator's frames came to."""
        counts, frames = locator.counts, sum(locator.counts.values())
        without = counts[FrameState.NO_CONTACT], counts[FrameState.REFUSED]
        return cls(frames, frames - sum(without), *without, dropped, tuple(locator.reasons.most_common()))
