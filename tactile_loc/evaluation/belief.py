"""Can the probabilities be trusted: how probable the truth was, and how often it is where it is said to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import PosePosterior

BELIEF = ("nll", "level", "entropy", "expected", "spread")
LEVELS = (0.5, 0.8, 0.95)
STEP_M = 1e-3  # of a continuous symmetry, in measuring distances


def belief(posterior: PosePosterior, T_true: Poses, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the numbers (5,) of BELIEF of a posterior whose true pose (4, 4), metres, is known.

    `nll`, nats: of the grid pose nearest to the truth. `level`: the probability of the smallest credible set that holds
    that pose, drawn at random within its own share, so that it is uniform if probabilities are true (a randomised
    probability integral transform). `entropy`, nats. `expected` and `spread`, metres: the mean distance from the truth,
    and from the most probable pose, of poses drawn from the posterior; symmetry regarded.
    """
    p = posterior.probabilities
    truth = int(posterior.grid.nearest(T_true[None])[1][0])
    level = p[p > p[truth]].sum() + rng.random() * p[p == p[truth]].sum()
    best = posterior.grid.T_sensor_object[int(posterior.log_p.argmax())]
    expected, spread = (float(p @ posterior.grid.distances(T, STEP_M)) for T in (T_true, best))
    return np.array([-posterior.log_p[truth], min(level, 1.0), posterior.entropy, expected, spread])


@dataclass(frozen=True)
class Trust:
    """What the beliefs of many touches come to: means over touches, lengths in metres, `nll` and `uniform_nll` in nats.

    `coverage` are the shares of touches whose truth is in the credible set of each of LEVELS.
    """

    nll: float
    uniform_nll: float
    coverage: tuple[float, ...]
    entropy: float
    expected_m: float
    spread_m: float

    @classmethod
    def of(cls, beliefs: NDArray[np.float64], grid_poses: int) -> Trust:
        """Sum up beliefs (T, 5) about a grid of so many poses."""
        nll, level, entropy, expected_m, spread_m = beliefs.T
        coverage = tuple(float((level <= sure).mean()) for sure in LEVELS)
        means = (float(v.mean()) for v in (entropy, expected_m, spread_m))
        return cls(float(nll.mean()), float(np.log(grid_poses)), coverage, *means)
