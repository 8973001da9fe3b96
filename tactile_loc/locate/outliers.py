"""Touches that contradict the others: they are found by locating again without each, and can be left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactile_loc.core.geometry.rigid import Poses, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.merging import suppress_non_maxima
from tactile_loc.core.poses.posterior import Mode, NoPoseLeft
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.scene import View, compare_where_seen
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import keep_likeliest
from tactile_loc.locate.method import LocatingMethod, Query
from tactile_loc.locate.pipeline import Solution, conclude, localize, weigh_modes
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis
from tactile_loc.locate.result.localization import Localization

FAR = 0.45  # a touch contradicts a pose if another pose's imprint IoU with the touch is greater by more than this
WELL = 0.7  # mean imprint IoU above which touches agree on a pose
ALONE = 8  # poses that are refined against one touch alone

Hypotheses = tuple[Hypothesis, ...]


def localize_by_likeliest_law(query: Query, method: LocatingMethod) -> Localization | NoPoseLeft:
    """Locate the touches of a query by each law of the gel by which they were read, and return the likeliest result.

    The law is a nuisance parameter. The likeliest result explains the touches with the greatest imprint IoU. Each law
    also refines the best pose of the laws before it.
    """
    first, *others = query.read_otherwise()
    found = localize_agreeing(first, method)
    for other in others:
        if isinstance(found, NoPoseLeft):
            found = localize_agreeing(other, method)
            continue
        T = found.best.T_sensor_object[None]
        starts = T if query.starts is None else np.concatenate([query.starts, T])
        by_other = localize_agreeing(replace(other, starts=starts), method)
        if not isinstance(by_other, NoPoseLeft) and by_other.best.imprint_iou > found.best.imprint_iou:
            found = by_other
    return found


def localize_agreeing(query: Query, method: LocatingMethod) -> Localization | NoPoseLeft:
    """Locate the touches of a query, and find those that contradict the others.

    If the configuration sets `drop_outliers`, the other touches are located again without them.
    """
    solution, drops = localize(query, method), method.config.drop_outliers
    if isinstance(solution, NoPoseLeft):
        if solution.outlier is None:
            return solution
        if drops:
            return _localize_rest(query, method, (solution.outlier,))
        name = query.touches[solution.outlier].name
        advice = f"{solution.reason}. Without {name}, the other touches agree: give `drop_outliers`"
        return replace(solution, reason=advice)
    if len(query.views) > 1:
        hypotheses, agreement = find_agreement(Trials(query, method, solution))
        if agreement.outliers and drops:
            return _localize_rest(query, method, agreement.outliers)
        solution = replace(solution, hypotheses=hypotheses, agreement=agreement)
    return conclude(query, method, solution)


def _localize_rest(query: Query, method: LocatingMethod, outliers: Sequence[int]) -> Localization | NoPoseLeft:
    """Locate the touches of a query again without its outliers."""
    found = localize_agreeing(query.leave_out(outliers), method.leave_out(outliers))
    if isinstance(found, NoPoseLeft):
        return found
    left_out = tuple(touch for touch in query.touches if all(touch is not one for one in found.touches))
    return replace(found, left_out=left_out)


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
                self.ious[number] = max(self.ious[number], self.trials.find_best_iou_alone(number))
        return set(np.flatnonzero(self.ious - here > FAR).tolist())

    def conclude(
        self, hypotheses: Hypotheses, outliers: tuple[int, ...] = (), contradictory: bool = False
    ) -> Agreement:
        """Return the agreement of the touches with the chosen hypotheses."""
        best = np.maximum(self.ious, np.array([h.imprint_ious for h in hypotheses]).max(axis=0))
        return Agreement(tuple(best.tolist()), outliers, contradictory)


@dataclass(frozen=True, eq=False)
class Trials:
    """Ways to explain the touches of a query, each of which takes time. Touches are numbered from 0.

    `solution` is what the pipeline found for all touches.
    """

    query: Query
    method: LocatingMethod
    solution: Solution

    def find(self, outliers: tuple[int, ...]) -> Hypotheses:
        """Return hypotheses refined against all touches except `outliers`, whose imprint IoUs are NaN."""
        if not outliers:
            return self.solution.hypotheses
        modes = self._keep_promising([view for k, view in enumerate(self.query.views) if k not in outliers])
        return weigh_modes(self.query, self.method, modes, outliers)

    def _keep_promising(self, trusted: Sequence[View]) -> Sequence[Mode]:
        """Return the modes that explain trusted touches best, without those that are not worth refining."""
        source, options = self.method.source, self.method.config.hypotheses
        modes, ious = keep_likeliest(self.solution.modes, trusted, source.setup.start_radius_m, options)
        if not self.method.refinement.refiner.capabilities.refines:
            return modes
        return source.keep_promising(modes, ious, trusted, self.query.times)

    def compare_outliers(self, hypotheses: Hypotheses, outliers: tuple[int, ...]) -> Hypotheses:
        """Return the hypotheses of `find` with the imprint IoUs of the outliers.

        An outlier's sensor pose may have an error, so each pose is also refined against the outlier alone.
        """
        views, T = self.query.views, np.stack([h.T_sensor_object for h in hypotheses])
        ious = np.array([h.imprint_ious for h in hypotheses])
        with self.query.times.stage("choose"):
            for number in outliers:
                view = views[number]
                seen = self._refine_alone(view, view.T_sensor_first @ T)[:, None]
                ious[:, number] = compare_where_seen([view], T, seen, views[0])[0][:, 0]
        return tuple(replace(h, imprint_ious=tuple(each.tolist())) for h, each in zip(hypotheses, ious, strict=True))

    def find_best_iou_alone(self, number: int) -> float:
        """Return a touch's best imprint IoU, 0 to 1, with any pose refined against this touch alone.

        The ALONE poses with the highest scores are refined, except those near a pose with a higher score.
        """
        source, view = self.method.sources[number], self.query.views[number]
        alone = View(view.touch, view.scene)
        grid, scores = source.list_starts_alone(alone, self.solution.alone[number], self.query.times)
        with self.query.times.stage("refine"):
            poses = grid.T_sensor_object
            poses = poses[
                suppress_non_maxima(poses, scores, grid.metric, self.method.source.setup.start_radius_m, ALONE)
            ]
            return float(alone.imprint_ious(self._refine_alone(alone, poses)).max())

    def _refine_alone(self, view: View, poses: Poses) -> Poses:
        """Return poses (K, 4, 4), metres, in the frame of a touch's own sensor, refined against this touch alone."""
        candidates = [Candidate(T, -1, 0.0) for T in poses]
        refined = self.method.refinement.refine([View(view.touch, view.scene)], candidates)
        return np.stack([pose.T_sensor_object for pose in refined])


def require_within_reach(touches: Sequence[Touch], obj: ObjectModel) -> None:
    """Raise GridError if no two touches are near enough to be on one object.

    In that case, a unit or a frame is probably wrong. If only some touches are too far away, no error is raised, and
    `find_agreement` finds the outliers. Nothing is checked if a touch has no sensor pose.
    """
    if len(touches) < 2 or any(touch.T_base_sensor is None for touch in touches):
        return
    gels = [touch.geometry for touch in touches]
    placed = [(np.asarray(touch.T_base_sensor), touch.geometry.gel_middle_m) for touch in touches]
    middles_m = np.stack([transform_points(T, middle_m[None])[0] for T, middle_m in placed])
    radii_m = np.array([np.hypot(x1 - x0, y1 - y0) / 2 for x0, x1, y0, y1 in (gel.rectangle for gel in gels)])
    a, b = np.triu_indices(len(touches), 1)
    apart_m = float((np.linalg.norm(middles_m[a] - middles_m[b], axis=1) - radii_m[a] - radii_m[b]).min())
    size_m = float(np.linalg.norm(obj.mesh.extents_m))
    if apart_m > size_m:
        raise GridError(
            f"the sensors are at least {1e3 * apart_m:,.0f} mm apart, but {obj.name} is only {1e3 * size_m:.0f} mm "
            "long; give each T_base_sensor in metres, from the sensor to one common base, not inverted (T_sensor_base)"
        )
