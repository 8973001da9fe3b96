"""The sensor's mount on a robot's flange, found from touches of one part at rest at an unknown pose.

Each touch is located separately. The mount on which most touches agree (`mount_guess`) predicts the part's pose in each
sensor's frame. Each touch is registered again from the predicted pose, and one mount is fitted to all touches. These
two steps are repeated until the poses converge.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactile_loc.core.geometry.hand_eye import (
    TRUSTED,
    HandEyeFit,
    estimate_typical_variance,
    fit_hand_eye,
    measure_turns,
    predict,
)
from tactile_loc.core.geometry.lie import compute_pose_errors, move_covariance
from tactile_loc.core.geometry.pose_words import name_line
from tactile_loc.core.geometry.rigid import Bools, Floats, Poses, rotation_angle
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.runtime.errors import GridError, MountError, TouchError
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.mount_files import HandEyeRecord, HandEyeTouchRecord, Mount
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.locate.touch_files import read_listed_touch
from tactile_loc.planning.hand_eye_starts import HandEyeStart, list_hand_eye_starts

HYPOTHESES = 100  # most hypotheses per touch
GUESSES = 3  # mounts that are refined
LEAST = 4  # touches that must agree; any three have hypotheses that agree
ROTATED_RAD = np.radians(3.0)  # least rotation about two axes, root mean square over pairs of flange poses
LIMIT_M, LIMIT_RAD = 2e-3, np.radians(2.0)  # standard deviations above which a mount is unknown
NOMINAL_M, NOMINAL_RAD = 0.03, np.radians(30.0)  # largest error of a nominal mount
SHORT = 0.25  # a touch agrees if its imprint IoU is less than this below that of its best hypothesis
ROUNDS, STILL_M = 30, 5e-6  # most steps of refinement, and motion below which they end
REJECTIONS = 3  # rounds of looking for touches that contradict the others
NOTHING = np.diag([0.03**2] * 3 + [3.0**2] * 3)  # covariance (6, 6), m and rad, if a touch determines nothing


@dataclass(frozen=True, eq=False)
class FlangeTouches:
    """N touches of one object at rest by one sensor, with the flange's poses T_base_flange (N, 4, 4), metres.

    A touch's `T_base_sensor_std_m` and `T_base_sensor_std_rad` are standard deviations of the flange's pose.
    """

    touches: tuple[Touch, ...]
    T_base_flange: Poses

    def __len__(self) -> int:
        return len(self.touches)

    def select(self, some: Bools) -> FlangeTouches:
        """Return the touches marked in `some` (N,)."""
        return FlangeTouches(tuple(itertools.compress(self.touches, some)), self.T_base_flange[some])

    @property
    def gel_m(self) -> Floats:
        """The gel's middle (N, 3), metres, in each touch's sensor frame."""
        return np.array([[0.0, 0.0, touch.geometry.standoff_m] for touch in self.touches])


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """A mount found from N touches: the `fit` to the touches `kept` (N,), and the `guess` from which it started.

    `T_sensor_object` (N, 4, 4), metres, is the object's pose from each touch separately, registered from the pose that
    the mount predicts. `imprint_ious` (N,), 0 to 1, are the touches' imprint IoUs with the predicted poses. `best_ious`
    (N,), 0 to 1, are the imprint IoUs of each touch's own best hypothesis.
    """

    given: FlangeTouches
    guess: HandEyeStart
    fit: HandEyeFit
    kept: Bools
    T_sensor_object: Poses
    imprint_ious: Floats
    best_ious: Floats

    @property
    def mount(self) -> Mount:
        """The mount found: T_flange_sensor and its covariance."""
        return Mount(self.fit.T_flange_sensor, self.fit.covariance)

    @property
    def residuals(self) -> Floats:
        """Distances (N, 2) of the measured poses from the mount's predictions: metres at the gel's middle, radians."""
        return self._residuals(self.fit.T_flange_sensor, self.fit.T_base_object)

    @property
    def first_residuals(self) -> Floats:
        """Distances (N, 2) of the measured poses from the first guess's predictions.

        Distances are in metres, measured at the gel's middle, and in radians.
        """
        return self._residuals(self.guess.T_flange_sensor, self.guess.T_base_object)

    def _residuals(self, X: Floats, Y: Floats) -> Floats:
        S = self.T_sensor_object
        e = compute_pose_errors(predict(self.given.T_base_flange, X, Y), S)
        shift = e[:, :3] + np.cross(e[:, 3:], self.given.gel_m - S[:, :3, 3])
        return np.stack([np.linalg.norm(shift, axis=1), np.linalg.norm(e[:, 3:], axis=1)], axis=1)

    def explain_left_out(self, number: int) -> str:
        """Return why a touch was left out; "" if it was not left out."""
        if self.kept[number]:
            return ""
        iou, best = self.imprint_ious[number], self.best_ious[number]
        if iou > best - SHORT:
            off_m, off_rad = self.residuals[number]
            return f"its pose of the object differs by {1e3 * off_m:.2f} mm and {np.degrees(off_rad):.2f} degrees"
        return (
            f"its imprint IoU is {100 * iou:.0f} % for the object's pose in the other touches, but {100 * best:.0f} % "
            "for another pose"
        )


def read_flange_touches(localizer: Localizer, path: Path) -> FlangeTouches:
    """Read a list of touches of one sensor at known flange poses. Raises TactileLocError for bad input."""
    listed = read_touch_list(path, of_flange=True)
    own = localizer.config.sensor
    others = sorted({str(one.sensor) for one in listed} - {"None", own.name, str(own.options.get("path"))})
    if others:
        raise TouchError(
            f"{path} has touches of the sensor {others[0]}, not of {own.name}; give `sensor` {others[0]}, and touches "
            "of one sensor"
        )
    touches = tuple(read_listed_touch(localizer, one) for one in listed)
    return FlangeTouches(touches, np.array([one.T_base_flange for one in listed]))


def calibrate_hand_eye(localizer: Localizer, given: FlangeTouches, nominal: Mount | None = None) -> HandEyeCalibration:
    """Find the mount of the localizer's sensor, and the object's pose, from touches at known flange poses.

    A `nominal` mount limits the search to mounts within NOMINAL_M and NOMINAL_RAD. Raises MountError if there are too
    few touches, if too few touches agree, or if the flange's motions do not determine the mount.
    """
    require_motions(given)
    located = _locate(localizer, given.touches)
    hypotheses = [np.array([h.T_sensor_object for h in some]).reshape(-1, 4, 4) for some in located]
    metric = PoseMetric(localizer.object)
    allowed = None if nominal is None else lambda X: _is_near(X, nominal.T_flange_sensor)
    guesses = list_hand_eye_starts(given.T_base_flange, hypotheses, metric, GUESSES, allowed)
    best_ious = np.array([max((h.imprint_iou for h in some), default=0.0) for some in located])
    found = []
    with localizer.progress.task("refining the mount", len(guesses)) as advance:
        for guess in guesses:
            found.append(_refine(localizer, given, guess, best_ious))
            advance(1)
    best = max(found, key=lambda one: (one.kept.sum(), one.imprint_ious.mean()), default=None)
    return _require_known(best, given, nominal)


def make_hand_eye_record(localizer: Localizer, found: HandEyeCalibration) -> HandEyeRecord:
    """Make the record of a mount, in SI units, with the residuals of every touch."""
    touches = [
        HandEyeTouchRecord(
            name=touch.name,
            residual_m=float(last[0]),
            residual_rad=float(last[1]),
            first_residual_m=float(first[0]),
            first_residual_rad=float(first[1]),
            imprint_iou=float(iou),
            left_out=found.explain_left_out(number),
        )
        for number, (touch, last, first, iou) in enumerate(
            zip(found.given.touches, found.residuals, found.first_residuals, found.imprint_ious, strict=True)
        )
    ]
    fit, sensor = found.fit, localizer.config.sensor
    sensor_name = Path(str(sensor.options["path"])).stem if "path" in sensor.options else sensor.name
    return HandEyeRecord(
        T_flange_sensor=fit.T_flange_sensor.tolist(),
        covariance=fit.covariance.tolist(),
        T_base_object=fit.T_base_object.tolist(),
        object=localizer.object.name,
        sensor=sensor_name,
        variance_factor=fit.variance,
        touch=touches,
    )


def _locate(localizer: Localizer, touches: Sequence[Touch]) -> list[tuple[Hypothesis, ...]]:
    """Locate each touch; a touch that no pose of the grid explains gets no hypotheses."""
    found: list[tuple[Hypothesis, ...]] = []
    with localizer.progress.task("locating the touches", len(touches)) as advance:
        for touch in touches:
            try:
                found.append(localizer.localize(touch, top=HYPOTHESES).hypotheses)
            except GridError:
                found.append(())
            advance(1)
    return found


def _is_near(T_flange_sensor: Poses, nominal: Floats) -> Bools:
    rotated = rotation_angle(nominal[:3, :3].T @ T_flange_sensor[:, :3, :3])
    far_m = np.linalg.norm(T_flange_sensor[:, :3, 3] - nominal[:3, 3], axis=1)
    return np.asarray((far_m < NOMINAL_M) & (rotated < NOMINAL_RAD))


def _refine(localizer: Localizer, given: FlangeTouches, guess: HandEyeStart, best_ious: Floats) -> HandEyeCalibration:
    registration = _Registration.of(localizer, given)
    kept = np.ones(len(given), bool)
    X, Y = registration.converge(guess.T_flange_sensor, guess.T_base_object, kept)
    for _ in range(REJECTIONS):
        trusted = registration.find_trusted(X, Y, best_ious)
        if (trusted == kept).all() or trusted.sum() < LEAST:
            break
        kept = trusted
        X, Y = registration.converge(X, Y, kept, finely=True)
    S, covariances = registration.measure(X, Y)
    fit = fit_hand_eye(given.T_base_flange[kept], S[kept], covariances[kept], X, Y)
    kept = kept & registration.find_trusted(X, Y, best_ious)
    return HandEyeCalibration(given, guess, fit, kept, S, registration.compute_imprint_ious(X, Y), best_ious)


@dataclass(frozen=True, eq=False)
class _Registration:
    """All touches as one problem, whose unknowns are the mount X and the object's pose Y in the base frame.

    Each step registers every touch from the pose that X and Y predict. The registered poses, with their covariances,
    are measurements. A fit to all measurements gives new X and Y.
    """

    given: FlangeTouches
    views: list[View]
    registration: JointRegistration
    metric: PoseMetric

    @classmethod
    def of(cls, localizer: Localizer, given: FlangeTouches) -> _Registration:
        views = [View(touch, localizer.scene.match_touch(touch)) for touch in given.touches]
        return cls(given, views, localizer.registration, PoseMetric(localizer.object))

    def converge(self, X: Floats, Y: Floats, some: Bools, finely: bool = False) -> tuple[Floats, Floats]:
        """Fit X and Y to the touches marked in `some` (N,). Pass `finely` if X and Y are already near the result."""
        scales_mm = self.registration.list_scales_mm(ROUNDS)
        F = self.given.T_base_flange[some]
        for scale_mm in scales_mm[ROUNDS // 2 :] if finely else scales_mm:
            (S, covariances), before = self.measure(X, Y, float(scale_mm)), self.predict(X, Y)
            fit = fit_hand_eye(F, S[some], covariances[some], X, Y, robust=True)
            X, Y = fit.T_flange_sensor, fit.T_base_object
            if self.metric.distance(before, self.predict(X, Y)).max() < STILL_M:
                break
        return X, Y

    def measure(self, X: Floats, Y: Floats, scale_mm: float | None = None) -> tuple[Poses, Floats]:
        """Register each touch from the object pose that X and Y predict, by default at the finest scale.

        Return the object's poses T_sensor_object (N, 4, 4), metres, and their covariances (N, 6, 6), as in RefinedPose.
        The covariances include the errors of the touch and of the flange's pose.
        """
        scale_mm = float(self.registration.list_scales_mm(ROUNDS)[-1]) if scale_mm is None else scale_mm
        pairs = zip(self.views, self.predict(X, Y), strict=True)
        stepped = [self.registration.step([view], T[None], scale_mm) for view, T in pairs]
        S = np.concatenate([poses for poses, _ in stepped])
        own = np.stack([NOTHING if covariance is None else covariance for _, (covariance,) in stepped])
        std = np.array([[t.T_base_sensor_std_m] * 3 + [t.T_base_sensor_std_rad] * 3 for t in self.given.touches])
        return S, own + move_covariance(std[:, None] ** 2 * np.eye(6), S[:, :3, 3] - self.given.gel_m)

    def find_trusted(self, X: Floats, Y: Floats, best_ious: Floats) -> Bools:
        """Mark the touches (N,) that agree with X and Y, both in the object's pose and in its imprint."""
        chi2 = fit_hand_eye(self.given.T_base_flange, *self.measure(X, Y), X, Y, robust=True).chi2
        agrees = self.compute_imprint_ious(X, Y) > best_ious - SHORT
        return agrees & (chi2 < TRUSTED * estimate_typical_variance(chi2))

    def predict(self, X: Floats, Y: Floats) -> Poses:
        """Return the object's poses (N, 4, 4), metres, in the sensor frames of the touches, given X and Y (4, 4)."""
        return predict(self.given.T_base_flange, X, Y)

    def compute_imprint_ious(self, X: Floats, Y: Floats) -> Floats:
        """Return the imprint IoUs (N,) of the touches with the object at the poses that X and Y predict."""
        pairs = zip(self.views, self.predict(X, Y), strict=True)
        return np.array([float(view.imprint_ious(T[None])[0]) for view, T in pairs])


def require_motions(given: FlangeTouches) -> None:
    """Raise MountError unless there are enough touches and the flange was rotated about two axes."""
    if len(given) < LEAST:
        raise MountError(f"there are only {len(given)} touches; give at least {LEAST}, better ten")
    (most, second, _), axes = measure_turns(given.T_base_flange)
    if most < ROTATED_RAD:
        raise MountError(
            "the flange was hardly rotated between the touches, so the mount is not determined; rotate the flange by "
            "30 degrees or more, about two axes"
        )
    if second < ROTATED_RAD:
        raise MountError(
            f"the flange was rotated about {name_line(axes[0])} of the flange only, so the sensor's position along "
            "this axis is unknown; add touches with the flange rotated about another axis"
        )


def _require_known(found: HandEyeCalibration | None, given: FlangeTouches, nominal: Mount | None) -> HandEyeCalibration:
    """Return the mount. Raises MountError if too few touches agree on it, or if they do not determine it."""
    agreeing = 0 if found is None else int(found.kept.sum())
    if found is None or agreeing < max(LEAST, len(given) / 2):
        near = "" if nominal is None else " near the nominal one"
        raise MountError(
            f"only {agreeing} of {len(given)} touches agree on a mount{near}; check each T_base_flange "
            "(metres, from flange to base), the object's mesh and units, and that the part did not move"
        )
    require_motions(given.select(found.kept))
    require_determined(found.fit.covariance)
    return found


def require_determined(covariance: Floats) -> None:
    """Raise MountError, naming the direction, if a mount's covariance (6, 6) is too large."""
    for part, limit, what, unit, name in (
        (covariance[:3, :3], LIMIT_M, "place along", 1e3, "mm"),
        (covariance[3:, 3:], LIMIT_RAD, "rotation about", np.degrees(1.0), "degrees"),
    ):
        variances, directions = np.linalg.eigh(part)
        std = float(np.sqrt(variances[-1]))
        if std > limit:
            where = f"{name_line(directions[:, -1])} of the flange"
            raise MountError(
                f"the sensor's {what} {where} has a standard deviation of {unit * std:.1f} {name}, which is too much; "
                "add touches on edges and corners, with the flange rotated about other axes"
            )
