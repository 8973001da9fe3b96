"""Sets of poses that contain the true pose with a given probability: split conformal prediction.

See Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World* (2005). Each of n held-out examples has a
score: the total probability of all poses likelier than the true pose. This is the score of adaptive prediction sets
(Romano, Sesia and Candes, NeurIPS 2020). The set of a new touch is the credible set of level

    the ceil((n + 1) coverage)-th smallest of the n scores.

Let the touch be exchangeable with the examples. Then the set contains the grid pose nearest to the true pose with at
least the probability `coverage`. This holds even if the posteriors are bad.

Errors of uncertain posteriors are distributed differently from errors of certain posteriors. So the examples are split
into the quarter with the greatest entropy and the rest (Mondrian sets). A posterior is compared with the part that
matches its entropy, so the coverage holds for both parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.poses.posterior import PosePosterior

STAGE, STAGE_VERSION = "conformal", 3
EXAMPLES = 200  # held-out examples
UNCERTAIN = 0.25  # share of the examples with the greatest entropy, used for posteriors of high entropy
MOST_TOUCHES = 7  # the scores for 7 touches also serve more touches, whose sets would be no larger
NOT_FOUND = 1.0  # score of an example whose true pose is not among the posterior's poses
SEED = 0xC0DE  # differs from the seeds of evaluations and fits


@dataclass(frozen=True)
class ConformalSets:
    """The scores and the entropies of n held-out examples.

    `scores` (n,), 0 to 1, are the total probabilities of all poses likelier than the true pose. `entropies` (n,), nats,
    are those of the examples' posteriors.
    """

    scores: Sequence[float]
    entropies: Sequence[float]

    def find_alike(self, entropy: float) -> NDArray[np.float64]:
        """Return the sorted scores (m,) of the examples that are used for posteriors with this `entropy`, nats."""
        entropies = np.asarray(self.entropies)
        border = np.quantile(entropies, 1 - UNCERTAIN)
        return np.sort(np.asarray(self.scores)[(entropies >= border) == (entropy >= border)])

    def level(self, coverage: float, entropy: float) -> float:
        """Return the credible level, 0 to 1, of sets that contain the true pose with probability `coverage`, 0 to 1.

        `entropy`, nats, is the entropy of the posterior. Raises ConfigError if there are too few examples for the
        coverage.
        """
        scores = self.find_alike(entropy)
        count = len(scores)
        rank = math.ceil((count + 1) * coverage - 1e-9) if 0 < coverage < 1 else math.inf
        if rank > count:
            raise ConfigError(
                f"{count} simulated examples are too few for a coverage of {coverage:g}; give more than 0 and at "
                f"most {math.floor(1000 * count / (count + 1)) / 1000:g}"
            )
        return float(scores[int(rank) - 1])


@dataclass(frozen=True, eq=False)
class PoseSet:
    """A set of grid poses that contains the one nearest to the true pose with probability `coverage`, 0 to 1.

    `indices` (K,) are the poses' indices in the posterior's grid, the likeliest first. Their total posterior
    probability is at least `level`, which may differ from `coverage`. `examples` is the number of held-out examples
    that determine the level. If the search misses the true pose too often for the coverage, the set contains all poses
    found, and `elsewhere` is true.
    """

    coverage: float
    level: float
    examples: int
    indices: NDArray[np.int64]
    elsewhere: bool = False

    @classmethod
    def of(cls, posterior: PosePosterior, sets: ConformalSets, coverage: float) -> PoseSet:
        """Make a posterior's set with the requested coverage.

        Raises ConfigError if there are too few examples for the coverage.
        """
        level = sets.level(coverage, posterior.entropy)
        elsewhere = level >= NOT_FOUND and posterior.elsewhere > 0
        return cls(coverage, level, len(sets.find_alike(posterior.entropy)), posterior.credible_set(level), elsewhere)
