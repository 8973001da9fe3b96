"""Tracking of an object from frame to frame, while sensors slide and rotate over it.

A few possible poses, the modes, are predicted from the sensors' motion and registered to the touches of each frame.
Prediction and touch are fused. So the prediction determines what the touch does not show, such as a bolt's rotation.

Key touches are touches at places far apart. They are located together, in another thread. The result decides between
modes and how far to trust them. If a touch shows that the object has slipped, poses nearby are tried. If no pose
explains a touch, the whole object is searched again. From time to time, key touches are located without the pose of
the track, to check it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, require_covariance, require_rigid
from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc.core.sensing.touch import Touch, require_depths
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict, judge
from tactile_loc.tracking.key_search import KeySearch, list_poses, measure_motion_m
from tactile_loc.tracking.track_modes import ModeFilter, TrackMode
from tactile_loc.tracking.tracked_pose import TrackedPose, TrackTrust

FITTED_IOU = 0.5  # usual imprint IoU below which a track has never fitted
MOST_DOUBTS = 3  # consecutive touches that no mode explains as well as before; then the whole object is searched
MOST_LOST = 10  # consecutive such touches, after which a search replaces the track even if it is unsure itself
LATEST = 2  # touches that show whether the object has moved since the others
LEAST_MANY = 5  # touches of which a few bad ones do not make a poor fit
LEAST_EXPECTED = 3  # touches where a track expected them, after which it can show a slip
MOST_WEIGHED = 10  # touches after a slip by which its pose is weighed against the pose without the slip
JUMPED_NATS = 1.5  # most that a pose far from a slipped one loses, nats, if the slipped one fits worse than usual
EXPECTED_SURPRISE = 8.0  # squared error, in standard deviations, of a pose that may still be an error of the touch


@dataclass(frozen=True, eq=False)
class Stayed:
    """A track before a slip, which is followed on: its likeliest mode, its trust and its key touches.

    `gain` is the imprint IoU by which it has predicted the `frames` since then better than the track after the slip.
    """

    modes: list[TrackMode]
    trust: TrackTrust
    search: KeySearch
    gain: float = 0.0
    frames: int = 0


class Tracker:
    """Tracks one object from frame to frame, by touches of one or several sensors.

    The object is assumed to rest, except for a slow creep. The creep in one second has standard deviations of `creep_m`
    metres along and `creep_rad` radians about each axis. The object may also slip or jump. The errors of sensor poses
    are taken from the touches (`Touch.T_base_sensor_std_m`). Raises ConfigError for a creep that is negative or not
    finite.

    Another thread searches, and the result is used `tracker.latency_s` seconds later. If the search takes longer, a
    `live` track uses its result as soon as it is there. Other tracks wait, so that they can be repeated exactly.
    """

    def __init__(
        self, localizer: Localizer, creep_m: float = 1e-4, creep_rad: float = 2e-3, *, live: bool = False
    ) -> None:
        if not (0 <= creep_m < math.inf and 0 <= creep_rad < math.inf):
            raise ConfigError(f"an object cannot creep by {creep_m} m and {creep_rad} rad; give 0 or more")
        self.localizer, self.options, self.live = localizer, localizer.config.tracker, live
        self._filter = ModeFilter(localizer, np.diag(np.square([creep_m] * 3 + [creep_rad] * 3)))
        self._latest: TrackedPose | None = None
        self._begin([], TrackTrust(self.options, limit=Verdict.NOT_FOUND, settled=False))

    def latest(self) -> TrackedPose | None:
        """Return the result of the latest `update`, or None before the first. Any thread may call it at any time."""
        return self._latest

    def start(self, T_base_object: Floats, covariance: Floats) -> None:
        """Start again with the object at T_base_object (4, 4), metres, with a covariance (6, 6), as in RefinedPose.

        Without a start, the whole object is searched for the first touches. The base is the frame of the sensor's
        poses. Raises TouchError for an invalid pose or covariance.
        """
        T = require_rigid(T_base_object, "T_base_object", TouchError)
        covariance = require_covariance(covariance, "the covariance of T_base_object", TouchError)
        self._begin([self._filter.start(T, covariance)], TrackTrust(self.options))

    def _begin(self, modes: list[TrackMode], trust: TrackTrust) -> None:
        self._modes, self._trust, self._search = modes, trust, KeySearch(self.localizer)
        self._time_s = -math.inf
        self._T_base_sensor: Floats | None = None  # of the finger whose frame the poses are in
        self._finger = 0  # its number
        self._alike = 0.0  # share of the previous frame's errors that the next frame has, too
        self._check, self._checked_s = KeySearch(self.localizer), math.inf  # the check of a settled track, and its time
        # the search before a touch that no mode explains; the search under way then looks for another pose
        self._undoubted: KeySearch | None = None
        self._expected = 0  # touches where the likeliest mode expected them
        self._doubts = 0  # consecutive touches that the likeliest mode explains far worse than before
        self._stayed: Stayed | None = None  # the track without the latest slip, until it is clear that there was one

    def update(
        self, time_s: float, touches: Touch | Sequence[Touch | None] | None = None, T_base_sensor: Floats | None = None
    ) -> TrackedPose:
        """Return the pose at `time_s` seconds, given the touch of one finger, or an entry for each finger.

        None is a finger without contact. A finger has the same place in the list at all frames. Several fingers need
        `Touch.T_base_sensor`. The pose of a single sensor may also come from `T_base_sensor` (4, 4), metres. Raises
        TouchError if a pose is missing, if time runs backwards, or for a touch of another sensor.
        """
        self._require_later(time_s)
        fingers = [touches] if touches is None or isinstance(touches, Touch) else list(touches)
        seen = [touch for touch in fingers if touch is not None]
        for touch in seen:
            self.localizer.find_localizer(touch)
            require_depths(touch, "a track")
        T = self._place(time_s, fingers, T_base_sensor)
        finger = next((k for k, touch in enumerate(fingers) if touch is not None), self._finger)
        if finger != self._finger:
            self._alike = 0.0
        before, lever_m = self._T_base_sensor, 1e-3 * self.options.lever_mm
        moved_m = 0.0 if before is None else measure_motion_m(before, T, self._filter.gel_m, lever_m)
        passed_s = time_s - self._time_s if math.isfinite(self._time_s) else 0.0
        self._time_s, self._T_base_sensor, self._finger = time_s, T, finger
        self._alike *= math.exp(-1e3 * moved_m / self.options.apart_mm)
        self._modes = self._filter.predict(self._modes, T, passed_s)
        if self._stayed is not None:
            stayed = self._filter.predict(self._stayed.modes, T, passed_s)
            self._stayed = replace(self._stayed, modes=stayed)
        if not seen:
            self._alike = 0.0  # the next contact will have new errors
            return self._result(math.nan, self._search_on(), touched=False)
        first = seen[0]
        if first.T_base_sensor is None or not np.array_equal(first.T_base_sensor, T):
            seen[0] = replace(first, T_base_sensor=T)
        return self._update_touched(seen)

    def _update_touched(self, touches: Sequence[Touch]) -> TrackedPose:
        """Follow the modes to the touches of a frame, look for a slip, and search on."""
        before, alike = self._modes, self._alike
        self._modes, self._alike = self._filter.keep_distinct(self._filter.follow(before, touches, alike)), 1.0
        if self._stayed is not None:
            self._weigh_slip(self._stayed, touches, alike)
        clear = 100 * max(touch.contact_share for touch in touches) >= self.options.clear_percent
        certain = bool(self._modes) and self._trust.limit is Verdict.CERTAIN
        doubted = clear and certain and self._trust.doubts(self._modes[0].predicted_iou)
        self._expected += certain and not doubted and self._modes[0].known.surprise < EXPECTED_SURPRISE
        self._doubts = self._doubts + doubted if doubted or not clear else 0
        fitted = self._trust.usual_iou >= FITTED_IOU  # a track that never fitted is corrected, and shows no slip
        moved = clear and certain and self._suspects_slip(doubted) and self._slip(before, touches, alike)
        if clear and not doubted and self._undoubted is not None:
            self._search, self._undoubted = self._undoubted, None  # the doubtful touches were bad
        if not moved and self._doubts == MOST_DOUBTS and self._undoubted is None:
            self._search, self._undoubted = self._search.restart(touches), self._search
        elif not moved and self._searches:
            self._search = self._search.add_new_places(touches)
        elif not moved and clear and not doubted:
            self._check = self._check.add_new_places(touches)
        searched = self._search_on()
        if not self._modes:
            return self._result(0.0, searched)
        iou = self._modes[0].imprint_iou
        self._trust = self._trust.add_touch(iou)
        return self._result(iou, searched, slipped=moved and fitted)

    @property
    def _searches(self) -> bool:
        """Whether new key touches start a search: until the track is settled, and while it is doubted."""
        return self._undoubted is not None or not self._trust.settled

    def _search_on(self) -> bool:
        """Begin a search if one is due, use the result of one that has ended, and return whether one was under way."""
        self._check_on()
        if self._searches and self._search.is_due:
            self._search = self._search.begin(self._list_poses(), self._time_s)
        if self._search.running is None:
            return False
        self._search, found = self._search.finish(self._time_s, waits=not self.live)
        if found is not None:
            self._adopt(found, self._search.begun)
        return True

    def _check_on(self) -> None:
        """Begin a check of a settled track if one is due, or use its result: key touches located without the track.

        If the touches alone are certain of another pose, the track is not certain, and searches again.
        """
        if self._searches:
            self._check, self._checked_s = self._check.restart(()), math.inf
            return
        self._checked_s = min(self._checked_s, self._time_s)
        if self._check.is_due and self._time_s - self._checked_s >= self.options.check_s > 0:
            self._check, self._checked_s = self._check.begin(np.empty((0, 4, 4)), self._time_s), self._time_s
        self._check, found = self._check.finish(self._time_s, waits=not self.live)
        if self._check.running is not None or not self._check.begun:
            return
        touches, self._check = self._check.begun, self._check.restart(())
        if found is None or found.verdict is not Verdict.CERTAIN:
            return
        tolerance, obj = self.localizer.config.tolerance, self.localizer.object
        if not tolerance.find_within(obj, list_poses(found)[0], self._list_poses()[:1]).all():
            self._search = self._search.restart(touches)
            self._trust = self._trust.restart(Verdict.AMBIGUOUS, 0.5, self._trust.usual_iou)

    def _suspects_slip(self, doubted: bool) -> bool:
        """Return whether a certain mode's registration to the touch leads surprisingly far."""
        surprise, known = self._modes[0].known.surprise, self._expected >= LEAST_EXPECTED
        return known and (surprise > self.options.slip_surprise or (doubted and surprise > EXPECTED_SURPRISE))

    def _slip(self, before: Sequence[TrackMode], touches: Sequence[Touch], alike: float) -> bool:
        """Look for poses to which the modes may have slipped since `before`; return whether one was accepted."""
        slipped, tracked = self._filter.find_slipped(before, touches, alike), self._modes[0]
        if not slipped or slipped[0].imprint_iou < tracked.predicted_iou + self.options.slip_iou:
            return False
        if tracked.known.surprise < self.options.slip_surprise and self._trust.doubts(slipped[0].imprint_iou):
            return False  # the touch is bad: no pose explains it as well as usual
        self._stayed = Stayed(list(before[:1]), self._trust, self._search)
        prior = self._filter.make_slip_prior(before[0], np.asarray(touches[0].T_base_sensor))
        if self._trust.doubts(slipped[0].imprint_iou):
            prior = replace(prior, most_nats=min(prior.most_nats, JUMPED_NATS))  # perhaps the object has jumped
        self._modes, self._search, self._undoubted = slipped, self._search.restart(touches, prior), None
        self._trust = self._trust.restart(Verdict.AMBIGUOUS, 0.0, slipped[0].imprint_iou)
        return True

    def _weigh_slip(self, stayed: Stayed, touches: Sequence[Touch], alike: float) -> None:
        """Weigh the pose after a slip against that without the slip; take the slip back if it did not happen."""
        modes = self._filter.follow(stayed.modes, touches, alike)
        slipped_iou = self._modes[0].predicted_iou if self._modes else 0.0
        gain, frames = stayed.gain + modes[0].predicted_iou - slipped_iou, stayed.frames + 1
        self._stayed = replace(stayed, modes=modes, gain=gain, frames=frames)
        if frames == MOST_WEIGHED:
            self._stayed = None
            if gain > 0:
                self._modes, self._trust, self._search = modes, stayed.trust, stayed.search
                self._undoubted, self._doubts = None, 0

    def _adopt(self, found: Localization, keys: Sequence[Touch]) -> None:
        """Take over the poses that a search of touches found, and trust the first as far as the search does.

        If the modes were doubted, they stay unless the search found a pose that explains its touches clearly better.
        They also stay if it explains them worse than usual, unless the modes do not explain them at all. Then the new
        pose is at most ambiguous, because the object may be another one. The same holds for a pose from one touch.
        """
        new = self._filter.find_all(found)
        if not new:
            return
        (iou,) = self._filter.explain(new[:1], keys)
        unproven = False
        if self._undoubted is not None:
            tracked = max(self._filter.explain(self._modes, keys))
            worse, explained = self._trust.doubts(iou), tracked >= self.options.least_iou
            unsure = found.verdict in (Verdict.NOT_FOUND, Verdict.POOR_FIT) and self._doubts < MOST_LOST
            if unsure or (worse and explained) or (iou - tracked) * len(keys) < self.options.lost_iou:
                return  # a few bad touches do not end a track
            self._undoubted, unproven = None, worse or len(keys) == 1
        self._modes, self._alike = self._filter.view_from(new, np.asarray(self._T_base_sensor)), 0.0
        latest = max(found.best.imprint_ious[-LATEST:], default=iou)
        moved = found.agreement.contradictory and latest < self.options.least_iou
        verdict, few = found.verdict, 2 * len(found.poor_touches) < len(keys) and len(keys) >= LEAST_MANY
        if verdict is Verdict.POOR_FIT and few and not moved:
            verdict = judge(found.outcome, sure=found.is_sure, least=found.confidence)  # a few of many are bad touches
        unproven |= not np.array_equal(new[0].known.T_base_object, np.asarray(found.T_base_object))
        verdict = Verdict.AMBIGUOUS if unproven and verdict is Verdict.CERTAIN else verdict
        self._trust = self._trust.restart(verdict, found.probability_within(), iou, len(keys))
        if verdict is Verdict.CERTAIN:
            self._stayed = None
        if self._trust.settled:
            self._modes = self._modes[:1]
        elif moved:
            self._search = self._search.restart(keys[-1:])  # the object has moved since the first key touches

    def _list_poses(self) -> Poses:
        """Return the modes' poses T_base_object (K, 4, 4), metres."""
        return np.array([mode.known.T_base_object for mode in self._modes]).reshape(-1, 4, 4)

    def _require_later(self, time_s: float) -> None:
        if not math.isfinite(time_s) or time_s < self._time_s:
            raise TouchError(
                f"a frame at {time_s:g} s cannot follow one at {self._time_s:g} s; give frames in the order of time, "
                "or make a new Tracker for another sequence"
            )

    def _place(self, time_s: float, fingers: Sequence[Touch | None], T_base_sensor: Floats | None) -> Floats:
        """Return the pose (4, 4), metres, of the first sensor in contact.

        Without contact, it is that of the only sensor, or that of the last frame. Raises TouchError if a pose is
        missing, or is given twice.
        """
        seen = [touch for touch in fingers if touch is not None]
        if len(fingers) == 1:
            told = T_base_sensor if T_base_sensor is not None or not seen else seen[0].T_base_sensor
            if told is None:
                raise TouchError(f"the frame at {time_s:g} s does not give its sensor's pose; give T_base_sensor")
            return require_rigid(told, f"the sensor's pose at {time_s:g} s", TouchError)
        unknown = [touch.name for touch in seen if touch.T_base_sensor is None]
        if unknown or T_base_sensor is not None:
            raise TouchError(
                f"the frame at {time_s:g} s has several fingers, so each touch must have its T_base_sensor; "
                + (f"{unknown[0]} has none" if unknown else "leave out the other pose")
            )
        if seen:
            return np.asarray(seen[0].T_base_sensor)
        return np.eye(4) if self._T_base_sensor is None else self._T_base_sensor

    def _result(self, imprint_iou: float, searched: bool, touched: bool = True, slipped: bool = False) -> TrackedPose:
        T = np.array([mode.T_sensor_object for mode in self._modes]).reshape(-1, 4, 4)
        covariances = np.array([mode.covariance for mode in self._modes]).reshape(-1, 6, 6)
        p = np.empty(0)
        if self._modes:
            p = self._trust.share(np.exp([mode.nats - self._modes[0].nats for mode in self._modes]))
        verdict = self._trust.judge(bool(self._modes), imprint_iou, touched)
        if verdict is Verdict.CERTAIN and self._undoubted is not None:
            verdict = Verdict.AMBIGUOUS
        best = self._modes[0] if self._modes else None
        self._latest = TrackedPose(
            verdict,
            T,
            p,
            None if best is None else best.covariance,
            imprint_iou,
            time_s=self._time_s,
            T_base_object=None if best is None else best.known.T_base_object,
            base_covariance=None if best is None else best.known.base_covariance,
            covariances=covariances,
            searched=searched,
            slipped=slipped,
        )
        return self._latest
