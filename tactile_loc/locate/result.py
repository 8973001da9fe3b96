"""What a localisation returns."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.interfaces import Prior, RefinedPose
from tactile_loc.core.poses import PoseMetric
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.sensing import Touch

SHARPNESS = 30.0


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One distinct explanation of the touch.

    `probability` is that of its whole mode; `T_sensor_object` (4, 4) the mode's peak on the grid, `refined` the pose
    below the grid's resolution; `poses` how many grid poses the mode holds; `explained`, 0 to 1, how well the refined
    pose explains the touch in depth and outline (`Scene.explained`). Metres.
    """

    probability: float
    T_sensor_object: NDArray[np.float64]
    refined: RefinedPose
    index: int
    poses: int
    explained: float


@dataclass(frozen=True, eq=False)
class Localization:
    """The answer: the posterior, its distinct hypotheses (`ranked`), and seconds a stage.

    Of several touches, `touch` is the first, in whose sensor's frame the answer is; `others` are the rest.
    """

    touch: Touch
    posterior: PosePosterior
    hypotheses: tuple[Hypothesis, ...]
    seconds: dict[str, float]
    others: tuple[Touch, ...] = ()

    @property
    def best(self) -> Hypothesis:
        """The hypothesis that is ranked first."""
        return self.hypotheses[0]

    @cached_property
    def certainty(self) -> float:
        """1 - entropy / log N (unitless): 1 when one pose is certain, 0 when nothing is known."""
        count = len(self.posterior.grid)
        return 1.0 - self.posterior.entropy / np.log(count) if count > 1 else 1.0


def merge_hypotheses(hypotheses: Sequence[Hypothesis], metric: PoseMetric, radius_m: float) -> tuple[Hypothesis, ...]:
    """Merge hypotheses whose refined poses came out within `radius_m` metres of a heavier one; it takes their mass."""
    merged: list[Hypothesis] = []
    for h in hypotheses:
        poses = np.array([m.refined.T_sensor_object for m in merged]).reshape(-1, 4, 4)
        same = np.broadcast_to(h.refined.T_sensor_object, poses.shape)
        near = np.flatnonzero(metric.symmetric_distance(poses, same) < radius_m)
        if h.refined.converged and len(near):
            heavier = merged[near[0]]
            mass, count = heavier.probability + h.probability, heavier.poses + h.poses
            merged[near[0]] = dataclasses.replace(heavier, probability=mass, poses=count)
        else:
            merged.append(h)
    return tuple(sorted(merged, key=lambda h: -h.probability))


def distinct(
    hypotheses: Sequence[Hypothesis], metric: PoseMetric, radius_m: float, prior: Prior | None = None
) -> tuple[Hypothesis, ...]:
    """Merge hypotheses within `radius_m` metres of one another and rank them; see `merge_hypotheses` and `ranked`."""
    merged = merge_hypotheses(hypotheses, metric, radius_m)
    return ranked(merged, None if prior is None else prior(np.stack([h.refined.T_sensor_object for h in merged])))


def ranked(hypotheses: Sequence[Hypothesis], log_prior: NDArray[np.float64] | None = None) -> tuple[Hypothesis, ...]:
    """Order hypotheses by how well their refined poses explain the touch, and by what was known before.

    The grid's posterior compares coarse shapes at poses that are all a little wrong; below the grid's resolution the
    right one of several explanations shows. With a prior, `log_prior` (K,) of the refined poses, a touch explained one
    SHARPNESS-th better makes up for a pose e times less likely.
    """
    known = np.zeros(len(hypotheses)) if log_prior is None else log_prior
    worth = SHARPNESS * np.array([h.explained for h in hypotheses]) + known
    return tuple(hypotheses[i] for i in np.lexsort((np.arange(len(hypotheses)), -worth)))
