"""Frames as they come, located one after the other: each for itself, or tracked from one to the next."""

from __future__ import annotations

import time
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.errors import NoContactError, TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.streams.frame_sources import SourceFrame
from tactile_loc.io.toml import Matrix
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.results.located_frame import LocatedFrame, LocatedRecord, count_frames, record_fields
from tactile_loc.locate.results.verdict import Verdict
from tactile_loc.tasks.tracker import Tracker

Floats = NDArray[np.float64]

RECENT = 20  # frames that the rate is of


class LiveRecord(LocatedRecord):
    """One frame and what it came to: a line of a live run's file. SI units."""

    name: str = Field(description="of the frame's file, or made of its number")
    time_s: float = Field(description="when it was taken: since 1970, in a video since its beginning, s")
    T_sensor_object: Matrix | None = Field(default=None, description="the most probable pose, (4, 4), m")
    seconds: float = Field(description="that reading and locating it took")
    dropped: int = Field(description="frames that were dropped so far, because newer ones had come")


@dataclass(frozen=True, eq=False)
class LiveResult:
    """A frame, what was `located`, its `touch` if there is one, frames `dropped` so far, and frames a second now."""

    frame: SourceFrame
    located: LocatedFrame
    touch: Touch | None
    dropped: int
    rate_hz: float

    @cached_property
    def record(self) -> LiveRecord:
        """The frame as a line of a live run's file."""
        T = self.located.T_sensor_object
        return LiveRecord(
            number=self.frame.number, name=self.frame.name, time_s=self.frame.time_s, seconds=self.located.seconds,
            dropped=self.dropped, T_sensor_object=None if T is None else T.tolist(), **record_fields(self.located),
        )  # fmt: skip


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
    counts: Counter[Verdict | None] = field(default_factory=Counter)
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

    def locate(self, frame: SourceFrame, dropped: int = 0) -> LiveResult:
        """Return what a frame comes to; never raises for what it shows. `dropped` are the frames dropped so far."""
        start = time.perf_counter()
        touch = None
        try:
            touch = frame.read_touch(self.localizer.sensor, self.unit, self.press_depth_m)
            located = self._locate_touch(frame, touch)
        except NoContactError as error:
            located = self._predict(frame, error)
        except TactileLocError as error:
            located = LocatedFrame.of_error(error)
            self.reasons[located.says] += 1
        self.counts[located.verdict] += 1
        end = time.perf_counter()
        self._ends.append(end)
        return LiveResult(frame, replace(located, seconds=end - start), touch, dropped, self._rate_hz)

    @property
    def _rate_hz(self) -> float:
        """Frames a second, of the last ones; 0 before there are two."""
        return (len(self._ends) - 1) / (self._ends[-1] - self._ends[0]) if len(self._ends) > 1 else 0.0

    def _locate_touch(self, frame: SourceFrame, touch: Touch) -> LocatedFrame:
        if self.tracker is None:
            return LocatedFrame.of(self.localizer.localize(touch))
        if touch.T_base_sensor is not None:
            self._T_base_sensor = touch.T_base_sensor
        return self._track(self.tracker, frame, touch)

    def _predict(self, frame: SourceFrame, error: NoContactError) -> LocatedFrame:
        """Where a track goes on without contact; nowhere without a track."""
        if self.tracker is None:
            return LocatedFrame.of_error(error)
        return replace(self._track(self.tracker, frame, None), says=str(error))

    def _track(self, tracker: Tracker, frame: SourceFrame, touch: Touch | None) -> LocatedFrame:
        self._time_s = max(self._time_s, frame.time_s)  # clocks are set back now and then
        return tracker.update(self._time_s, touch, self._T_base_sensor).frame


@dataclass(frozen=True)
class LiveSummary:
    """How many frames came to what; `reasons` why frames without a pose were not located, the most frequent first."""

    frames: int
    located: int
    not_found: int
    no_contact: int
    refused: int
    dropped: int
    reasons: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, locator: LiveLocator, dropped: int) -> LiveSummary:
        """Count what a locator's frames came to."""
        counts = count_frames(locator.counts.elements())
        return cls(**counts, dropped=dropped, reasons=tuple(locator.reasons.most_common()))
