"""Agreement of several touches: whether one pose explains all of them, and which touch contradicts the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry.rigid import transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.refiner import Candidate
from tactile_loc.core.slots.scene import View
from tactile_loc.io.options import HypothesisOptions
from tactile_loc.locate.hypotheses import Refine, keep_apart
from tactile_loc.locate.results.localization import Agreement, Hypothesis

FAR = 0.45  # a touch contradicts a pose if another pose's imprint IoU with the touch is greater by more than this
WELL = 0.7  # mean imprint IoU above which touches agree on a pose
ALONE = 8  # poses that are refined against one touch alone

Hypotheses = tuple[Hypothesis, ...]


def find_agreement(
    find: Callable[[tuple[int, ...]], Hypotheses], best_alone: Callable[[], NDArray[np.float64]]
) -> tuple[Hypotheses, Agreement]:
    """Return the hypotheses of all touches except outliers, and how the touches agree.

    `find` takes the numbers of touches to leave out, and returns hypotheses refined against all other touches.
    `best_alone` returns each touch's best imprint IoU (N,) with any pose refined against this touch alone. It is called
    only if needed.

    A touch is an outlier if more than half of the touches agree on a pose, and another pose explains this touch far
    better. If several touches could be the wrong one, there are no outliers.
    """
    found = find(())
    ious = np.array([h.imprint_ious for h in found])
    best = ious.max(axis=0)
    if (ious[0] < 1 - FAR).any():
        best = np.maximum(best, best_alone())
    best_ious = tuple(best.tolist())
    if not _find_far(found, best):
        return found, Agreement(best_ious)
    left_out: tuple[int, ...] = ()
    while len(left_out) < (len(best) - 1) // 2:
        trials = {(*left_out, k): find((*left_out, k)) for k in range(len(best)) if k not in left_out}
        blamed = [
            outliers for outliers, hypotheses in trials.items()
            if _find_far(hypotheses, best) == set(outliers) and hypotheses[0].imprint_iou >= WELL
        ]  # fmt: skip
        if len(blamed) == 1:
            return trials[blamed[0]], Agreement(best_ious, tuple(sorted(blamed[0])), True)
        if blamed:
            break
        left_out = max(trials, key=lambda outliers: trials[outliers][0].imprint_iou)
    return found, Agreement(best_ious, (), True)


def _find_far(hypotheses: Hypotheses, best: NDArray[np.float64]) -> set[int]:
    """Return the numbers of the touches that the best hypothesis explains far worse than another pose does."""
    return set(np.flatnonzero(best - hypotheses[0].imprint_ious > FAR).tolist())


def explain_alone(
    view: View, posterior: PosePosterior, refine: Refine, radius_m: float, options: HypothesisOptions
) -> float:
    """Return the imprint IoU of a touch with the best pose of its own grid, refined against this touch alone.

    The ALONE most probable poses are refined, except those within `radius_m` metres of a more probable one.
    """
    listed = posterior.top(options.listed)
    poses = posterior.grid.T_sensor_object[listed]
    poses = poses[keep_apart(poses, posterior.log_p[listed], posterior.grid.metric, radius_m, ALONE)]
    alone = View(view.touch, view.scene)
    refined = refine([alone], [Candidate(T, -1, 0.0) for T in poses])
    return float(alone.imprint_ious(np.concatenate([poses, [r.T_sensor_object for r in refined]])).max())


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
