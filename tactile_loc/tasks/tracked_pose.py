"""The pose of a tracked object at one frame, and how far to trust it.

A track can be sure of a wrong pose: another object may have taken the place of the tracked one, or the pose comes from
one touch that fits several places. Two facts therefore limit a track's verdict. One is how well the pose has explained
earlier touches. The other is the verdict of the search that found the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactile_loc.io.options import TrackerOptions
from tactile_loc.locate.results.located_frame import LocatedFrame
from tactile_loc.locate.results.verdict import Verdict, judge

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """The object's pose at one frame.

    `T_sensor_object_modes` (K, 4, 4), metres, are the modes' poses, the most probable first. They have `covariances`
    (K, 6, 6), as in RefinedPose, and `probabilities` (K,). If the probabilities sum to less than 1, the rest is the
    probability that the pose is elsewhere. `imprint_iou`, 0 to 1, states how well the first pose explains the touch;
    NaN without a touch.

    `verdict` is as in a run, with the tracker's thresholds (`tracker.certain`, `tracker.least_iou`). Without contact,
    poses are predicted. `searched` is true if poses were searched nearby or on the whole object, which takes longer.
    """

    time_s: float
    verdict: Verdict
    T_sensor_object_modes: Floats
    covariances: Floats
    probabilities: Floats
    imprint_iou: float
    searched: bool

    @property
    def T_sensor_object(self) -> Floats | None:  # noqa: N802 - the field's name
        """The most probable pose (4, 4), metres; None before the first touch."""
        return self.T_sensor_object_modes[0] if len(self.T_sensor_object_modes) else None

    @property
    def covariance(self) -> Floats | None:
        """The covariance (6, 6) of the most probable pose, as in RefinedPose; None before the first touch."""
        return self.covariances[0] if len(self.covariances) else None

    @property
    def frame(self) -> LocatedFrame:
        """The pose as a located frame, the form shared with live runs, recordings and ROS."""
        return LocatedFrame(
            self.verdict, self.T_sensor_object_modes, self.probabilities, self.covariance, self.imprint_iou
        )


@dataclass(frozen=True)
class TrackTrust:
    """How far to trust the first mode of a track.

    `usual_iou`, 0 to 1, is the imprint IoU with which the pose has explained the touches. A touch that it explains far
    worse does not change this value. `limit` is the most favourable verdict: "certain" after `Tracker.start`, and after
    a search, the verdict on the touches of the search. After a slip, it is "ambiguous", and the pose is `nearby`.
    `keyframes` counts the keyframes that the pose has explained as well as usual since then.
    """

    options: TrackerOptions
    usual_iou: float = 0.0
    limit: Verdict = Verdict.CERTAIN
    nearby: bool = False
    keyframes: int = 0

    @property
    def needs_search(self) -> bool:
        """Whether enough keyframes have come to search with them, in order to confirm a pose that is not certain."""
        return self.limit is not Verdict.CERTAIN and self.keyframes >= self.options.confirming

    def restart(self, limit: Verdict, imprint_iou: float, nearby: bool = False) -> TrackTrust:
        """Return the trust in a new pose, or in a pose that a search has confirmed."""
        return TrackTrust(self.options, imprint_iou, limit, nearby)

    def add_touch(self, imprint_iou: float, is_keyframe: bool) -> TrackTrust:
        """Return the trust after a touch that the same pose explains with an imprint IoU, 0 to 1."""
        if self._contradicts(imprint_iou):
            return replace(self, keyframes=0)
        keyframes, habit = self.keyframes + is_keyframe, self.options.habit
        usual_iou = max(imprint_iou, (1 - habit) * self.usual_iou + habit * imprint_iou)
        settled = self.nearby and keyframes >= self.options.confirming
        return replace(self, usual_iou=usual_iou, keyframes=keyframes, limit=Verdict.CERTAIN if settled else self.limit)

    def judge(self, probability: float | None, imprint_iou: float, elsewhere: float, touched: bool) -> Verdict:
        """Return the verdict on a frame; the arguments are those of `verdict.judge`."""
        options = self.options
        verdict = judge(
            probability, imprint_iou, elsewhere, touched=touched, certain=options.certain, least_iou=options.least_iou
        )
        if verdict in (Verdict.CERTAIN, Verdict.AMBIGUOUS) and self._contradicts(imprint_iou):
            return Verdict.POOR_FIT
        return self.limit if verdict is Verdict.CERTAIN else verdict

    def _contradicts(self, imprint_iou: float) -> bool:
        return imprint_iou < self.usual_iou - min(self.options.lost_iou, self.usual_iou / 2)
