"""The pipeline from touches to poses: search, fuse, propose, refine, compare, weigh and merge."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.posterior import Mode, NoPoseLeft, PosePosterior, require_pose_left
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.prior_factors import fit_prior_factors
from tactile_loc.locate.hypotheses import compare, count_touches_with_depths, merge_hypotheses, weigh
from tactile_loc.locate.method import LocatingMethod, Query
from tactile_loc.locate.probability.conformal import PoseSet, rank
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis, JudgedHypothesis
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import judge
from tactile_loc.locate.sources.source import Scored

UNEXPECTED = 15.0  # nats below the peak of a prior beyond which a pose contradicts the prior; 5.5 standard deviations


@dataclass(frozen=True, eq=False)
class Solution:
    """What the pipeline found: each touch's posterior, the fused one, the proposed modes, and what became of them.

    `agreement` states whether several touches agree.
    """

    scored: Scored
    posterior: PosePosterior
    modes: Sequence[Mode]
    hypotheses: tuple[Hypothesis, ...]
    agreement: Agreement = field(default_factory=Agreement)


def localize(query: Query, method: LocatingMethod, scored: Scored | None = None) -> Solution | NoPoseLeft:
    """Find poses that explain the touches of a query. `scored` are the touches' posteriors if they are known."""
    scored = scored or method.search(query)
    posterior = method.fuse(scored, query)
    if isinstance(posterior, NoPoseLeft):
        return posterior
    modes = method.propose(scored, posterior, query)
    hypotheses = weigh_modes(query, method, modes)
    return Solution(scored, posterior, modes, hypotheses)


def weigh_modes(
    query: Query, method: LocatingMethod, modes: Sequence[Mode], outliers: Collection[int] = ()
) -> tuple[Hypothesis, ...]:
    """Refine modes to the touches, weigh them by how well they explain the touches, and merge equal poses.

    The touches with the numbers `outliers` affect neither the poses nor the probabilities.
    """
    trusted = [view for k, view in enumerate(query.views) if k not in outliers]
    prior, metric = method.temper_prior(query), method.metric
    with query.times.stage("refine"):
        refined = method.refinement.refine_modes(trusted, modes, prior)
    with query.times.stage("choose"):
        compared = compare(query.views, refined, outliers)
        weighed = weigh(compared, count_touches_with_depths(trusted), metric, prior)
        return merge_hypotheses(weighed, metric, method.source.setup.merge_radius_m)


def conclude(query: Query, method: LocatingMethod, solution: Solution) -> Localization:
    """Make the result: choose the hypotheses to list, and add their covariances."""
    touch, *others = query.touches
    hypotheses, agreement, pose_set = solution.hypotheses, solution.agreement, None
    if query.coverage is not None:
        probability, sets = query.coverage
        pose_set = PoseSet.of(rank(hypotheses, len(query.views)), sets, probability, agreement.contradictory)
    with query.times.stage("choose"):
        kept = hypotheses[: query.top if pose_set is None else pose_set.poses]
        listed = method.refinement.add_covariances(query.views, kept)
    placed = tuple(replace(h, T_base_sensor=touch.T_base_sensor) for h in listed)
    middle_m, prior = method.source.setup.scene.object.mesh.centroid_m, method.temper_prior(query)
    found = Localization(touch, solution.posterior, placed, query.times.seconds, tuple(others), pose_set, agreement)
    unexpected = is_unexpected(prior, hypotheses[0].T_sensor_object, middle_m)
    return replace(found, config=method.config, unlisted=hypotheses[len(placed) :], unexpected=unexpected)


def locate_most_probable(query: Query, method: LocatingMethod) -> JudgedHypothesis:
    """Return the most probable pose of one touch, refined, with its own verdict: see `Localizer`."""
    (view,), radius_m = query.views, method.source.setup.mode_radius_m
    posterior = require_pose_left(method.fuse(method.search(query), query))
    index = posterior.find_likeliest()
    T, near = posterior.grid.T_sensor_object[index], posterior.grid.find_within(radius_m, index)
    (pose,) = method.refinement.refine([view], [Candidate(T, index, float(posterior.log_p[index]))])
    iou = view.imprint_ious(pose.T_sensor_object[None])[0] if pose.imprint_iou is None else pose.imprint_iou
    probability = float(posterior.probabilities[near].sum())
    ious = (float(iou),)
    one = Hypothesis(probability, T, pose, index, len(near), ious[0], ious, view.touch.T_base_sensor)
    (known,) = method.refinement.add_covariances([view], [one])
    verdict = judge(known.probability, known.imprint_iou, posterior.elsewhere, depths_known=view.touch.has_depths)
    return JudgedHypothesis(**vars(known), verdict=verdict)


def is_unexpected(prior: Prior | None, T: Poses, middle_m: NDArray[np.float64]) -> bool:
    """Return whether a prior makes the pose T (4, 4), metres, very improbable, so that touches and prior disagree.

    The pose is compared with the peak of the prior that is nearest to it. `middle_m` (3,), metres, is the centre of the
    object. A pose where the prior is flat, such as outside the kernels of an earlier posterior, is not unexpected.
    """
    if prior is None:
        return False
    peak = fit_prior_factors(prior, T[None], middle_m).T
    return bool(prior(peak)[0] - prior(T[None])[0] > UNEXPECTED)
