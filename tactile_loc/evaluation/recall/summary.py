"""Summaries of located examples: recall, average recall, verdicts, and the reliability of verdicts and probabilities.

Recall at a threshold is the share of examples with a smaller error. Examples without a pose count as missed. Averages
of recall over thresholds follow the BOP toolkit (Hodan et al., ECCVW 2020). There, MSSD has ten thresholds, from 5 to
50 % of the object's diameter.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.evaluation.recall.evaluation import ABSENT, METRICS, RIGHT_M, VERDICTS, RecallEvaluation
from tactile_loc.locate.result.verdict import Verdict

WITHIN_M = (0.5e-3, 1e-3, 5e-3)
CURVE_M = tuple(
    1e-4 * np.arange(1, 51)
)  # 0.1, 0.2, ... 5 mm, for the area under the recall curve of the surface distance
DIAMETER_SHARES = tuple(0.05 * np.arange(1, 11))  # for the average recall of MSSD
PROBABILITY_BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
SURE = 1.96  # standard deviations of a normal distribution that hold 95 %


@dataclass(frozen=True, eq=False)
class RecallRun:
    """One object evaluated with one encoder, one noise and one seed.

    `noise` is the noise of simulated touches, or the kind of other touches. `diameter_m` is the largest distance of two
    surface points. `configuration` has every setting as JSON values.
    """

    object: str
    symmetry: str
    diameter_m: float
    encoder: str
    noise: str
    seed: int | None
    evaluation: RecallEvaluation
    configuration: Mapping[str, Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The outcomes of E examples, located from the same number of touches.

    `errors_m` (E, 2, M), metres, has the METRICS of the first pose, and the least of all listed poses; infinite without
    a pose. `probability` (E,) is the first pose's; NaN without a pose. `diameter_m` (E,) is the object's.
    """

    errors_m: NDArray[np.float64]
    probability: NDArray[np.float64]
    verdict: NDArray[np.str_]
    problem: NDArray[np.str_]
    determined: NDArray[np.bool_]
    seconds: NDArray[np.float64]
    diameter_m: NDArray[np.float64]

    @classmethod
    def of(cls, run: RecallRun, touches: int) -> Outcomes:
        """Return the outcomes of a run's examples that have this number of touches."""
        found = run.evaluation
        column = found.together.index(touches)
        kept = found.verdict[:, column] != ABSENT
        errors_m = found.errors_m[kept, column]
        both = np.stack([errors_m[:, 0], errors_m.min(axis=1)], axis=1)
        return cls(
            both, found.probabilities[kept, column, 0], found.verdict[kept, column], found.problem[kept, column],
            found.determined[kept, column], found.seconds[kept, column], np.full(len(both), run.diameter_m),
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Iterable[Outcomes]) -> Outcomes:
        """Return the outcomes of several runs as one."""
        names = cls.__dataclass_fields__
        columns = zip(*([getattr(part, name) for name in names] for part in parts), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    def __len__(self) -> int:
        return len(self.errors_m)

    def select_errors(self, metric: str = "surface", listed: bool = False) -> NDArray[np.float64]:
        """Return the errors (E,), metres, of the first pose, or the least of the `listed` poses."""
        return self.errors_m[:, int(listed), METRICS.index(metric)]

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether the first pose of each example (E,) is right: within RIGHT_M, by surface distance."""
        return self.select_errors() < RIGHT_M

    def measure_recall(self, thresholds_m: Sequence[float], listed: bool = False) -> NDArray[np.float64]:
        """Return the recall (T,), 0 to 1, of the surface distance at thresholds (T,), metres."""
        return (self.select_errors(listed=listed)[:, None] < np.asarray(thresholds_m)).mean(axis=0)


@dataclass(frozen=True)
class ProbabilityBin:
    """The examples whose first pose has a probability from `low` to `high`.

    `stated` is their mean probability, `right` the share of right first poses; None without examples.
    """

    low: float
    high: float
    examples: int
    stated: float | None
    right: float | None


@dataclass(frozen=True)
class RecallSummary:
    """Summary of E examples that are located from the same number of touches. Shares are 0 to 1, lengths in metres.

    `within` and `listed_within` are the recalls of the first pose, and of any listed pose, at WITHIN_M. `auc`, the area
    under the recall curve, is the mean recall at CURVE_M. `average_recall_mssd` is the mean recall of MSSD at
    DIAMETER_SHARES of the diameter. `verdicts` counts the examples with each verdict. `certain_right` is the share of
    certain examples with a right first pose, and `certain_right_range` its 95 % confidence interval (Wilson).
    `determined_right` and `determined_certain` are the shares of the determined examples with a right first pose, and
    with the verdict certain. Values of no examples are None.
    """

    examples: int
    within: tuple[float, ...]
    listed_within: tuple[float, ...]
    auc: float
    listed_auc: float
    average_recall_mssd: float
    listed_average_recall_mssd: float
    median_m: float | None
    determined: int
    determined_right: float | None
    determined_certain: float | None
    verdicts: Mapping[str, int]
    certain_right: float | None
    certain_right_range: tuple[float, float] | None
    bins: tuple[ProbabilityBin, ...]
    median_s: float | None
    p90_s: float | None

    @classmethod
    def of(cls, outcomes: Outcomes) -> RecallSummary:
        """Summarise the outcomes of at least one example."""
        certain = outcomes.verdict == Verdict.CERTAIN.value
        sure = int(outcomes.right[certain].sum())
        median_m = float(np.median(outcomes.select_errors()))
        timed = outcomes.seconds[np.isfinite(outcomes.seconds)]
        counts = Counter(outcomes.verdict.tolist())
        return cls(
            examples=len(outcomes),
            within=tuple(outcomes.measure_recall(WITHIN_M).tolist()),
            listed_within=tuple(outcomes.measure_recall(WITHIN_M, listed=True).tolist()),
            auc=float(outcomes.measure_recall(CURVE_M).mean()),
            listed_auc=float(outcomes.measure_recall(CURVE_M, listed=True).mean()),
            average_recall_mssd=average_mssd_recall(outcomes),
            listed_average_recall_mssd=average_mssd_recall(outcomes, listed=True),
            median_m=median_m if np.isfinite(median_m) else None,
            determined=int(outcomes.determined.sum()),
            determined_right=_average(outcomes.right[outcomes.determined]),
            determined_certain=_average(certain[outcomes.determined]),
            verdicts={verdict: counts[verdict] for verdict in VERDICTS},
            certain_right=_average(outcomes.right[certain]),
            certain_right_range=compute_wilson_range(sure, int(certain.sum())) if certain.any() else None,
            bins=bin_probabilities(outcomes),
            median_s=float(np.median(timed)) if len(timed) else None,
            p90_s=float(np.quantile(timed, 0.9)) if len(timed) else None,
        )


def average_mssd_recall(outcomes: Outcomes, listed: bool = False) -> float:
    """Return the mean recall of MSSD over the thresholds DIAMETER_SHARES of each object's diameter, 0 to 1."""
    relative = outcomes.select_errors("mssd", listed) / outcomes.diameter_m
    return float((relative[:, None] < np.asarray(DIAMETER_SHARES)).mean())


def bin_probabilities(outcomes: Outcomes) -> tuple[ProbabilityBin, ...]:
    """Return the reliability of the first pose's probability, in PROBABILITY_BINS."""
    located = np.isfinite(outcomes.probability)
    p, right = outcomes.probability[located], outcomes.right[located]
    which = np.clip(np.digitize(p, PROBABILITY_BINS) - 1, 0, len(PROBABILITY_BINS) - 2)
    return tuple(
        ProbabilityBin(low, high, int((which == k).sum()), _average(p[which == k]), _average(right[which == k]))
        for k, (low, high) in enumerate(itertools.pairwise(PROBABILITY_BINS))
    )


def compute_wilson_range(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a share, 0 to 1, by Wilson's score (1927)."""
    share, z2 = successes / trials, SURE**2
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = SURE * np.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def measure_diameter(mesh: TriangleMesh) -> float:
    """Return the largest distance of two points of a surface, metres."""
    corners_m = mesh.hull_corners_m
    return max(float(np.linalg.norm(corners_m - corner, axis=1).max()) for corner in corners_m)


def _average(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if len(values) else None
