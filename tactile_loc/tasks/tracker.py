"""Tracking of an object from frame to frame, while a sensor slides and rotates over it.

A few possible poses, the modes, are predicted from the sensor's motion and registered to each touch. Prediction and
touch are fused. So the prediction determines what the touch does not show, such as a bolt's rotation.

Keyframes are touches at places far enough apart; their evidence decides between modes. If no mode explains the touch,
nearby poses are tried, in case the object slipped. If that fails, or no mode is certain, the whole object is searched
with all keyframes together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.errors import ConfigError, GridError, TouchError
from tactile_loc.core.geometry.rigid import (
    invert,
    make_transform,
    make_translation,
    require_covariance,
    require_rigid,
    rotate_covariance,
)
from tactile_loc.core.poses.merging import merge_modes
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.registration.joint_registration import JointRegistration, RegistrationOptions
from tactile_loc.core.sensing.touch import Touch, require_depths
from tactile_loc.core.slots.scene import View
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.results.localization import Localization
from tactile_loc.locate.results.verdict import Verdict
from tactile_loc.tasks.key_touches import measure_motion_m
from tactile_loc.tasks.pose_filter import PoseFilter, SeenPose, estimate_motion_errors
from tactile_loc.tasks.tracked_pose import TrackedPose, TrackTrust

Floats = NDArray[np.float64]

AGREEING_M = 1e-3  # largest surface distance between a mode and the pose of a search that confirms it


@dataclass(frozen=True, eq=False)
class Motion:
    """The sensor's motion since the previous frame, T_previous_sensor (4, 4), metres, and the covariance of its error.

    The error is x, y, z of the new sensor frame's origin (m) and a rotation vector (rad), along the previous sensor's
    axes. Raises TouchError for an invalid pose or covariance (6, 6).
    """

    T_previous_sensor: Floats
    covariance: Floats

    def __post_init__(self) -> None:
        T = require_rigid(self.T_previous_sensor, "the sensor's motion", TouchError)
        covariance = require_covariance(self.covariance, "the covariance of the sensor's motion", TouchError)
        object.__setattr__(self, "T_previous_sensor", T)
        object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True, eq=False)
class _Mode:
    """One possible pose of the object.

    `known` is the pose in the base frame. `T_sensor_object` (4, 4), metres, is the pose in the sensor frame, with a
    covariance (6, 6). `evidence`, nats, and `imprint_iou`, 0 to 1, state how well the pose explains the touches.
    """

    known: PoseFilter
    T_sensor_object: Floats
    covariance: Floats
    evidence: float = 0.0
    imprint_iou: float = 0.0


class Tracker:
    """Tracks one object from frame to frame, by touches of one sensor.

    The object is assumed to rest, except for a slow creep. The creep in one second has standard deviations of `creep_m`
    metres along and `creep_rad` radians about each axis. The object may also jump. The errors of sensor poses are taken
    from the touches (`Touch.T_base_sensor_std_m`). Raises ConfigError for a creep that is negative or not finite.
    """

    def __init__(self, localizer: Localizer, creep_m: float = 1e-4, creep_rad: float = 2e-3) -> None:
        if not (0 <= creep_m < math.inf and 0 <= creep_rad < math.inf):
            raise ConfigError(f"an object cannot creep by {creep_m} m and {creep_rad} rad; give 0 or more")
        self.localizer = localizer
        self._creep = np.diag(np.square([creep_m] * 3 + [creep_rad] * 3))
        self.options = options = localizer.config.tracker
        nearby = RegistrationOptions(scale_mm=options.near_mm, iterations=options.iterations)
        self._registration, self._first_registration = JointRegistration(nearby), localizer.refinement.registration
        self._slip_std = np.array([1e-3 * options.slip_mm] * 3 + [math.radians(options.slip_deg)] * 3)
        self._metric = PoseMetric(localizer.object)
        self._modes: list[_Mode] = []
        self._keyframes: list[Touch] = []
        self._time_s = -math.inf
        self._T_base_sensor: Floats | None = None
        self._relative = False
        self._usual, self._elsewhere = 0.0, 0.0
        self._trust = TrackTrust(options)
        self._alike = 0.0  # share of the previous touch's errors that the next touch has, too

    def start(self, T_base_object: Floats, covariance: Floats) -> None:
        """Start again with the object at T_base_object (4, 4), metres, with a covariance (6, 6), as in RefinedPose.

        Without a start, the whole object is searched for the first touch. The base is the frame of the sensor's poses.
        If motions are given instead, the base is the sensor frame at the first frame. Raises TouchError for an invalid
        pose or covariance.
        """
        T = require_rigid(T_base_object, "T_base_object", TouchError)
        covariance = require_covariance(covariance, "the covariance of T_base_object", TouchError)
        known = PoseFilter.known(T, covariance)
        self._modes, self._keyframes, self._elsewhere = [_Mode(known, known.T_base_object, covariance)], [], 0.0
        self._time_s, self._T_base_sensor, self._usual, self._alike = -math.inf, None, 0.0, 0.0
        self._trust = TrackTrust(self.options)

    def update(
        self, time_s: float, touch: Touch | None = None, T_base_sensor: Floats | None = None,
        motion: Motion | None = None,
    ) -> TrackedPose:  # fmt: skip
        """Return the pose at `time_s` seconds, given a touch, or None without contact.

        The sensor's pose comes from the touch, from `T_base_sensor` (4, 4), metres, or from the sensor's `motion` since
        the previous frame. Give poses for all frames, or motions for all. Raises TouchError if neither is given, if
        time runs backwards, or for a touch of another sensor.
        """
        self._require_later(time_s)
        if touch is not None:
            self.localizer.require_own(touch)
            require_depths(touch, "a track")
        T, added = self._place(time_s, touch, T_base_sensor, motion)
        moved_m = 0.0 if self._T_base_sensor is None else self._motion_m(self._T_base_sensor, T)
        passed_s = time_s - self._time_s if math.isfinite(self._time_s) else 0.0
        self._time_s, self._T_base_sensor = time_s, T
        self._alike *= math.exp(-1e3 * moved_m / self.options.apart_mm)
        self._modes = [self._predict(mode, T, passed_s, added) for mode in self._modes]
        if touch is None:
            self._alike = 0.0  # the next contact will have new errors
            return self._result(math.nan, searched=False, touched=False)
        return self._update_touched(replace(touch, T_base_sensor=T))

    def _update_touched(self, touch: Touch) -> TrackedPose:
        """Follow the modes to a touch; search if no mode explains it, or if no mode is certain at a new keyframe.

        A search also confirms a mode that came from few touches, after some keyframes.
        """
        is_keyframe = (
            not self._keyframes
            or self._motion_m(self._keyframes[-1].T_base_sensor, touch.T_base_sensor) > 1e-3 * self.options.keyframe_mm
        )
        self._modes = self._follow(touch, is_keyframe)
        slips = bool(self._modes) and self._is_contradicted(is_keyframe)
        slipped = slips and self._slip(touch, is_keyframe)
        contradicted = not self._modes or self._is_contradicted(is_keyframe)
        search = contradicted or (
            is_keyframe
            and self._probabilities()[0] < self.options.certain
            and len(self._keyframes) < self.options.keyframes
        )
        keys = self._keyframes
        if slipped:
            keys = [touch]
        elif is_keyframe:
            keys = [*keys, touch][-self.options.keyframes :]
        found = self._search(touch, [touch] if contradicted else keys) if search else None
        self._keyframes = [touch] if contradicted and found else keys
        search = search or slips
        if not self._modes:
            return self._result(0.0, search)
        iou = self._modes[0].imprint_iou
        self._usual = iou if search else max(iou, (1 - self.options.habit) * self._usual + self.options.habit * iou)
        if found or slipped:
            self._trust = self._trust.restart(found or Verdict.AMBIGUOUS, iou, nearby=not found)
        else:
            self._trust = self._trust.add_touch(iou, is_keyframe)
        confirm = self._trust.needs_search
        if confirm:
            self._trust = self._trust.restart(self._confirm(self._keyframes), iou)
        return self._result(iou, search or confirm)

    @property
    def _gel_m(self) -> Floats:
        return self.localizer.scene.geometry.gel_middle_m

    def _motion_m(self, T_base_first: Any, T_base_second: Any) -> float:
        """Return the distance the gel moved between sensor poses (4, 4), metres; a rotation counts with `lever_mm`."""
        return measure_motion_m(T_base_first, T_base_second, self._gel_m, 1e-3 * self.options.lever_mm)

    def _probabilities(self) -> Floats:
        evidence = np.array([mode.evidence for mode in self._modes])
        weights = np.exp(evidence - evidence.max(initial=-np.inf))
        return np.asarray((1 - self._elsewhere) * weights / weights.sum())

    def _require_later(self, time_s: float) -> None:
        if not math.isfinite(time_s) or time_s < self._time_s:
            raise TouchError(
                f"a frame at {time_s:g} s cannot follow one at {self._time_s:g} s; give frames in the order of time, "
                "or make a new Tracker for another sequence"
            )

    def _place(
        self, time_s: float, touch: Touch | None, T_base_sensor: Floats | None, motion: Motion | None
    ) -> tuple[Floats, Floats | None]:
        """Return the sensor's pose (4, 4), and the covariance that its motion adds, along the base's axes."""
        told = T_base_sensor if T_base_sensor is not None or touch is None else touch.T_base_sensor
        before = self._T_base_sensor
        relative = told is None if before is None else self._relative
        if (told is None) != relative or (before is not None and told is None and motion is None):
            raise TouchError(
                f"the frame at {time_s:g} s does not give its sensor's pose as the first one does; give T_base_sensor "
                "for all frames, or motions for all"
            )
        self._relative = relative
        if told is not None:
            return require_rigid(told, f"the sensor's pose at {time_s:g} s", TouchError), None
        if before is None or motion is None:
            return np.eye(4), None
        T = before @ motion.T_previous_sensor
        return T, rotate_covariance(motion.covariance, before[:3, :3])

    def _predict(self, mode: _Mode, T: Floats, passed_s: float, added: Floats | None) -> _Mode:
        """Predict a mode for a sensor at T (4, 4), `passed_s` seconds later."""
        creep = self._creep * passed_s
        if added is not None:
            creep = creep + estimate_motion_errors(added, T, mode.known.T_base_object)
        return self._see_from(replace(mode, known=mode.known.predict(creep)), T)

    def _see_from(self, mode: _Mode, T_base_sensor: Floats) -> _Mode:
        T, covariance = mode.known.view_from(T_base_sensor, self._gel_m)
        return replace(mode, T_sensor_object=T, covariance=covariance)

    def _see(self, touch: Touch, T_sensor_object: Floats, covariance: Floats) -> SeenPose:
        """Return a pose (4, 4), metres, registered to a touch with a covariance (6, 6), in the filter's form."""
        std_m, std_rad = (0.0, 0.0) if self._relative else (touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad)
        sensor = np.diag(np.square([std_m] * 3 + [std_rad] * 3))
        T = np.asarray(touch.T_base_sensor)
        common = self.options.common
        return SeenPose(T, T_sensor_object, common * covariance, (1 - common) * covariance, sensor, self._gel_m)

    def _follow(self, touch: Touch, is_keyframe: bool) -> list[_Mode]:
        """Register the modes to a touch, fuse them with it, and merge them. A keyframe also adds its evidence."""
        if not self._modes:
            return []
        view = View(touch, self.localizer.scene.match_touch(touch))
        registration = self._registration if self._alike > 0 else self._first_registration
        poses, covariances = registration.follow([view], np.stack([mode.T_sensor_object for mode in self._modes]))
        modes = []
        for mode, T, covariance in zip(self._modes, poses, covariances, strict=True):
            if covariance is not None:
                known = mode.known.update(self._see(touch, T, covariance), 1 - self._alike)
                mode = self._see_from(replace(mode, known=known), np.asarray(touch.T_base_sensor))
            modes.append(mode)
        self._alike = 1.0
        found = view.compare_imprints(np.stack([mode.T_sensor_object for mode in modes]), self.options.image_px)
        weighed = [
            replace(mode, imprint_iou=float(iou), evidence=mode.evidence + is_keyframe * float(nats))
            for mode, iou, nats in zip(modes, found.imprint_ious, found.evidence, strict=True)
        ]
        return self._keep_distinct(weighed)

    def _is_contradicted(self, is_keyframe: bool) -> bool:
        """Return whether the likeliest mode explains a touch far worse than before, or does not explain a keyframe."""
        iou = self._modes[0].imprint_iou
        return iou < self._usual - min(self.options.fall_iou, self._usual / 2) or (
            is_keyframe and iou < self.options.least_iou
        )

    def _keep_distinct(self, modes: Sequence[_Mode]) -> list[_Mode]:
        """Return the likeliest modes, except modes near a likelier one or much less probable than the best one."""
        ordered = sorted(modes, key=lambda mode: -mode.evidence)
        least = ordered[0].evidence + math.log(self.options.improbable) if ordered else 0.0
        ordered = [mode for mode in ordered if mode.evidence >= least]
        poses = np.array([mode.T_sensor_object for mode in ordered]).reshape(-1, 4, 4)
        of = merge_modes(poses, self._metric, self.localizer.merge_radius_m, self.options.modes)
        return [ordered[k] for k in np.unique(of[of >= 0])]

    def _slip(self, touch: Touch, is_keyframe: bool) -> bool:
        """Search the poses to which the likeliest modes may have slipped; return whether one of them was accepted."""
        view = View(touch, self.localizer.scene.match_touch(touch))
        slipped = self._guess_slips(view)
        poses, covariances = self._first_registration.follow([view], np.stack([m.T_sensor_object for m in slipped]))
        T_base_sensor = np.asarray(touch.T_base_sensor)
        T_base_gel = T_base_sensor @ make_translation(self._gel_m)
        new = []
        for mode, T, covariance in zip(slipped, poses, covariances, strict=True):
            if covariance is not None:
                creep = estimate_motion_errors(np.diag(self._slip_std**2), T_base_gel, mode.known.T_base_object)
                known = mode.known.predict(creep).update(self._see(touch, T, covariance), 1.0)
                new.append(self._see_from(replace(mode, known=known, evidence=self.options.slip_nats), T_base_sensor))
        before, tracked = self._modes, self._weigh_staying([touch])
        self._modes = self._keep_distinct([*tracked, *self._weigh(new, [touch])])
        if self._modes[0] not in tracked and not self._is_contradicted(is_keyframe):
            return True
        self._modes = before  # the touch is bad, or the object is far away
        return False

    def _guess_slips(self, view: View) -> list[_Mode]:
        """Guess poses to which the two likeliest modes may have slipped, register them, and keep distinct ones."""
        slips = self.options.slips
        rng = np.random.default_rng(slips)
        modes = [self._modes[k] for k in np.arange(slips) % min(len(self._modes), 2)]
        moves = rng.normal(size=(slips, 6)) * self._slip_std
        R = Rotation.from_rotvec(moves[:, 3:]).as_matrix()
        rotated = make_transform(R, self._gel_m - R @ self._gel_m + moves[:, :3])
        ends = self._first_registration.register_coarsely(
            [view], rotated @ np.stack([mode.T_sensor_object for mode in modes])
        )
        found = view.compare_imprints(ends, self.options.image_px)
        return self._keep_distinct([
            replace(mode, T_sensor_object=T, evidence=float(nats))
            for mode, T, nats in zip(modes, ends, found.evidence, strict=True)
        ])  # fmt: skip

    def _search(self, touch: Touch, keys: Sequence[Touch]) -> Verdict | None:
        """Search the whole object with keyframes; weigh the poses found and the tracked modes together.

        Return the verdict of the search, or None if its touch is bad and the track is right.
        """
        try:
            found = localize_together([(self.localizer, key) for key in keys])
        except GridError:
            return None if self._modes else Verdict.NOT_FOUND
        new = []
        for hypothesis in found.hypotheses:
            covariance = hypothesis.refined.covariance
            if covariance is not None:
                known = PoseFilter.of_touch(self._see(keys[0], hypothesis.T_sensor_object, covariance))
                new.append(_Mode(known, *known.view_from(np.asarray(touch.T_base_sensor), self._gel_m)))
        self._alike = 1.0
        tracked = self._weigh_staying(keys)
        self._modes = self._keep_distinct([*tracked, *self._weigh(new, keys)])
        lost = self._modes[0] not in tracked
        if not lost and len(keys) == 1:  # the touch is bad, and the track is right
            self._modes = self._keep_distinct(tracked)
            return None
        self._elsewhere = found.posterior.elsewhere
        return self._rate(found)

    def _confirm(self, keys: Sequence[Touch]) -> Verdict:
        """Return the verdict of a search with keyframes on the likeliest mode. The modes stay the same."""
        try:
            return self._rate(localize_together([(self.localizer, key) for key in keys]))
        except GridError:
            return Verdict.NOT_FOUND

    def _rate(self, found: Localization) -> Verdict:
        """Return the verdict of a search on the likeliest mode; "ambiguous" if the search prefers another pose."""
        T = np.asarray(found.touch.T_base_sensor) @ found.best.T_sensor_object
        off_m = self._metric.symmetric_distance(T[None], self._modes[0].known.T_base_object[None])[0]
        return found.verdict if off_m < AGREEING_M else Verdict.AMBIGUOUS

    def _weigh_staying(self, keys: Sequence[Touch]) -> list[_Mode]:
        """Weigh the tracked modes by keyframes; each gets a bonus, because objects rarely jump."""
        best = max((mode.evidence for mode in self._modes), default=0.0)
        return self._weigh(
            [replace(mode, evidence=self.options.stay_nats + mode.evidence - best) for mode in self._modes], keys
        )

    def _weigh(self, modes: Sequence[_Mode], keys: Sequence[Touch]) -> list[_Mode]:
        """Add the evidence of all keyframes to modes, and set the modes' imprint IoU with the last keyframe."""
        if not modes:
            return []
        poses = np.stack([mode.known.T_base_object for mode in modes])
        nats = np.array([mode.evidence for mode in modes])
        ious = np.zeros(len(modes))
        for key in keys:
            scene = self.localizer.scene.match_touch(key)
            found = scene.compare_imprints(invert(np.asarray(key.T_base_sensor)) @ poses, key, self.options.image_px)
            nats, ious = nats + found.evidence, found.imprint_ious
        return [replace(m, evidence=float(n), imprint_iou=float(i)) for m, n, i in zip(modes, nats, ious, strict=True)]

    def _result(self, imprint_iou: float, searched: bool, touched: bool = True) -> TrackedPose:
        T = np.array([mode.T_sensor_object for mode in self._modes]).reshape(-1, 4, 4)
        covariances = np.array([mode.covariance for mode in self._modes]).reshape(-1, 6, 6)
        p = self._probabilities() if self._modes else np.empty(0)
        verdict = self._trust.judge(float(p[0]) if len(p) else None, imprint_iou, self._elsewhere, touched)
        return TrackedPose(self._time_s, verdict, T, covariances, p, imprint_iou, searched)
