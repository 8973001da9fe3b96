"""From the modes of a posterior to distinct hypotheses: refined against every touch, merged, and put in order."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry import invert
from tactile_loc.core.interfaces import Candidate, Prior, RefinedPose, Refiner, Scene
from tactile_loc.core.poses import PoseMetric, Poses
from tactile_loc.core.posterior import Mode
from tactile_loc.core.progress import StageTimes
from tactile_loc.core.sensing import Touch
from tactile_loc.locate.result import Hypothesis

View = tuple[Touch, Scene, Refiner]  # a touch, the object before its sensor, and what refines poses against it

SHARPNESS = 30.0


def find_hypotheses(
    views: Sequence[View], modes: Sequence[Mode], metric: PoseMetric, radius_m: float, prior: Prior | None,
    times: StageTimes,
) -> tuple[Hypothesis, ...]:  # fmt: skip
    """Refine modes, poses in the first touch's sensor frame, merge those that end within `radius_m` metres, and rank.

    Of what refinement against each touch makes of a mode, the pose that all touches together like best is taken.
    """
    with times.stage("refine"):
        tried = _refined(views, modes)
    with times.stage("choose"):
        ious = np.stack([_imprint_ious(views, np.stack([r.T_sensor_object for r in row])) for row in tried])
        best = ious.argmax(axis=0)
        hypotheses = [
            Hypothesis(m.probability, m.T_sensor_object, tried[b][k], m.index, len(m.members), float(ious[b, k]))
            for k, (m, b) in enumerate(zip(modes, best, strict=True))
        ]
        merged = merge_hypotheses(hypotheses, metric, radius_m)
        log_prior = None if prior is None else prior(np.stack([h.T_sensor_object for h in merged]))
        return ranked(merged, log_prior)


def merge_hypotheses(hypotheses: Sequence[Hypothesis], metric: PoseMetric, radius_m: float) -> tuple[Hypothesis, ...]:
    """Merge hypotheses whose refined poses came out within `radius_m` metres of a heavier one; it takes their mass."""
    merged: list[Hypothesis] = []
    for h in hypotheses:
        poses = np.array([m.T_sensor_object for m in merged]).reshape(-1, 4, 4)
        same = np.broadcast_to(h.T_sensor_object, poses.shape)
        near = np.flatnonzero(metric.symmetric_distance(poses, same) < radius_m)
        if h.refined.converged and len(near):
            heavier = merged[near[0]]
            mass, count = heavier.probability + h.probability, heavier.grid_poses + h.grid_poses
            merged[near[0]] = dataclasses.replace(heavier, probability=mass, grid_poses=count)
        else:
            merged.append(h)
    return tuple(sorted(merged, key=lambda h: -h.probability))


def ranked(hypotheses: Sequence[Hypothesis], log_prior: NDArray[np.float64] | None = None) -> tuple[Hypothesis, ...]:
    """Order hypotheses by how well their refined poses explain the touches, and by what was known before.

    The grid's posterior compares coarse shapes at poses that are all a little wrong; below the grid's resolution the
    right one of several explanations shows. With a prior, `log_prior` (K,) of the refined poses, an imprint IoU better
    by one SHARPNESS-th makes up for a pose e times less likely.
    """
    known = np.zeros(len(hypotheses)) if log_prior is None else log_prior
    worth = SHARPNESS * np.array([h.imprint_iou for h in hypotheses]) + known
    return tuple(hypotheses[i] for i in np.lexsort((np.arange(len(hypotheses)), -worth)))


def _refined(views: Sequence[View], modes: Sequence[Mode]) -> list[list[RefinedPose]]:
    """What to choose each mode's pose from, in the first sensor's frame: rows of a pose for each mode.

    Each touch refines all of them. What one touch gains by that others may lose, so of several the grid's poses take
    part as well.
    """
    rows = [[RefinedPose(mode.T_sensor_object, 0.0, False, 0) for mode in modes]] if len(views) > 1 else []
    for touch, scene, refiner in views:
        T_sensor_first = _from_first(views, touch)
        candidates = [Candidate(T_sensor_first @ m.T_sensor_object, m.index, np.log(m.probability)) for m in modes]
        T_first_sensor = invert(T_sensor_first)
        found = refiner.refine_many(touch, candidates, scene)
        rows.append([dataclasses.replace(r, T_sensor_object=T_first_sensor @ r.T_sensor_object) for r in found])
    return rows


def _imprint_ious(views: Sequence[View], T_first_object: Poses) -> NDArray[np.float64]:
    """How well poses (K, 4, 4) in the first sensor's frame explain the touches: mean (K,) over them, 0 to 1."""
    ious = [scene.imprint_ious(_from_first(views, touch) @ T_first_object, touch) for touch, scene, _ in views]
    return np.asarray(np.mean(ious, axis=0))


def _from_first(views: Sequence[View], touch: Touch) -> Poses:
    """`T_sensor_first` (4, 4), metres, from the first touch's sensor frame to this touch's."""
    first = views[0][0]
    if touch is first:
        return np.eye(4)
    T: Poses = invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
    return T
