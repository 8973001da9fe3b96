"""The poses that a prior favours, so that a search does not lose them among poses that explain the touches as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import compute_prior_weights
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.prior_factors import draw_around, fit_pulls
from tactile_loc.core.sensing.scene import View
from tactile_loc.locate.hypotheses import DOUBT, keep_apart
from tactile_loc.locate.probability.nearness import NATS_PER_IOU
from tactile_loc.locate.probability.point_distances import estimate_gaps

EXPECTED_SHARE = 0.5  # poses of several touches that the prior chooses, per pose that the touches choose
DRAWN = 64  # poses drawn around the prior's peak
GAP_PER_NAT_M = 1e-4  # mean distance of a touch's points from the surface that counts as much as a nat of the prior
MOST_UNEXPLAINED = 0.2  # loss of mean imprint IoU beyond which a pose is dropped that only the prior chose
UNEXPECTED = 15.0  # nats below the peak of a prior beyond which a pose contradicts the prior; 5.5 standard deviations
FIRST, EXPECTED_MODES = 8, 4  # modes before the modes that the prior favours, and number of the latter


def draw_expected(prior: Prior, T: Poses, middle_m: NDArray[np.float64]) -> Poses:
    """Draw poses (K, 4, 4), metres, around the peak of a prior near the pose T (4, 4); none if the prior is flat there.

    `middle_m` (3,), metres, is the centre of the object.
    """
    pull = fit_pulls(prior, T[None], middle_m)
    return draw_around(pull, DRAWN, middle_m) if pull.information.any() else T[None][:0]


def keep_expected(views: Sequence[View], grid: PoseGrid, prior: Prior | None, radius_m: float, count: int) -> Poses:
    """Return at most `count` poses of a grid that are near all touches, and that the prior favours; none without one.

    The grid's poses are in the first touch's sensor frame. No pose is within `radius_m` metres of a better one.
    """
    if prior is None:
        return grid.T_sensor_object[:0]
    weights = compute_prior_weights(prior, grid)
    possible = np.flatnonzero(weights > -np.inf)
    poses = grid.T_sensor_object[possible]
    worth = weights[possible] - estimate_gaps(views, poses) / GAP_PER_NAT_M
    return poses[keep_apart(poses, worth, grid.metric, radius_m, count)]


def choose_expected(
    grid: PoseGrid, ious: NDArray[np.float64], prior: Prior, radius_m: float, count: int
) -> NDArray[np.int64]:
    """Return the indices of at most `count` poses that explain a touch, and that the prior favours, the best first.

    `ious` (K,), 0 to 1, are the poses' imprint IoUs. No pose is within `radius_m` metres of a better one.
    """
    worth = ious + compute_prior_weights(prior, grid) / NATS_PER_IOU
    explaining = np.flatnonzero(ious >= ious.max() - MOST_UNEXPLAINED)
    apart = keep_apart(grid.T_sensor_object[explaining], worth[explaining], grid.metric, radius_m, count)
    return explaining[apart]


def add_expected_modes(
    modes: Sequence[Mode], posterior: PosePosterior, prior: Prior | None, radius_m: float
) -> list[Mode]:
    """Add the poses with the greatest prior weights to modes, so that they are refined too and count for the verdict.

    Only poses that the touches make less probable than the best pose by at most DOUBT nats are added. None of them is
    within `radius_m` metres of one with a greater weight. The `posterior` includes the prior.
    """
    if prior is None:
        return list(modes)
    weights = compute_prior_weights(prior, posterior.grid)
    evidence = np.where(weights > -np.inf, posterior.log_p - np.maximum(weights, -1e300), -np.inf)
    some = np.flatnonzero(evidence >= evidence.max() - DOUBT)
    poses = posterior.grid.T_sensor_object
    best = some[keep_apart(poses[some], weights[some], posterior.grid.metric, radius_m, EXPECTED_MODES)]
    known = {mode.index for mode in modes}
    added = [Mode(int(k), 0.0, poses[k], np.array([k])) for k in best if int(k) not in known]
    return [*modes[:FIRST], *added, *modes[FIRST:]]


def is_unexpected(prior: Prior | None, T: Poses, middle_m: NDArray[np.float64]) -> bool:
    """Return whether a prior makes the pose T (4, 4), metres, very improbable, so that touches and prior disagree.

    The pose is compared with the peak of the prior that is nearest to it. `middle_m` (3,), metres, is the centre of the
    object. A pose where the prior is flat, such as outside the kernels of an earlier posterior, is not unexpected.
    """
    if prior is None:
        return False
    peak = fit_pulls(prior, T[None], middle_m).T
    return bool(prior(peak)[0] - prior(T[None])[0] > UNEXPECTED)
