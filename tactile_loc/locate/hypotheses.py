"""Distinct hypotheses from posteriors: modes are proposed, refined against all touches, weighed and merged."""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.merging import merge_modes, suppress_non_maxima
from tactile_loc.core.poses.metric import PoseMetric, measure_distances
from tactile_loc.core.poses.posterior import TIE_NATS, Mode, PosePosterior, group_ties, rank_poses
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.sensing.scene import IOU_PX, View, compare_where_seen
from tactile_loc.io.options import HypothesisOptions
from tactile_loc.locate.probability.temperature import TemperatureScaling
from tactile_loc.locate.result.hypothesis import Hypothesis

# A pose that leaves the share x of the imprints of N touches unexplained has the score -ln(x + LEAST_UNEXPLAINED). The
# temperature is 1 / (N SHARPNESS_OF_ONE).
LEAST_UNEXPLAINED, SHARPNESS_OF_ONE, TAIL = 0.0064, 12.8, 0.15
MASK_SHARE = 0.5
STILL_MOVING = 10  # poses that did not converge are merged within the radius divided by this
EXCLUDED = -1e6  # nats: log-weight of a pose that the prior excludes
DOUBT = 8.0  # nats: in one touch's grid, no pose counts as less probable than the best pose by more than this


RefinedMode = tuple[Mode, RefinedPose]


def compare(
    views: Sequence[View], refined: Sequence[RefinedMode], outliers: Collection[int] = ()
) -> tuple[Hypothesis, ...]:
    """Return refined modes as hypotheses with the imprint IoUs of the touches, not weighed yet.

    The imprint IoUs of views whose numbers are in `outliers` are NaN: `compare_outliers` computes them.
    """
    trusted = [number for number in range(len(views)) if number not in outliers]
    found = []
    for (mode, pose), each in zip(refined, compare_refined(views, [pose for _, pose in refined], trusted), strict=True):
        ious, mean = tuple(map(float, each)), float(each[trusted].mean())
        members = len(mode.members)
        found.append(Hypothesis(mode.probability, mode.T_sensor_object, pose, mode.index, members, mean, ious))
    return tuple(found)


def compare_refined(
    views: Sequence[View], refined: Sequence[RefinedPose], trusted: Sequence[int]
) -> NDArray[np.float64]:
    """Return the imprint IoUs (K, N), 0 to 1, of refined poses with each of N touches; NaN if it is not trusted."""
    if len(views) == 1 and all(pose.imprint_iou is not None for pose in refined):
        return np.array([[pose.imprint_iou] for pose in refined])  # the refiner has drawn the poses already
    T = np.stack([pose.T_sensor_object for pose in refined])
    some = [views[number] for number in trusted]
    seen = None if len(views) == 1 else find_seen_poses(some, refined)
    ious = np.full((len(T), len(views)), np.nan)
    ious[:, trusted] = compare_where_seen(some, T, seen, views[0])[0]
    return ious


def turn_half_steps(hypothesis: Hypothesis, metric: PoseMetric) -> list[RefinedMode]:
    """Return poses that follow from a hypothesis by half a step of each symmetry of the object, with its grid pose.

    Such a pose can be nearer than other poses that are refined, and explain touches as well that miss what
    distinguishes it.
    """
    pose, found = hypothesis.refined, []
    for turn in metric.object.symmetry.list_half_steps():
        seen = None if pose.T_sensors_object is None else pose.T_sensors_object @ turn
        reported = None if pose.T_reported_object is None else pose.T_reported_object @ turn
        turned = dataclasses.replace(
            pose,
            T_sensor_object=pose.T_sensor_object @ turn,
            T_sensors_object=seen,
            T_reported_object=reported,
            covariance=None,
            reported_covariance=None,
            imprint_iou=None,
        )
        mode = Mode(hypothesis.grid_index, 0.0, hypothesis.T_sensor_object_grid, np.empty(0, np.int64))
        found.append((mode, turned))
    return found


def merge_hypotheses(
    hypotheses: Sequence[Hypothesis], metric: PoseMetric, radius_m: float, tolerance: Tolerance | None = None
) -> tuple[Hypothesis, ...]:
    """Merge hypotheses whose refined poses are within `radius_m` metres of a likelier one.

    `hypotheses` are sorted, the most probable first. A merged hypothesis has the probability of its likeliest member,
    because a pose is not likelier if several modes lead to it. All probabilities are then scaled to keep their sum.
    Poses that did not converge are merged within `radius_m` / STILL_MOVING. Poses that are not within a `tolerance` of
    each other stay apart, such as those of a small screw turned by half a step of its symmetry.
    """
    poses = np.array([h.T_sensor_object for h in hypotheses]).reshape(-1, 4, 4)
    still_m = [radius_m if h.refined.converged else radius_m / STILL_MOVING for h in hypotheses]
    of = merge_modes(poses, metric, still_m, tolerance=tolerance)
    counts = np.bincount(of, [h.grid_poses for h in hypotheses]).astype(int)
    merged = [dataclasses.replace(hypotheses[k], grid_poses=int(counts[k])) for k in np.unique(of)]
    kept, total = sum(h.probability for h in merged), sum(h.probability for h in hypotheses)
    share = total / kept if kept > 0 else 1.0
    return tuple(dataclasses.replace(h, probability=min(1.0, share * h.probability)) for h in merged)


def count_touches_with_depths(views: Sequence[View]) -> float:
    """Return the number of touches; each touch without depths counts as MASK_SHARE of a touch."""
    return sum(1.0 if view.touch.has_depths else MASK_SHARE for view in views)


def compute_nats(imprint_ious: NDArray[np.float64], touches: float) -> NDArray[np.float64]:
    """Return the log-weights (K,), nats, of poses with mean imprint IoUs (K,), 0 to 1, with this number of touches.

    A pose that explains the touches better never has a smaller weight. The smaller the share of the imprints that
    remains unexplained, the more a difference of it counts. So clean touches distinguish poses that noisy touches do
    not.
    """
    scaling = TemperatureScaling(1 / (touches * SHARPNESS_OF_ONE), TAIL)
    return scaling.log_p(-np.log(1 - imprint_ious + LEAST_UNEXPLAINED))


def weigh(
    hypotheses: Sequence[Hypothesis], touches: float, metric: PoseMetric, prior: Prior | None = None
) -> tuple[Hypothesis, ...]:
    """Return hypotheses with probabilities from the imprint IoUs of their refined poses, the most probable first.

    `touches` is the number of touches: see `count_touches_with_depths`. A `prior` is over the refined poses.
    """
    nats = compute_nats(np.array([h.imprint_iou for h in hypotheses]), touches)
    log_prior = None if prior is None else prior(np.stack([h.T_sensor_object for h in hypotheses]))
    return assign_probabilities(hypotheses, nats, metric, log_prior)


def assign_probabilities(
    hypotheses: Sequence[Hypothesis],
    nats: NDArray[np.float64],
    metric: PoseMetric,
    log_prior: NDArray[np.float64] | None = None,
) -> tuple[Hypothesis, ...]:
    """Return hypotheses with probabilities from the log-weights of their refined poses, the most probable first.

    Refined poses distinguish explanations better than the grid, whose poses are all slightly wrong and whose shapes are
    coarse. `nats` (K,) are the log-weights given all touches; `log_prior` (K,) is added, and becomes their
    `prior_nats`. Poses with sums within TIE_NATS are equally probable, and their order does not depend on rounding. The
    total probability of the given hypotheses is kept.
    """
    known = np.zeros(len(hypotheses)) if log_prior is None else np.maximum(log_prior, EXCLUDED)
    worth = nats + known
    groups = group_ties(worth, TIE_NATS)
    weights = np.exp(worth - worth.max())
    weights = (np.bincount(groups, weights) / np.bincount(groups))[groups]
    weights *= min(1.0, sum(h.probability for h in hypotheses)) / weights.sum()
    order = rank_poses(groups, np.stack([h.T_sensor_object for h in hypotheses]), metric)
    return tuple(
        dataclasses.replace(hypotheses[i], probability=float(weights[i]), prior_nats=float(known[i])) for i in order
    )


def compute_imprint_ious(
    views: Sequence[View], T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0
) -> NDArray[np.float64]:
    """Return imprint IoUs (K, N) of poses with each of N touches.

    `T_first_object` (K, 4, 4), metres, is in the first sensor's frame. `pixels` and `freedom_m` are as for
    `Scene.compare_imprints`.
    """
    return np.stack([view.imprint_ious(T_first_object, pixels, freedom_m) for view in views], axis=1)


def keep_likeliest(
    modes: Sequence[Mode], views: Sequence[View], freedom_m: float, options: HypothesisOptions
) -> tuple[list[Mode], NDArray[np.float64]]:
    """Return the modes with the greatest mean imprint IoU in coarse renders, the greatest first, and these IoUs (K,).

    Poses may move `freedom_m` metres farther along z than the error of the measured press.
    """
    poses = np.stack([mode.T_sensor_object for mode in modes])
    ious = compute_imprint_ious(views, poses, options.image_px, freedom_m).mean(axis=1)
    best = np.argsort(-ious, kind="stable")[: options.refined_again]
    return [modes[k] for k in best], ious[best]


def find_seen_poses(views: Sequence[View], refined: Sequence[RefinedPose]) -> NDArray[np.float64]:
    """Return refined poses in the frame of each of N sensors, (K, N, 4, 4), metres, as the refiner gives them.

    If the refiner gives none for these sensors, they follow from the reported sensor poses.
    """
    seen = np.stack([view.T_sensor_first @ [pose.T_sensor_object for pose in refined] for view in views], axis=1)
    for k, pose in enumerate(refined):
        if pose.T_sensors_object is not None and len(pose.T_sensors_object) == len(views):
            seen[k] = pose.T_sensors_object
    return seen


def propose_together(
    views: Sequence[View],
    alone: Sequence[PosePosterior],
    fused: PosePosterior,
    radius_m: float,
    options: HypothesisOptions,
) -> list[Mode]:
    """Return modes to refine against several touches, in the first touch's sensor frame.

    The most probable poses of each touch are collected. The poses that are likely in the grids of all touches are
    rendered coarsely. The poses that explain all touches best are kept, none within `radius_m` metres of a better one.
    Each mode has the index of the nearest pose in the first touch's grid.
    """
    likeliest = [posterior.grid.T_sensor_object[posterior.top(options.listed)] for posterior in alone]
    poses = np.concatenate([invert(view.T_sensor_first) @ some for view, some in zip(views, likeliest, strict=True)])
    likely = np.zeros(len(poses))
    for view, posterior in zip(views, alone, strict=True):
        far, nearest = posterior.grid.nearest(view.T_sensor_first @ poses)
        likely += np.maximum(posterior.log_p[nearest], posterior.log_p.max() - DOUBT) - far / radius_m
    poses = poses[suppress_non_maxima(poses, likely, fused.grid.metric, 0.5 * radius_m, options.drawn)]
    ious = compute_imprint_ious(views, poses, pixels=options.image_px, freedom_m=radius_m).mean(axis=1)
    poses = poses[suppress_non_maxima(poses, ious, fused.grid.metric, radius_m, options.refined_together)]
    nearest = fused.grid.nearest(poses)[1]
    p = fused.probabilities[nearest]
    return [
        Mode(int(index), float(mass), pose, np.array([index]))
        for index, mass, pose in zip(nearest, p, poses, strict=True)
    ]


def split_modes(posterior: PosePosterior, modes: Sequence[Mode], radius_m: float, count: int) -> list[Mode]:
    """Split modes, the most probable first, into at most `count` modes, at least as many as before.

    All poses of a mode may lead to the same refined pose, or its peak may lead to a pose that explains the touch worse
    than others. So besides the peaks, the most probable members become modes, none within `radius_m` metres of a more
    probable one. All other members belong to the nearest mode.
    """
    grid, members = posterior.grid, np.concatenate([mode.members for mode in modes])
    peaks = np.array([mode.index for mode in modes])
    others = members[~np.isin(members, peaks)]
    apart = suppress_non_maxima(
        grid.T_sensor_object[others], posterior.log_p[others], grid.metric, radius_m, count - len(peaks)
    )
    chosen = np.concatenate([peaks, others[apart]])
    points = grid.metric.embed(grid.T_sensor_object[members])
    of = measure_distances(points, grid.metric.embed(grid.T_sensor_object[chosen])).argmin(axis=1)
    return [_make_mode(posterior, index, members[of == k]) for k, index in enumerate(chosen)]


def _make_mode(posterior: PosePosterior, index: int, members: NDArray[np.int64]) -> Mode:
    """Return the mode whose most probable pose has this index of the grid."""
    mass = float(posterior.probabilities[members].sum())
    return Mode(int(index), mass, posterior.grid.T_sensor_object[index], members)


def choose_best_apart(posterior: PosePosterior, radius_m: float, top: int) -> list[Mode]:
    """Return the most probable poses as modes, at most `top`, none within `radius_m` metres of a more probable one.

    Each grid pose within that radius of a mode is a member of the nearest mode.
    """
    grid = posterior.grid
    chosen = suppress_non_maxima(grid.T_sensor_object, posterior.log_p, grid.metric, radius_m, top)
    points = grid.metric.embed(grid.T_sensor_object)
    far = measure_distances(points, points[chosen])
    of, near = far.argmin(axis=1), far.min(axis=1) <= radius_m
    members = [np.flatnonzero(near & (of == k)) for k in range(len(chosen))]
    return [_make_mode(posterior, k, some) for k, some in zip(chosen, members, strict=True)]
