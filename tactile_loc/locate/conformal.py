"""Sets of poses that hold the true one with a given probability: split conformal prediction.

See Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World* (2005). The score is that of adaptive
prediction sets (Romano, Sesia and Candes, NeurIPS 2020): the total probability of all poses likelier than the true one.
If a touch is exchangeable with the n held-out ones, the credible set of level

    the ceil((n + 1) coverage)-th smallest of their scores

holds the grid pose nearest to the truth with at least the probability asked for, however bad the posteriors are.
Uncertain posteriors err differently from certain ones. So posteriors with a high entropy are compared with the quarter
of the examples that have the greatest entropy, and all others with the rest (Mondrian sets). The coverage then holds
for both groups.
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
UNCERTAIN = 0.25  # share of the examples with the greatest entropy, used for posteriors of high entropy
MOST_TOUCHES = 7  # used for more touches too: their sets are no larger
NOT_FOUND = 1.0  # score if the truth is at none of the posterior's poses
SEED = 0xC0DE  # differs from those of evaluations and of fits


@dataclass(frozen=True)
class ConformalSets:
    """Held-out examples: the probability of all poses likelier than the true one, `scores` (n,), 0 to 1, and the
    posteriors' `entropies` (n,), nats."""

    scores: Sequence[float]
    entropies: Sequence[float]

    def find_alike(self, entropy: float) -> NDArray[np.float64]:
        """Return the sorted scores (m,) of the examples used for posteriors with this entropy, nats."""
        entropies = np.asarray(self.entropies)
        border = np.quantile(entropies, 1 - UNCERTAIN)
        return np.sort(np.asarray(self.scores)[(entropies >= border) == (entropy >= border)])

    def level(self, coverage: float, entropy: float) -> float:
        """Return the credible level, 0 to 1, of sets that hold the truth with probability `coverage`, 0 to 1.

        `entropy`, nats, is that of the posterior. Raises ConfigError if there are too few examples for the coverage.
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
    """Grid poses that include the one nearest to the truth with probability `coverage`, 0 to 1.

    `indices` (K,) are the poses' indices in the posterior's grid, the likeliest first. Their total posterior
    probability is at least `level`, which may differ from `coverage`. `examples` counts the held-out examples that
    support the coverage. If the search misses the truth too often for the coverage, the set holds all poses found, and
    `elsewhere` is true.
    """

    coverage: float
    level: float
    examples: int
    indices: NDArray[np.int64]
    elsewhere: bool = False

    @classmethod
    def of(cls, posterior: PosePosterior, sets: ConformalSets, coverage: float) -> PoseSet:
        """Make the set of a posterior for the coverage asked for. Raises ConfigError if that is not possible."""
        level = sets.level(coverage, posterior.entropy)
        elsewhere = level >= NOT_FOUND and posterior.elsewhere > 0
        return cls(coverage, level, len(sets.find_alike(posterior.entropy)), posterior.credible_set(level), elsewhere)
