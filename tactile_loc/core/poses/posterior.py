"""The posterior: a distribution over the poses of a grid, as log-probabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.runtime.errors import GridError

MOST_CLUSTERED = 2000

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Mode:
    """A cluster of grid poses around a peak, its most probable pose.

    `index` is the grid index of the peak, and `T_sensor_object` (4, 4), metres, is its pose. `members` (K,) are the
    grid indices of all poses of the cluster. `probability` is the sum of their probabilities.
    """

    index: int
    probability: float
    T_sensor_object: Floats
    members: Ints


@dataclass(frozen=True)
class NoPoseLeft:
    """The result of a fusion that excludes all poses. `reason` states why in one sentence.

    `touch` is the number, from 0, of the touch that excludes the last poses, if there is one. `outlier` is the number
    of the only touch without which the other touches share a pose. It is None if there is no such touch, or several.
    """

    reason: str
    touch: int | None = None
    outlier: int | None = None

    def name_touch(self, names: Sequence[str]) -> NoPoseLeft:
        """Return the same result with the touch's name in its reason. `names` are those of all touches."""
        if self.touch is None:
            return self
        number = f"touch {self.touch + 1}"
        return replace(self, reason=self.reason.replace(number, f"{number} ({names[self.touch]})", 1))


@dataclass(frozen=True, eq=False)
class PosePosterior:
    """Log-probabilities `log_p` (N,) of a grid's poses. An excluded pose has -inf.

    The probabilities were fitted to simulated touches. `log_train` (N,) is the logarithm, up to a constant, of the
    distribution P_train of these touches' poses. None means that it was uniform. Fusers divide by P_train. `touches` is
    the number of touches behind the posterior. `elsewhere`, below 1, is the probability that the true pose is near none
    of the grid's poses. It can be above 0 if a search found the poses, because a search finds only likely poses. On
    creation, the probabilities are normalised so that they and `elsewhere` sum to one. Raises GridError if no pose has
    any probability, a value is NaN, `log_train` is not finite, or `elsewhere` is not in [0, 1).
    """

    grid: PoseGrid
    log_p: Floats
    log_train: Floats | None = None
    touches: int = 1
    elsewhere: float = 0.0

    def __post_init__(self) -> None:
        log_p = np.asarray(self.log_p, float)
        if log_p.shape != (len(self.grid),) or np.isnan(log_p).any() or not np.isfinite(log_p.max()):
            raise GridError(
                "no pose of the grid explains the touch; check the touch and the prior, or search a larger grid"
            )
        peak = log_p.max()
        if not 0 <= self.elsewhere < 1:
            raise GridError(f"the probability elsewhere is {self.elsewhere}; it must be at least 0 and below 1")
        total = np.log(np.exp(log_p - peak).sum()) - np.log1p(-self.elsewhere)
        object.__setattr__(self, "log_p", log_p - peak - total)
        if self.log_train is not None and (
            np.shape(self.log_train) != log_p.shape or not np.isfinite(self.log_train).all()
        ):
            raise GridError(
                f"the training distribution has the shape {np.shape(self.log_train)} or values that are not finite; "
                f"give one log-probability for each of the grid's {len(self.grid)} poses"
            )

    @property
    def probabilities(self) -> Floats:
        """The probabilities (N,), which sum to one minus `elsewhere`."""
        return np.exp(self.log_p)

    def top(self, count: int) -> Ints:
        """Return the grid indices (K,) of the `count` most probable poses, the most probable first, ties by index."""
        count = min(count, len(self.log_p))
        least = np.partition(self.log_p, -count)[-count]
        best = np.flatnonzero(self.log_p >= least)  # more than `count` if poses are as probable as the last one
        return best[np.argsort(-self.log_p[best], kind="stable")][:count]

    def credible_level(self, index: int, lot: float = 0.0) -> float:
        """Return the total probability of all poses likelier than pose `index` of the grid, 0 to below 1.

        The share `lot`, 0 to 1, of the probability of all poses that are exactly as likely, including pose `index`, is
        added. If `lot` is drawn uniformly and the probabilities are correct, the level is uniform. This is a randomised
        probability integral transform.
        """
        p = self.probabilities
        return min(1.0, float(p[p > p[index]].sum() + lot * p[p == p[index]].sum()))

    def credible_set(self, level: float, most: int | None = None) -> Ints:
        """Return the indices (K,), likeliest first, of the poses whose `credible_level` is at most `level`.

        Unless `elsewhere` is too large, these poses together have at least the probability `level`. If there are more
        than `most` poses, only the likeliest are returned.
        """
        order = self.top(len(self.log_p) if most is None else most)
        p = self.probabilities[order]
        first = np.searchsorted(-p, -p, side="left")  # position of the first equally probable pose
        likelier = np.concatenate([[0.0], np.cumsum(p)])[first]
        return order[(likelier <= level) & (p > 0)]

    def temper(self, power: float) -> PosePosterior:
        """Return the posterior with its probabilities raised to `power`. A power below 1 makes it less certain."""
        if power == 1.0:
            return self
        log_train = None if self.log_train is None else power * self.log_train
        return PosePosterior(self.grid, power * self.log_p, log_train, self.touches, self.elsewhere)

    @property
    def entropy(self) -> float:
        """Shannon entropy in nats (unitless): 0 if one pose is certain, log N if nothing is known.

        `elsewhere` counts as one more pose.
        """
        p = self.probabilities
        other = self.elsewhere
        return float(-(p[p > 0] * self.log_p[p > 0]).sum()) - (other * math.log(other) if other > 0 else 0.0)

    def sample(self, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, with the posterior's probabilities, ignoring `elsewhere`."""
        p = self.probabilities / self.probabilities.sum() if self.elsewhere else self.probabilities
        return self.grid.T_sensor_object[rng.choice(len(self.log_p), size=count, p=p)]

    def modes(self, radius_m: float, count: int | None = 10, mass: float = 0.99) -> list[Mode]:
        """Return the `count` most probable modes, or all modes if it is None, the most probable first.

        A mode is a peak and all poses from which uphill steps lead to this peak. Each step goes to the most probable
        pose within `radius_m` metres, up to symmetry. This is quick shift (Vedaldi and Soatto, ECCV 2008). Only the
        credible set of level `mass` is clustered, and at most MOST_CLUSTERED poses.
        """
        p, core = self.probabilities, self.credible_set(mass, MOST_CLUSTERED)
        peaks = _climb(self.grid, core, radius_m)
        tops, of = np.unique(peaks, return_inverse=True)
        masses = np.bincount(of, p[core])
        order = np.lexsort((core[tops], -masses))[:count]
        members = [core[of == k] for k in order]
        return [
            Mode(int(core[tops[k]]), float(masses[k]), self.grid.T_sensor_object[core[tops[k]]], some)
            for k, some in zip(order, members, strict=True)
        ]


def require_pose_left(found: Found | NoPoseLeft) -> Found:
    """Return what was found. Raises GridError with the reason if no pose is left."""
    if isinstance(found, NoPoseLeft):
        raise GridError(found.reason)
    return found


def _climb(grid: PoseGrid, ordered: Ints, radius_m: float) -> Ints:
    """Return the position (K,) of each pose's peak in `ordered` (K,), which are grid indices, most probable first."""
    from scipy.spatial import cKDTree

    same = grid.metric.embed_orbits(grid.T_sensor_object[ordered])
    tree = cKDTree(same[0])
    parent = np.arange(len(ordered))
    for equivalents in same:
        pairs = cKDTree(equivalents).sparse_distance_matrix(tree, radius_m, output_type="ndarray")
        np.minimum.at(parent, pairs["i"], pairs["j"])
    while (parent != parent[parent]).any():
        parent = parent[parent]
    return parent


TIE_NATS = 3e-4  # the rounding of another processor changes log-probabilities of poses by less
GENERIC = np.array([0.71, 1.13, -0.37, 0.93, -1.31, 0.53, -0.83, 0.61, 1.07, 1.49, -1.19, 0.79])  # no pair is alike


def group_ties(worth: Floats, tie: float) -> Ints:
    """Return the number (K,) of each value's group: 0 for the greatest of `worth` (K,) and those within `tie` of it.

    Each further group has the greatest of the other values and those within `tie` of this value.
    """
    order = np.argsort(-worth, kind="stable")
    groups, leader, number = np.empty(len(worth), np.int64), np.inf, -1
    for k in order:
        if not worth[k] >= leader - tie:
            leader, number = worth[k], number + 1
        groups[k] = max(number, 0)
    return groups


def rank_poses(groups: Ints, T_object: Poses, metric: PoseMetric) -> Ints:
    """Return the order (K,) of poses (K, 4, 4), metres, by their `groups` (K,) of ties, and in a group by place."""
    return np.lexsort((metric.embed(T_object) @ GENERIC, groups))
