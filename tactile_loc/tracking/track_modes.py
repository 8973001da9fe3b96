"""The possible poses of a tracked object: predicted from frame to frame, registered to each touch, and weighed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import Floats, Poses, invert, make_transform, make_translation, transform_points
from tactile_loc.core.poses.merging import merge_modes
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.priors import PosePrior
from tactile_loc.core.registration.joint_registration import JointRegistration, RegistrationOptions
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compute_nats
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.freedom import explain_as_well
from tactile_loc.locate.result.localization import Localization
from tactile_loc.tracking.pose_filter import PoseFilter, SeenPose, estimate_motion_errors


@dataclass(frozen=True, eq=False)
class TrackMode:
    """One possible pose of the object.

    `known` is the pose in the base frame. `T_sensor_object` (4, 4), metres, is the pose in the sensor frame, with a
    covariance (6, 6). `nats` is the mode's log-weight, and `imprint_iou`, 0 to 1, states how well it explains the last
    touch. `predicted_iou` is that of the pose before it was registered to this touch.
    """

    known: PoseFilter
    T_sensor_object: Floats
    covariance: Floats
    nats: float = 0.0
    imprint_iou: float = 0.0
    predicted_iou: float = 0.0


@dataclass(frozen=True, eq=False)
class SlipPrior(PosePrior):
    """The prior over T_base_object after a slip from the pose `T` (4, 4), metres.

    The log-weight is -d^2 / (2 s^2), at least -`most_nats`, because the object may also have jumped. The distance d is
    that of the pose metric, up to symmetry, and s is `std_m`, metres.
    """

    T: Floats
    std_m: float
    most_nats: float
    metric: PoseMetric

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the log-weights (N,), 0 at the pose T, of poses (N, 4, 4), metres."""
        far_m = self.metric.symmetric_distance(T_sensor_object, self.T[None])
        return np.asarray(np.maximum(-0.5 * (far_m / self.std_m) ** 2, -self.most_nats))


class ModeFilter:
    """Moves modes along with the sensor, and registers them to touches.

    The object creeps by a covariance (6, 6) in one second.
    """

    def __init__(self, localizer: Localizer, creep: Floats) -> None:
        self.localizer, self.creep = localizer, creep
        self.options = options = localizer.config.tracker
        nearby = RegistrationOptions(scale_mm=options.near_mm, iterations=options.iterations)
        self._nearby, self._first = JointRegistration(nearby), localizer.registration
        self._slip_std = np.array([1e-3 * options.slip_mm] * 3 + [math.radians(options.slip_deg)] * 3)
        self._metric = PoseMetric(localizer.object)

    @property
    def gel_m(self) -> Floats:
        """The middle of the gel (3,), metres, in the sensor frame."""
        return self.localizer.scene.geometry.gel_middle_m

    def start(self, T_base_object: Floats, covariance: Floats) -> TrackMode:
        """Return the mode of a known pose (4, 4), metres, with a covariance (6, 6)."""
        known = PoseFilter.known(T_base_object, covariance)
        return TrackMode(known, known.T_base_object, covariance)

    def predict(self, modes: Sequence[TrackMode], T_base_sensor: Floats, passed_s: float) -> list[TrackMode]:
        """Predict modes for a sensor at T_base_sensor (4, 4), metres, `passed_s` seconds later."""
        crept = [replace(mode, known=mode.known.predict(self.creep * passed_s)) for mode in modes]
        return self.view_from(crept, T_base_sensor)

    def follow(self, modes: Sequence[TrackMode], touches: Sequence[Touch], alike: float) -> list[TrackMode]:
        """Register modes to the touches of a frame and fuse them with these. Modes are in the first touch's frame.

        `alike`, 0 to 1, is the share of the previous frame's errors that this frame has, too.
        """
        if not modes:
            return []
        views = self.localizer.make_views(touches)
        poses = np.stack([mode.T_sensor_object for mode in modes])
        registration = self._nearby if alike > 0 else self._first
        registered, covariances = registration.follow(views, poses, reported=len(views) > 1)
        followed = []
        for mode, T, covariance in zip(modes, registered, covariances, strict=True):
            if covariance is not None:
                seen = self._see(touches, T, covariance)
                fused = replace(mode, known=mode.known.update(seen, 1 - alike))
                mode = self._view(fused, np.asarray(touches[0].T_base_sensor))
            followed.append(mode)
        after = np.stack([mode.T_sensor_object for mode in followed])
        ious = self._average_ious(views, np.concatenate([poses, after])).reshape(2, -1)
        return [
            replace(mode, predicted_iou=float(predicted), imprint_iou=float(iou))
            for mode, predicted, iou in zip(followed, *ious, strict=True)
        ]

    def find_slipped(self, modes: Sequence[TrackMode], touches: Sequence[Touch], alike: float) -> list[TrackMode]:
        """Return modes to which the two likeliest modes may have slipped, registered to touches, the best first.

        `alike` is as for `follow`. Only poses farther from their modes than errors explain are returned.
        """
        views, T_base_sensor = self.localizer.make_views(touches), np.asarray(touches[0].T_base_sensor)
        starts, ends = self._guess_slips(modes, views)
        registered, covariances = self._first.follow(views, ends, reported=len(views) > 1)
        T_base_gel = T_base_sensor @ make_translation(self.gel_m)
        slipped = []
        for k, T, covariance in zip(starts, registered, covariances, strict=True):
            if covariance is None:
                continue
            known, seen = modes[k].known, self._see(touches, T, covariance)
            if known.measure_surprise(seen, 1 - alike) > self.options.slip_surprise:
                creep = estimate_motion_errors(np.diag(self._slip_std**2), T_base_gel, known.T_base_object)
                slipped.append(TrackMode(known.predict(creep).update(seen, 1.0), T, covariance))
        if not slipped:
            return []
        ious = self.explain(slipped, touches)
        nats = compute_nats(np.array(ious), len(touches))
        return self.keep_distinct(
            [
                replace(self._view(mode, T_base_sensor), imprint_iou=iou, nats=float(weight))
                for mode, iou, weight in zip(slipped, ious, nats, strict=True)
            ]
        )

    def make_slip_prior(self, mode: TrackMode, T_base_sensor: Floats) -> SlipPrior:
        """Return the prior over poses after a slip from a mode, whose gel is at T_base_sensor (4, 4), metres."""
        gel_m = transform_points(invert(mode.known.T_base_object) @ T_base_sensor, self.gel_m[None])
        lever_m = float(np.sqrt(np.mean(np.sum((self.localizer.object.mesh.vertices_m - gel_m) ** 2, axis=1))))
        std_m = float(np.hypot(np.sqrt(3) * self._slip_std[0], np.sqrt(2) * self._slip_std[3] * lever_m))
        return SlipPrior(mode.known.T_base_object, std_m, self.options.stay_nats, self._metric)

    def find_all(self, found: Localization) -> list[TrackMode]:
        """Return a search's hypotheses as modes, the most probable first.

        Of the poses that explain the touches as well as the first one, the one that the prior favours most comes first.
        """
        known = [one for one in found.hypotheses if one.T_base_object is not None and one.base_covariance is not None]
        as_well = explain_as_well(np.array([one.imprint_iou for one in known]), found.best.imprint_iou, found.as_well)
        favoured = [one.prior_nats if well else -np.inf for one, well in zip(known, as_well, strict=True)]
        modes: list[TrackMode] = []
        for k in sorted(range(len(known)), key=lambda k: -favoured[k])[: self.options.modes]:
            one = known[k] if modes else replace(known[k], probability=found.best.probability)
            nats = math.log(max(one.probability, 1e-300))
            pose = PoseFilter.known(np.asarray(one.T_base_object), np.asarray(one.base_covariance))
            modes.append(TrackMode(pose, pose.T_base_object, pose.base_covariance, nats, one.imprint_iou))
        return modes

    def view_from(self, modes: Sequence[TrackMode], T_base_sensor: Floats) -> list[TrackMode]:
        """Return modes as seen from a sensor at T_base_sensor (4, 4), metres."""
        return [self._view(mode, T_base_sensor) for mode in modes]

    def explain(self, modes: Sequence[TrackMode], touches: Sequence[Touch]) -> list[float]:
        """Return how well modes explain touches: their mean imprint IoUs, 0 to 1."""
        poses = np.array([mode.known.T_base_object for mode in modes]).reshape(-1, 4, 4)
        views = self.localizer.make_views(touches)
        return self._average_ious(views, invert(np.asarray(touches[0].T_base_sensor)) @ poses).tolist()

    def _average_ious(self, views: Sequence[View], T_first_object: Poses) -> Floats:
        """Return the mean imprint IoUs (K,), 0 to 1, of poses (K, 4, 4), metres, in the first sensor's frame."""
        each = [view.imprint_ious(T_first_object, self.options.image_px) for view in views]
        return np.asarray(np.mean(each, axis=0))

    def keep_distinct(self, modes: Sequence[TrackMode]) -> list[TrackMode]:
        """Return the likeliest modes, except modes near a likelier one or much less probable than the best one."""
        ordered = sorted(modes, key=lambda mode: -mode.nats)
        least = ordered[0].nats + math.log(self.options.improbable) if ordered else 0.0
        ordered = [mode for mode in ordered if mode.nats >= least]
        poses = np.array([mode.known.T_base_object for mode in ordered]).reshape(-1, 4, 4)
        of = merge_modes(poses, self._metric, self.localizer.source.setup.merge_radius_m, self.options.modes)
        return [ordered[k] for k in np.unique(of[of >= 0])]

    def _guess_slips(self, modes: Sequence[TrackMode], views: Sequence[View]) -> tuple[list[int], Floats]:
        """Guess poses to which the two likeliest modes may have slipped, register them, and keep distinct ones.

        Returns the numbers (K,) of their modes, and their poses (K, 4, 4), metres, in the sensor frame.
        """
        count = self.options.slips
        numbers = np.arange(count) % min(len(modes), 2)
        moves = np.random.default_rng(count).normal(size=(count, 6)) * self._slip_std
        moves[:2] = 0.0
        R = Rotation.from_rotvec(moves[:, 3:]).as_matrix()
        moved = make_transform(R, self.gel_m - R @ self.gel_m + moves[:, :3])
        ends = self._first.register_coarsely(
            views, moved @ np.stack([modes[k].T_sensor_object for k in numbers.tolist()])
        )
        ious = self._average_ious(views, ends)
        order = np.argsort(-ious, kind="stable")
        of = merge_modes(ends[order], self._metric, self.localizer.source.setup.merge_radius_m, self.options.modes)
        kept = order[np.unique(of[of >= 0])]
        return numbers[kept].tolist(), ends[kept]

    def _view(self, mode: TrackMode, T_base_sensor: Floats) -> TrackMode:
        T, covariance = mode.known.view_from(T_base_sensor, self.gel_m)
        return replace(mode, T_sensor_object=T, covariance=covariance)

    def _see(self, touches: Sequence[Touch], T_sensor_object: Floats, covariance: Floats) -> SeenPose:
        """Return a pose (4, 4), metres, registered to touches with a covariance (6, 6), in the filter's form.

        For several touches, the covariance already contains the errors of the sensors' poses.
        """
        touch = touches[0]
        std_m, std_rad = (0.0, 0.0) if len(touches) > 1 else (touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad)
        sensor = np.diag(np.square([std_m] * 3 + [std_rad] * 3))
        common, covariance = self.options.common, self.options.touch_noise * covariance
        return SeenPose(
            np.asarray(touch.T_base_sensor),
            T_sensor_object,
            common * covariance,
            (1 - common) * covariance,
            sensor,
            self.gel_m,
        )
