"""Sets of poses that hold the true one as often as asked for: split conformal prediction.

Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World* (2005); the score is that of adaptive prediction
sets (Romano, Sesia and Candes, NeurIPS 2020): the probability of all poses that are likelier than the true one.
Whatever the posteriors are worth, of touches that are exchangeable with the n that were held out, the set of level

    the ceil((n + 1) coverage)-th smallest of their scores

holds the grid pose that is nearest to the truth with the probability asked for, at least.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.noise import noise_level
from tactile_loc.core.posterior import PosePosterior

STAGE, STAGE_VERSION = "conformal", 1
EXAMPLES = 200  # held out
MOST_TOUCHES = 7  # more are taken as so many: sets of more touches are no larger
NOISE = "strong"
SEED = 0xC0DE  # neither an evaluation's nor that of a fit


@dataclass(frozen=True)
class ConformalSets:
    """The scores (n,) of held-out examples, 0 to 1: how probable the poses likelier than the true one were together."""

    scores: Sequence[float]

    def level(self, coverage: float) -> float:
        """Return the credible level of the sets that hold the truth with probability `coverage`, both 0 to 1.

        Raises ConfigError for a coverage that so few examples cannot promise.
        """
        count = len(self.scores)
        rank = math.ceil((count + 1) * coverage - 1e-9) if 0 < coverage < 1 else math.inf
        if rank > count:
            raise ConfigError(
                f"a coverage of {coverage:g} cannot be promised from {count} simulated examples; ask for one above 0 "
                f"and at most {math.floor(1000 * count / (count + 1)) / 1000:g}"
            )
        return float(np.sort(self.scores)[int(rank) - 1])


@dataclass(frozen=True, eq=False)
class PoseSet:
    """Grid poses, among them the one nearest to the truth with probability `coverage`, 0 to 1.

    `indices` (K,) are those in the posterior's grid, the likeliest first; their probabilities, which need not be true,
    say that they hold `level` or more; `examples` held-out ones vouch for the coverage.
    """

    coverage: float
    level: float
    examples: int
    indices: NDArray[np.int64]

    @classmethod
    def of(cls, posterior: PosePosterior, sets: ConformalSets, coverage: float) -> PoseSet:
        """Return the set of a posterior with the coverage asked for. Raises ConfigError if it cannot be promised."""
        level = sets.level(coverage)
        return cls(coverage, level, len(sets.scores), posterior.credible_set(level))


def describe_examples(touches: int) -> dict[str, Any]:
    """Return what decides which examples of so many touches are held out, but for what draws them, as JSON values."""
    return {"noise": noise_level(NOISE).describe(), "touches": touches, "examples": EXAMPLES, "seed": SEED}
