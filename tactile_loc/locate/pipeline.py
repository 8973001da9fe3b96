"""The pipeline from touches to poses: search, fuse, propose, refine, compare, weigh and merge."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.posterior import Mode, NoPoseLeft, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE
from tactile_loc.core.registration.prior_factors import fit_prior_factors
from tactile_loc.core.sensing.scene import View
from tactile_loc.locate.hypotheses import compare, count_touches_with_depths, merge_hypotheses, turn_half_steps, weigh
from tactile_loc.locate.method import LocatingMethod, Query
from tactile_loc.locate.polish import polish
from tactile_loc.locate.probability.conformal import PoseSet, Ranking
from tactile_loc.locate.probability.evidence import Evidence, Question, gather_evidence
from tactile_loc.locate.probability.outcome_model import load_outcome_model, spread_outcome
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.sources.source import Posteriors

UNEXPECTED = 15.0  # nats below the peak of a prior beyond which a pose contradicts the prior; 5.5 standard deviations


@dataclass(frozen=True, eq=False)
class Solution:
    """What the pipeline found: each touch's posterior, the fused one, the proposed modes, and what became of them.

    `agreement` states whether several touches agree.
    """

    alone: Posteriors
    posterior: PosePosterior
    modes: Sequence[Mode]
    hypotheses: tuple[Hypothesis, ...]
    agreement: Agreement = field(default_factory=Agreement)


def localize(query: Query, method: LocatingMethod) -> Solution | NoPoseLeft:
    """Find poses that explain the touches of a query."""
    alone = method.search(query)
    posterior = method.fuse(alone, query)
    if isinstance(posterior, NoPoseLeft):
        return posterior
    modes = method.propose(alone, posterior, query)
    hypotheses = weigh_modes(query, method, modes)
    return Solution(alone, posterior, modes, hypotheses)


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
        compared, count = compare(query.views, refined, outliers), count_touches_with_depths(trusted)
        weighed = weigh(compared, count, metric, prior)
        if turned := turn_half_steps(weighed[0], metric):
            weighed = weigh([*weighed, *compare(query.views, turned, outliers)], count, metric, prior)
        radius_m, tolerance = method.source.setup.merge_radius_m, method.config.tolerance
        merged = merge_hypotheses(weighed, metric, radius_m, tolerance)
        refines = method.refinement.refiner.capabilities.refines
        if len(query.views) > 1 or query.views[0].touch.image is None or not refines:
            return merged
        others = [other.views[0] for other in query.outlined if other.views[0] is not trusted[0]]
        polished = weigh(polish([*trusted, *others], merged), count, metric, prior)
        return merge_hypotheses(polished, metric, radius_m, tolerance)


def conclude(query: Query, method: LocatingMethod, solution: Solution) -> Localization:
    """Make the result: judge the first hypothesis, choose the hypotheses to list, and add their covariances."""
    touch, *others = query.touches
    scene, prior, agreement = method.source.setup.scene, method.temper_prior(query), solution.agreement
    trusted = [view for number, view in enumerate(query.views) if number not in agreement.outliers]
    with query.times.stage("choose"):
        first = method.refinement.add_covariances(trusted, solution.hypotheses[:1])
        known = (*first, *solution.hypotheses[1:])
        asked = Question(scene.object, method.config.tolerance, prior, agreement.contradictory)
        evidence = gather_evidence(trusted, known, asked)
        outcome = load_outcome_model().predict(evidence)
        hypotheses, missed = spread_outcome(known, evidence.near, outcome)
        pose_set = None
        if query.coverage is not None:
            pose_set = choose_set(query.coverage, trusted, known, asked, evidence, method)
        kept = hypotheses[: query.top if pose_set is None else pose_set.poses]
        listed = method.refinement.add_covariances(query.views, kept)
    placed = tuple(replace(h, T_base_sensor=touch.T_base_sensor) for h in listed)
    posterior = replace(solution.posterior, elsewhere=missed if method.source.may_miss else 0.0)
    return Localization(
        touch,
        posterior,
        placed,
        query.times.seconds,
        tuple(others),
        pose_set,
        agreement,
        config=method.config,
        unlisted=hypotheses[len(placed) :],
        unexpected=is_unexpected(prior, hypotheses[0].T_sensor_object, scene.object.mesh.centroid_m),
        prior=prior,
        evidence=evidence,
        outcome=outcome,
        refined_by=method.refinement.describe([view.touch for view in trusted], method.source.may_miss),
    )


def choose_set(
    coverage: float,
    views: Sequence[View],
    hypotheses: Sequence[Hypothesis],
    asked: Question,
    evidence: Evidence,
    method: LocatingMethod,
) -> PoseSet:
    """Return the set of hypotheses that contains the true pose with the probability `coverage`, 0 to 1.

    A pose is right within 1 mm, whatever tolerance was asked for and the `evidence` has.
    """
    if asked.tolerance != ONE_MILLIMETRE:
        evidence = gather_evidence(views, hypotheses, replace(asked, tolerance=ONE_MILLIMETRE))
    spread, missed = spread_outcome(hypotheses, evidence.near, load_outcome_model().predict(evidence))
    doubt = ""
    if asked.contradictory:
        doubt = "The touches contradict each other, and the examples do not."
    elif asked.prior is not None:
        doubt = "The examples have no prior."
    elif not method.source.may_miss or evidence.probes is None:
        doubt = "The examples are of the grid whole, and their poses are refined."
    return PoseSet.of(Ranking.of([h.probability for h in spread], missed), load_outcome_model().scores, coverage, doubt)


def is_unexpected(prior: Prior | None, T: Poses, middle_m: NDArray[np.float64]) -> bool:
    """Return whether a prior makes the pose T (4, 4), metres, very improbable, so that touches and prior disagree.

    The pose is compared with the peak of the prior that is nearest to it. `middle_m` (3,), metres, is the centre of the
    object. A pose where the prior is flat, such as outside the kernels of an earlier posterior, is not unexpected.
    """
    if prior is None:
        return False
    peak = fit_prior_factors(prior, T[None], middle_m).T
    return bool(prior(peak)[0] - prior(T[None])[0] > UNEXPECTED)
