"""The answer: a distribution over the poses of a grid, kept in log space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import GridError
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseGrid

MOST_CLUSTERED = 2000


@dataclass(frozen=True, eq=False)
class Mode:
    """One distinct hypothesis: the most probable pose of a cluster and the probability of all its poses.

    `index` is the grid index of the peak, `members` (K,) the grid indices, `T_sensor_object` (4, 4) in metres.
    """

    index: int
    probability: float
    T_sensor_object: NDArray[np.float64]
    members: NDArray[np.int64]


@keep_old_names(tempered="temper")
@dataclass(frozen=True, eq=False)
class PosePosterior:
    """Log-probabilities `log_p` (N,) over a grid's poses; -inf where a pose is excluded.

    `log_train` (N,) is the distribution of the poses that the probabilities were learned from, P_train, up to a
    constant; None if they were all alike. Fusers divide by it. `touches` tells from how many touches they come.
    `elsewhere` is the probability, below 1, that the pose is near none of the grid's: that of a search which looked at
    the likeliest poses alone. Normalised on creation: all together are one. Raises GridError when no pose has any
    probability, a value is NaN, or `log_train` is not finite.
    """

    grid: PoseGrid
    log_p: NDArray[np.float64]
    log_train: NDArray[np.float64] | None = None
    touches: int = 1
    elsewhere: float = 0.0

    def __post_init__(self) -> None:
        log_p = np.asarray(self.log_p, float)
        if log_p.shape != (len(self.grid),) or np.isnan(log_p).any() or not np.isfinite(log_p.max()):
            raise GridError("no pose of the grid explains the touch: all probabilities are zero or undefined")
        peak = log_p.max()
        if not 0 <= self.elsewhere < 1:
            raise GridError(f"the probability of other poses is {self.elsewhere}; it must be from 0 to below 1")
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
    def probabilities(self) -> NDArray[np.float64]:
        """The probabilities (N,), which sum to one, less what is `elsewhere`."""
        return np.exp(self.log_p)

    def top(self, count: int) -> NDArray[np.int64]:
        """Return the grid indices (K,) of the `count` most probable poses, most probable first, ties by index."""
        count = min(count, len(self.log_p))
        least = np.partition(self.log_p, -count)[-count]
        best = np.flatnonzero(self.log_p >= least)  # more than `count` where several are as probable as the last
        return best[np.argsort(-self.log_p[best], kind="stable")][:count]

    def credible_level(self, index: int, lot: float = 0.0) -> float:
        """Return the probability of all poses that are likelier than pose `index` of the grid, 0 to below 1.

        The share `lot` of its own, and of those as probable, is added: drawn uniformly from 0 to 1 it makes the level
        uniform if probabilities are true (a randomised probability integral transform).
        """
        p = self.probabilities
        return min(1.0, float(p[p > p[index]].sum() + lot * p[p == p[index]].sum()))

    def credible_set(self, level: float, most: int | None = None) -> NDArray[np.int64]:
        """Return the indices (K,), likeliest first, of the poses whose `credible_level` is at most `level`.

        They hold that probability at least, and without the least likely of them less, or just as much; unless they
        are more than `most`, of which the likeliest are returned.
        """
        order = self.top(len(self.log_p) if most is None else most)
        p = self.probabilities[order]
        first = np.searchsorted(-p, -p, side="left")  # of those as probable
        likelier = np.concatenate([[0.0], np.cumsum(p)])[first]
        return order[(likelier <= level) & (p > 0)]

    def temper(self, power: float) -> PosePosterior:
        """Return the posterior whose probabilities are these to the `power`, normalised: below 1 it is less sure."""
        if power == 1.0:
            return self
        log_train = None if self.log_train is None else power * self.log_train
        return PosePosterior(self.grid, power * self.log_p, log_train, self.touches, self.elsewhere)

    @property
    def entropy(self) -> float:
        """Shannon entropy in nats: 0 when one pose is certain, log N when nothing is known (unitless).

        What is elsewhere counts as one pose more.
        """
        p = self.probabilities
        other = self.elsewhere
        return float(-(p[p > 0] * self.log_p[p > 0]).sum()) - (other * math.log(other) if other > 0 else 0.0)

    def sample(self, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, with the posterior's probabilities, as if nothing were elsewhere."""
        p = self.probabilities / self.probabilities.sum() if self.elsewhere else self.probabilities
        return self.grid.T_sensor_object[rng.choice(len(self.log_p), size=count, p=p)]

    def modes(
        self, radius_m: float, count: int | None = 10, mass: float = 0.99, core: NDArray[np.int64] | None = None
    ) -> list[Mode]:
        """Cluster the posterior into at most `count` distinct hypotheses, the heaviest first; None: all of them.

        A mode is a peak and all poses from which steps uphill, each to the most probable pose within `radius_m` metres
        (symmetry regarded), lead to it: quick shift (Vedaldi and Soatto, ECCV 2008). What is clustered are the indices
        `core` (K,), the most probable first; by default the poses that hold `mass`, at most MOST_CLUSTERED.
        """
        p = self.probabilities
        core = self.credible_set(mass, MOST_CLUSTERED) if core is None else core
        peaks = _climb(self.grid, core, radius_m)  # each is its own mode's first member
        tops, of = np.unique(peaks, return_inverse=True)
        masses = np.bincount(of, p[core])
        order = np.lexsort((core[tops], -masses))[:count]
        members = [core[of == k] for k in order]
        return [
            Mode(int(core[tops[k]]), float(masses[k]), self.grid.T_sensor_object[core[tops[k]]], some)
            for k, some in zip(order, members, strict=True)
        ]


def _climb(grid: PoseGrid, ordered: NDArray[np.int64], radius_m: float) -> NDArray[np.int64]:
    """Return the place (K,) of each one's peak among the grid indices `ordered` (K,), most probable first; metres."""
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
