"""Agreement of several touches: whether one pose explains all of them, and which touch contradicts the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import Mode
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.options import HypothesisOptions
from tactile_loc.locate.hypotheses import (
    Refine,
    compare_outliers,
    compute_imprint_ious,
    find_hypotheses,
    keep_apart,
    keep_likeliest,
)
from tactile_loc.locate.result.localization import Agreement, Hypothesis

FAR = 0.45  # a touch contradicts a pose if another pose's imprint IoU with the touch is greater by more than this
WELL = 0.7  # mean imprint IoU above which touches agree on a pose
ALONE = 8  # poses that are refined against one touch alone
# Coarse mean imprint IoUs: from PROMISING on, poses are refined without a trial. If all poses are below UNPROMISING
# even after coarse registration, only one is refined, because refined poses hardly reach WELL then.
PROMISING, UNPROMISING = 0.8, 0.6

Hypotheses = tuple[Hypothesis, ...]


class Trials(Protocol):
    """Ways to explain touches, each of which takes time. Touches are numbered from 0."""

    def find(self, outliers: tuple[int, ...]) -> Hypotheses:
        """Return hypotheses refined against all touches except `outliers`, whose imprint IoUs are NaN."""

    def compare_outliers(self, hypotheses: Hypotheses, outliers: tuple[int, ...]) -> Hypotheses:
        """Return the hypotheses of `find` with the imprint IoUs of the outliers."""

    def explain_alone(self, number: int) -> float:
        """Return a touch's best imprint IoU, 0 to 1, with any pose refined against this touch alone."""


def find_agreement(trials: Trials) -> tuple[Hypotheses, Agreement]:
    """Return the hypotheses of all touches except outliers, and how the touches agree.

    A touch is an outlier if more than half of the touches agree on a pose, and another pose explains this touch far
    better. If several touches could be the wrong one, there are no outliers.
    """
    found = trials.find(())
    best = _BestIous(trials, found)
    if not best.find_far(found):
        return found, best.conclude(found)
    left_out: tuple[int, ...] = ()
    while len(left_out) < (len(best.ious) - 1) // 2:
        tried = {(*left_out, k): trials.find((*left_out, k)) for k in range(len(best.ious)) if k not in left_out}
        blamed = {}
        for outliers, hypotheses in tried.items():
            if hypotheses[0].imprint_iou >= WELL:
                compared = trials.compare_outliers(hypotheses, outliers)
                if best.find_far(compared) == set(outliers):
                    blamed[outliers] = compared
        if len(blamed) == 1:
            ((outliers, compared),) = blamed.items()
            return compared, best.conclude(compared, tuple(sorted(outliers)), True)
        if blamed:
            break
        left_out = max(tried, key=lambda outliers: tried[outliers][0].imprint_iou)
    return found, best.conclude(found, (), True)


class _BestIous:
    """The best imprint IoU of each touch with any pose. A touch is explained alone only if this may decide something.

    `ious` (N,), 0 to 1, are the best ones so far.
    """

    def __init__(self, trials: Trials, found: Hypotheses) -> None:
        self.trials, self.ious = trials, np.array([h.imprint_ious for h in found]).max(axis=0)
        self._alone: set[int] = set()

    def find_far(self, hypotheses: Hypotheses) -> set[int]:
        """Return the numbers of the touches that the best hypothesis explains far worse than another pose does."""
        here = np.array(hypotheses[0].imprint_ious)
        for number in np.flatnonzero((self.ious - here <= FAR) & (1 - here > FAR)).tolist():
            if number not in self._alone:
                self._alone.add(number)
                self.ious[number] = max(self.ious[number], self.trials.explain_alone(number))
        return set(np.flatnonzero(self.ious - here > FAR).tolist())

    def conclude(
        self, hypotheses: Hypotheses, outliers: tuple[int, ...] = (), contradictory: bool = False
    ) -> Agreement:
        """Return the agreement of the touches with the chosen hypotheses."""
        best = np.maximum(self.ious, np.array([h.imprint_ious for h in hypotheses]).max(axis=0))
        return Agreement(tuple(best.tolist()), outliers, contradictory)


@dataclass(frozen=True, eq=False)
class PoseTrials:
    """Trials that refine `modes` against touches, which are seen in `views`.

    `starts_alone` returns poses to refine against one touch alone, and their scores, given the touch's number. With a
    `registration`, only one pose is refined if none can explain the touches well. Poses to refine are at least
    `start_radius_m` metres apart, and equal poses are merged within `merge_radius_m` metres.
    """

    views: Sequence[View]
    modes: Sequence[Mode]
    starts_alone: Callable[[int], tuple[PoseGrid, NDArray[np.float64]]]
    registration: JointRegistration | None
    refine: Refine
    metric: PoseMetric
    prior: Prior | None
    options: HypothesisOptions
    start_radius_m: float
    merge_radius_m: float
    times: StageTimes

    def find(self, outliers: tuple[int, ...]) -> Hypotheses:
        """Refine modes against all touches except outliers: see `Trials`."""
        modes = self.modes
        if outliers:
            trusted = [view for k, view in enumerate(self.views) if k not in outliers]
            modes = self._keep_promising(trusted)
        return find_hypotheses(
            self.views, modes, self.refine, self.metric, self.merge_radius_m, self.prior, self.times, outliers
        )

    def _keep_promising(self, trusted: Sequence[View]) -> list[Mode]:
        """Return the modes that explain trusted touches best; only one if no mode can explain them well.

        Modes that do not explain the touches yet are registered coarsely, which takes less time than to refine them.
        """
        modes, ious = keep_likeliest(self.modes, trusted, self.start_radius_m, self.options)
        if self.registration is None or ious[0] >= PROMISING:
            return modes
        with self.times.stage("register"):
            poses = self.registration.register_coarsely(trusted, np.stack([mode.T_sensor_object for mode in modes]))
            ious = compute_imprint_ious(trusted, poses, self.options.image_px, self.start_radius_m).mean(axis=1)
        return modes if ious.max() >= UNPROMISING else [modes[int(ious.argmax())]]

    def compare_outliers(self, hypotheses: Hypotheses, outliers: tuple[int, ...]) -> Hypotheses:
        """Add the imprint IoUs of the outliers: see `Trials`."""
        with self.times.stage("choose"):
            return compare_outliers(self.views, hypotheses, self.refine, outliers)

    def explain_alone(self, number: int) -> float:
        """Return a touch's best imprint IoU with any pose: see `Trials`.

        The ALONE poses with the highest scores are refined, except those near a pose with a higher score.
        """
        grid, scores = self.starts_alone(number)
        with self.times.stage("refine"):
            poses = grid.T_sensor_object
            poses = poses[keep_apart(poses, scores, grid.metric, self.start_radius_m, ALONE)]
            alone = View(self.views[number].touch, self.views[number].scene)
            refined = self.refine([alone], [Candidate(T, -1, 0.0) for T in poses])
            return float(alone.imprint_ious(np.stack([pose.T_sensor_object for pose in refined])).max())


def require_within_reach(touches: Sequence[Touch], obj: ObjectModel) -> None:
    """Raise GridError if no two touches are near enough to be on one object.

    In that case, a unit or a frame is probably wrong. If only some touches are too far away, no error is raised, and
    `find_agreement` finds the outliers. Nothing is checked if a touch has no sensor pose.
    """
    if len(touches) < 2 or any(touch.T_base_sensor is None for touch in touches):
        return
    gels = [touch.geometry for touch in touches]
    middles_m = np.stack([
        transform_points(np.asarray(touch.T_base_sensor), gel.gel_middle_m[None])[0]
        for touch, gel in zip(touches, gels, strict=True)
    ])  # fmt: skip
    radii_m = np.array([np.hypot(x1 - x0, y1 - y0) / 2 for x0, x1, y0, y1 in (gel.rectangle for gel in gels)])
    a, b = np.triu_indices(len(touches), 1)
    apart_m = float((np.linalg.norm(middles_m[a] - middles_m[b], axis=1) - radii_m[a] - radii_m[b]).min())
    size_m = float(np.linalg.norm(obj.mesh.extents_m))
    if apart_m > size_m:
        raise GridError(
            f"the sensors are at least {1e3 * apart_m:,.0f} mm apart, but {obj.name} is only {1e3 * size_m:.0f} mm "
            "long; give each T_base_sensor in metres, from the sensor to one common base, not inverted (T_sensor_base)"
        )
