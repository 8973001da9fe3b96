"""Sets of poses that hold the true one as often as asked for: split conformal prediction.

Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World* (2005); the score is that of adaptive prediction
sets (Romano, Sesia and Candes, NeurIPS 2020): the probability of all poses that are likelier than the true one.
Whatever the posteriors are worth, of touches that are exchangeable with the n that were held out, the set of level

    the ceil((n + 1) coverage)-th smallest of their scores

holds the grid pose that is nearest to the truth with the probability asked for, at least. Posteriors that know little
are wrong in other ways than those that know much: the quarter of the examples with the greatest entropy vouches for the
like of it, the rest for the rest (Mondrian sets), so that the promise holds for either.
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
EXAMPLES = 200  # held out
UNCERTAIN = 0.25  # of them, those with the greatest entropy, vouch for their like
MOST_TOUCHES = 7  # more are taken as so many: sets of more touches are no larger
NOT_FOUND = 1.0  # score of a truth that is at none of the posterior's poses
SEED = 0xC0DE  # neither an evaluation's nor that of a fit


@dataclass(frozen=True)
class ConformalSets:
    """Held-out examples: how probable the poses likelier than the true one were together, `scores` (n,), 0 to 1, and
    the `entropies` (n,) of the posteriors, nats."""

    scores: Sequence[float]
    entropies: Sequence[float]

    def find_alike(self, entropy: float) -> NDArray[np.float64]:
        """Return the scores (m,), the least first, of the examples that vouch for posteriors of an entropy, nats."""
        entropies = np.asarray(self.entropies)
        border = np.quantile(entropies, 1 - UNCERTAIN)
        return np.sort(np.asarray(self.scores)[(entropies >= border) == (entropy >= border)])

    def level(self, coverage: float, entropy: float) -> float:
        """Return the credible level, 0 to 1, of the sets that hold the truth with probability `coverage`, 0 to 1.

        They are of posteriors of this entropy, nats. Raises ConfigError for a coverage that so few examples cannot
        promise.
        """
        scores = self.find_alike(entropy)
        count = len(scores)
        rank = math.ceil((count + 1) * coverage - 1e-9) if 0 < coverage < 1 else math.inf
        if rank > count:
            raise ConfigError(
                f"a coverage of {coverage:g} cannot be promised from {count} simulated examples; ask for one above 0 "
                f"and at most {math.floor(1000 * count / (count + 1)) / 1000:g}"
            )
        return float(scores[int(rank) - 1])


@dataclass(frozen=True, eq=False)
class PoseSet:
    """Grid poses, among them the one nearest to the truth with probability `coverage`, 0 to 1.

    `indices` (K,) are those in the posterior's grid, the likeliest first; their probabilities, which need not be true,
    say that they hold `level` or more; `examples` held-out ones vouch for the coverage. Where a search of the whole
    object does not find the truth often enough, the set has everything that was found, and what is `elsewhere` too.
    """

    coverage: float
    level: float
    examples: int
    indices: NDArray[np.int64]
    elsewhere: bool = False

    @classmethod
    def of(cls, posterior: PosePosterior, sets: ConformalSets, coverage: float) -> PoseSet:
        """Return the set of a posterior with the coverage asked for. Raises ConfigError if it cannot be promised."""
        level = sets.level(coverage, posterior.entropy)
        elsewhere = level >= NOT_FOUND and posterior.elsewhere > 0
        return cls(coverage, level, len(sets.find_alike(posterior.entropy)), posterior.credible_set(level), elsewhere)
