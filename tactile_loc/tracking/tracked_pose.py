"""The pose of a tracked object at one frame, and how far to trust it.

A track can be sure of a wrong pose: another object may have taken the place of the tracked one, or the pose comes from
one touch that fits several places. Two facts therefore limit a track's verdict. One is how well the pose has explained
earlier touches. The other is the verdict of the search that found the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.io.options import TrackerOptions
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.verdict import Verdict


@dataclass(frozen=True, eq=False)
class TrackedPose(LocatedFrame):
    """The object's pose at one frame of a track.

    If the probabilities of the poses sum to less than 1, the rest is the probability that the pose is elsewhere. Before
    the first touch, there is no pose. The poses are in the frame of the first sensor in contact or, without contact, of
    the one that was in contact last.

    `verdict` is as in a run, with the tracker's threshold of a poor fit (`tracker.least_iou`). Without contact, poses
    are predicted. `searched` is true if poses were searched nearby or on the whole object, which takes longer.
    `slipped` is true at the frame whose touch shows that the object has moved.
    """

    searched: bool = False
    slipped: bool = False


@dataclass(frozen=True)
class TrackTrust:
    """How far to trust the first mode of a track.

    `probability`, 0 to 1, is that of a pose within the tolerance, as the search states it. `usual_iou`, 0 to 1, is the
    imprint IoU with which the pose has explained the touches. A touch that it explains far worse does not change this
    value. `limit` is the most favourable verdict: "certain" after `Tracker.start`, and after a search, the verdict on
    the touches of the search. The trust is `settled` after `Tracker.start`, and after a search of enough key touches
    that is certain. Until then, each new key touch starts a search.
    """

    options: TrackerOptions
    probability: float = 1.0
    usual_iou: float = 0.0
    limit: Verdict = Verdict.CERTAIN
    settled: bool = True

    def restart(self, limit: Verdict, probability: float, imprint_iou: float, keys: int = 0) -> TrackTrust:
        """Return the trust in a pose after a search of `keys` key touches, or after a slip."""
        settled = limit is Verdict.CERTAIN and keys >= self.options.confirming
        return TrackTrust(self.options, probability, imprint_iou, limit, settled)

    def add_touch(self, imprint_iou: float) -> TrackTrust:
        """Return the trust after a touch that the same pose explains with an imprint IoU, 0 to 1."""
        if self._contradicts(imprint_iou):
            return self
        habit = self.options.habit
        return replace(self, usual_iou=max(imprint_iou, (1 - habit) * self.usual_iou + habit * imprint_iou))

    def doubts(self, imprint_iou: float) -> bool:
        """Return whether a pose with this imprint IoU, 0 to 1, explains a touch worse than usual, or not at all."""
        if self.usual_iou < self.options.least_iou:
            return imprint_iou < self.options.least_iou  # the pose has explained nothing so far
        return imprint_iou < self.usual_iou - min(self.options.fall_iou, self.usual_iou / 2)

    def judge(self, found: bool, imprint_iou: float, touched: bool) -> Verdict:
        """Return the verdict on a frame.

        `found` states whether there is a pose, and `touched` whether there is a touch. `imprint_iou`, 0 to 1,
        states how well the first pose explains the touch.
        """
        if not touched:
            return Verdict.NO_CONTACT
        if not found:
            return Verdict.NOT_FOUND
        if imprint_iou < self.options.least_iou or self._contradicts(imprint_iou):
            return Verdict.POOR_FIT
        return self.limit

    def share(self, weights: Floats) -> Floats:
        """Return the probabilities (K,) of modes with relative `weights` (K,), the first mode's first.

        The first mode has the stated probability. The others share the rest, but none is more probable than the first.
        """
        others = weights[1:].sum()
        rest = np.minimum(self.probability, (1 - self.probability) * weights[1:] / max(others, 1e-300))
        return np.concatenate([[self.probability], rest])

    def _contradicts(self, imprint_iou: float) -> bool:
        return imprint_iou < self.usual_iou - min(self.options.lost_iou, self.usual_iou / 2)
