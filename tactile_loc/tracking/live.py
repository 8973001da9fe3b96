"""Live frames, located in turn: each frame separately, or with a tracker as one sequence."""

from __future__ import annotations

import time
from collections import Counter, deque
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import NoContactError, TactileLocError
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.json_keys import Key, Keys, write_keys
from tactile_loc.io.streams.frame_sources import SourceFrame
from tactile_loc.io.streams.sensor_tracks import SensorTrack
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.located_frame import LOCATED, LocatedFrame, count_frames
from tactile_loc.locate.result.verdict import Verdict, explain_verdict
from tactile_loc.tracking.tracker import Tracker

RECENT = 20  # the frame rate is computed from this number of latest frames


LIVE: Keys = {  # one line in the file of a live run, in SI units
    "number": Key("integer", "number of the frame in its source, from 0"),
    **LOCATED,
    "name": Key("text", "of the frame's file, or made from its number"),
    "time_s": Key("number", "when it was taken: since 1970; in a video, since its start; s"),
    "T_sensor_object": Key("4 x 4 numbers or null", "the most probable pose, m"),
    "seconds": Key("number", "time to read and locate it"),
    "dropped": Key("integer", "frames dropped so far, because newer ones had come"),
    "exposure": Key("number or null", "the camera's fixed exposure, in 0.1 ms on Linux; null if automatic or unknown"),
    "white_balance_k": Key("number or null", "the camera's fixed white balance, kelvin; null if automatic or unknown"),
}


@dataclass(frozen=True, eq=False)
class LiveResult:
    """A frame and its result.

    `touch` is None if the frame shows no contact or cannot be read. `dropped` is the number of frames dropped so far.
    `rate_hz` is the current number of frames per second.
    """

    frame: SourceFrame
    located: LocatedFrame
    touch: Touch | None
    dropped: int
    rate_hz: float

    def to_json(self) -> dict[str, Any]:
        """Return the frame as one line in the file of a live run, as JSON values."""
        frame, located = self.frame, self.located
        name = show_name(frame.name)
        settings = asdict(frame.settings)
        known = {"number": frame.number, "name": name, "time_s": frame.time_s, "dropped": self.dropped}
        return write_keys(LIVE, located, **known, **settings)


@dataclass(eq=False)
class LiveLocator:
    """Locates the frames of one sensor: as one sequence if there is a `tracker`, otherwise each frame separately.

    The sensor's pose comes from the `sensor_track` or, without one, from the frame's file (`Touch.T_base_sensor`). If a
    file has no pose, the sensor is assumed to have stayed where it was. The localizer's configuration of a touch gives
    the unit, the kind and the press depth of depths.
    """

    localizer: Localizer
    tracker: Tracker | None = None
    sensor_track: SensorTrack | None = None
    counts: Counter[Verdict | None] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    _ends: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    _time_s: float = 0.0
    _T_base_sensor: Floats = field(default_factory=lambda: np.eye(4))

    def prepare(self) -> None:
        """Build, load and compile everything once, so that the first frame need not wait."""
        self.localizer.prepare()

    def locate(self, frame: SourceFrame, dropped: int = 0) -> LiveResult:
        """Locate a frame. `dropped` is the number of frames dropped so far.

        A frame that cannot be read raises no error; the result gives the reason (`LocatedFrame.says`).
        """
        start = time.perf_counter()
        touch = None
        try:
            if self.sensor_track is not None:
                self._T_base_sensor = self.sensor_track.look_up(frame.name, frame.time_s)
            asked = self.localizer.config.touch
            touch = frame.read_touch(self.localizer.sensor, asked.unit, asked.press_depth_m, asked.kind)
            located = self._locate_touch(frame, touch)
        except NoContactError as error:
            located = self._predict(frame, error)
        except TactileLocError as error:
            located = LocatedFrame.of_error(error)
        if located.T_sensor_object is None and located.verdict is not Verdict.NO_CONTACT:
            self.reasons[located.says or explain_verdict(located.verdict)] += 1
        self.counts[located.verdict] += 1
        end = time.perf_counter()
        self._ends.append(end)
        return LiveResult(frame, replace(located, seconds=end - start), touch, dropped, self._rate_hz)

    @property
    def _rate_hz(self) -> float:
        """Frames per second over the latest frames; 0 before the second frame."""
        return (len(self._ends) - 1) / (self._ends[-1] - self._ends[0]) if len(self._ends) > 1 else 0.0

    def _locate_touch(self, frame: SourceFrame, touch: Touch) -> LocatedFrame:
        if self.tracker is None:
            return LocatedFrame.of(self.localizer.localize(touch))
        if self.sensor_track is None and touch.T_base_sensor is not None:
            self._T_base_sensor = touch.T_base_sensor
        return self._track(self.tracker, frame, touch)

    def _predict(self, frame: SourceFrame, error: NoContactError) -> LocatedFrame:
        """Return the track's prediction for a frame without contact or, without a tracker, the error's frame."""
        if self.tracker is None:
            return LocatedFrame.of_error(error)
        return replace(self._track(self.tracker, frame, None), says=str(error))

    def _track(self, tracker: Tracker, frame: SourceFrame, touch: Touch | None) -> LocatedFrame:
        self._time_s = max(self._time_s, frame.time_s)  # a clock may be set back
        return tracker.update(self._time_s, touch, self._T_base_sensor)


@dataclass(frozen=True)
class LiveSummary:
    """The number of frames with each result, and the `reasons` why frames have no pose, the most frequent first."""

    frames: int
    located: int
    certain: int
    ambiguous: int
    poor_fit: int
    not_found: int
    no_contact: int
    refused: int
    dropped: int
    reasons: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, locator: LiveLocator, dropped: int) -> LiveSummary:
        """Count the results of a locator's frames."""
        counts = count_frames(locator.counts.elements())
        return cls(**counts, dropped=dropped, reasons=tuple(locator.reasons.most_common()))
