"""Sets of poses that contain the true pose with a given probability: split conformal prediction.

See Vovk, Gammerman and Shafer, *Algorithmic Learning in a Random World* (2005). A result is a ranking: its distinct
refined poses, and "elsewhere" as one more item, which is right if no pose is. Each of n held-out examples has a score.
If a pose is right, it is the total probability of all likelier poses, as in adaptive prediction sets (Romano, Sesia and
Candes, NeurIPS 2020). If "elsewhere" is right, it is 1 - e / RARE, where e is the predicted probability of "elsewhere".
The set of a new result contains the items whose score is at most the level

    the ceil((n + 1) coverage)-th smallest of the n scores.

Let the touches be exchangeable with the examples. Then the set contains the right item with at least the probability
`coverage`, even if the probabilities are bad. The examples are of many parts and sensors, which no fit has used; their
scores are shipped with the model of outcomes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.poses.pose_errors import RIGHT_M
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.runtime.formatting import format_mm

RARE = 4.0  # at a level of 0.95, "elsewhere" is in the set if its probability is at least 0.05 times this
ELSEWHERE = -1  # the number of the item "elsewhere"
LISTED = 40  # fewest poses to refine for a set, if there are that many


@dataclass(frozen=True, eq=False)
class Ranking:
    """The distinct poses of one result, the most probable first, and the probability `elsewhere` that none is right.

    `probabilities` (K,) are those of the poses if one of them is right: they sum to one.
    """

    probabilities: Floats
    elsewhere: float

    @classmethod
    def of(cls, probabilities: Sequence[float], elsewhere: float) -> Ranking:
        """Make a ranking of poses from probabilities (K,) up to a factor."""
        p = np.asarray(probabilities, float)
        total = p.sum()
        return cls(p / total if total > 0 else np.full(len(p), 1 / len(p)), elsewhere)

    def score(self, item: int) -> float:
        """Return the score of pose number `item`, or of `ELSEWHERE`, 0 to 1."""
        if item == ELSEWHERE:
            return max(0.0, 1 - self.elsewhere / RARE)
        return min(1.0, float(self.probabilities[self.probabilities > self.probabilities[item]].sum()))

    def count(self, level: float) -> int:
        """Return the number of poses, at least 1, whose score is at most `level`: they are the first ones."""
        return max(1, sum(self.score(number) <= level for number in range(len(self.probabilities))))


def find_level(scores: Floats, coverage: float) -> float:
    """Return the level for a coverage given the scores (n,) of examples, all 0 to 1; infinite if n is too small.

    Raises ConfigError unless the coverage is between 0 and 1.
    """
    if not 0 < coverage < 1:
        raise ConfigError(f"the coverage is {coverage:g}; give more than 0 and less than 1")
    rank = math.ceil((len(scores) + 1) * coverage - 1e-9)
    return float(np.sort(scores)[rank - 1]) if rank <= len(scores) else math.inf


@dataclass(frozen=True, eq=False)
class PoseSet:
    """The first `poses` hypotheses of a result: a set that contains the true pose with probability `coverage`, 0 to 1.

    A pose is the true one if its pose error is at most `radius_m` metres. If `elsewhere` is true, the set also contains
    "elsewhere": the true pose may be none of the listed ones. `missed`, 0 to 1, is the predicted probability of that.
    `level` is the total probability up to which poses are listed, and `examples` is the number of held-out examples
    that decide it. `promised` states whether the listed poses alone have the coverage. If not, `reason` is a sentence
    that states why.
    """

    coverage: float
    level: float
    examples: int
    poses: int
    radius_m: float
    missed: float = 0.0
    elsewhere: bool = False
    promised: bool = True
    reason: str = ""

    @property
    def title(self) -> str:
        """The name of the set: 95 % set."""
        return f"{100 * self.coverage:g} % set"

    @property
    def size(self) -> str:
        """The number of poses, and whether the set contains "elsewhere", in words."""
        poses = "1 pose" if self.poses == 1 else f"{self.poses} poses"
        return f"{poses} or elsewhere" if self.elsewhere else poses

    @property
    def meaning(self) -> str:
        """The probability that the set contains the true pose, or the reason why that is unknown, in words."""
        if not self.promised:
            return self.reason
        return (
            f"The true pose is within {format_mm(self.radius_m)} mm of one of these poses with this probability, "
            f"measured on {self.examples} simulated examples of other parts."
        )

    @classmethod
    def of(cls, ranking: Ranking, scores: Floats, coverage: float, doubt: str = "") -> PoseSet:
        """Make a result's set with the requested coverage, given the scores (n,) of examples.

        `doubt` is a sentence that states why the examples say nothing about this result; empty if they do. Raises
        ConfigError unless the coverage is between 0 and 1.
        """
        level, examples = find_level(scores, coverage), len(scores)
        elsewhere = ranking.score(ELSEWHERE) <= level
        reason = doubt
        if not reason and math.isinf(level):
            most = math.floor(1000 * examples / (examples + 1)) / 10
            reason = f"{examples} simulated examples are too few for this coverage; they promise at most {most:g} %."
        if not reason and elsewhere:
            reason = (
                "The search misses the true pose of touches like these too often: it is none of the listed poses with "
                f"a probability of {100 * ranking.elsewhere:.0f} %."
            )
        kept = ranking.count(level)
        return cls(coverage, min(level, 1.0), examples, kept, RIGHT_M, ranking.elsewhere, elsewhere, not reason, reason)
