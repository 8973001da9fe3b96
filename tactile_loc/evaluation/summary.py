"""The summary of located examples: recall, verdicts, the reliability of verdicts and probabilities, and statistics.

Recall at a threshold is the share of examples whose pose error is at most the threshold. Examples without a pose count
as missed. The average recall of MSSD, the pose error, follows the BOP toolkit (Hodan et al., ECCVW 2020). It has ten
thresholds, from 5 to 50 % of the object's diameter.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.geometry.rigid import Bools, Floats
from tactile_loc.core.poses.pose_errors import RIGHT_M
from tactile_loc.evaluation.metrics import LEVELS
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.locate.result.verdict import REFUSED, Verdict

VERDICTS = (*(verdict.value for verdict in Verdict), REFUSED)
WITHIN_M = (0.5e-3, 1e-3, 5e-3)
CURVE_M = tuple(1e-4 * np.arange(1, 51))  # 0.1, 0.2, ... 5 mm, for the area under the recall curve
DIAMETER_SHARES = tuple(0.05 * np.arange(1, 11))  # for the average recall of MSSD
PROBABILITY_BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
QUANTILES = {"q25": 0.25, "median": 0.5, "q75": 0.75, "p90": 0.9}


def summarise_errors(errors_m: Floats, scale_m: float) -> dict[str, float]:
    """Return the statistics of errors (E,), metres, and of the errors divided by a scale, metres.

    `std` is the standard deviation of the population. `q25`, `q75` and `p90` are quantiles.
    """
    found: dict[str, float] = {}
    for unit, values in (("m", errors_m), ("normalised", errors_m / scale_m)):
        quantiles = dict(zip(QUANTILES, np.quantile(values, list(QUANTILES.values())), strict=True))
        statistics = {"mean": values.mean(), "median": quantiles["median"], "std": values.std(), **quantiles}
        found |= {f"{name}_{unit}": float(value) for name, value in statistics.items()}
    return found


def find_scale_m(table: ExampleTable) -> float:
    """Return the mean ADD of a random pose of the grid, metres, by which the paper divides errors."""
    return float(table.errors_m("random", "add").mean())


def normalise_errors(run: ExampleTable, line: str) -> Floats:
    """Return the ADD (E,) of a line divided by the mean ADD of a random pose, unitless."""
    return run.errors_m(line, "add") / find_scale_m(run)


def summarise_lines(table: ExampleTable, lines: Sequence[str]) -> list[dict[str, Any]]:
    """Return a row of statistics of the ADD for each object, encoder, line and number of contacts."""
    rows = []
    for (name, encoder), run in table.group("object", "encoder").items():
        by_contacts = run.group("touches")
        for line, (contacts,) in itertools.product(lines, by_contacts):
            some = by_contacts[contacts,]
            statistics = summarise_errors(some.errors_m(line, "add"), find_scale_m(run))
            about = {"object": name, "encoder": encoder, "line": line, "contacts": contacts}
            alone = some.columns.get(f"{line} alone")
            rows.append(about | statistics | {"without_common": 0 if alone is None else int(alone.sum())})
    return rows


def measure_coverage(table: ExampleTable) -> list[float]:
    """Return, for each of LEVELS, the share of touches whose true pose is in the credible set of this level."""
    return [float((table["credible_level"] <= sure).mean()) for sure in LEVELS]


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
class ExampleSummary:
    """Summary of E examples that are located from the same number of touches. Shares are 0 to 1, lengths in metres.

    `within` and `listed_within` are the recalls of the first pose, and of any listed pose, at WITHIN_M. `auc`, the area
    under the recall curve, is the mean recall at CURVE_M. `average_recall_mssd` is the mean recall at DIAMETER_SHARES
    of the diameter. `shape_within_1_mm` is the recall of the shape distance at 1 mm. `verdicts` counts the examples
    with each verdict. `certain_right` is the share of certain examples with a right first pose, and
    `certain_right_range` its 95 % confidence interval (Wilson). `determined_right` and `determined_certain` are the
    shares of the determined examples with a right first pose, and with the verdict certain. Values of no examples are
    None.
    """

    examples: int
    within: tuple[float, ...]
    listed_within: tuple[float, ...]
    auc: float
    listed_auc: float
    average_recall_mssd: float
    listed_average_recall_mssd: float
    shape_within_1_mm: float
    listed_shape_within_1_mm: float
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
    def of(cls, table: ExampleTable, within_m: Sequence[float] = WITHIN_M) -> ExampleSummary:
        """Summarise at least one example. `within_m`, metres, are the thresholds of the recalls."""
        certain, right, determined = table["verdict"] == Verdict.CERTAIN.value, find_right(table), table["determined"]
        timed = table["seconds"][np.isfinite(table["seconds"])]
        counts = Counter(table["verdict"].tolist())
        within, listed_within, curve, listed_curve = (
            measure_recall(table, thresholds_m, line)
            for thresholds_m in (within_m, CURVE_M)
            for line in ("first", "listed")
        )
        return cls(
            examples=len(table),
            within=tuple(within.tolist()),
            listed_within=tuple(listed_within.tolist()),
            auc=float(curve.mean()),
            listed_auc=float(listed_curve.mean()),
            average_recall_mssd=average_mssd_recall(table, "first"),
            listed_average_recall_mssd=average_mssd_recall(table, "listed"),
            shape_within_1_mm=float(measure_recall(table, [1e-3], "first", "shape")[0]),
            listed_shape_within_1_mm=float(measure_recall(table, [1e-3], "listed", "shape")[0]),
            median_m=find_median(table.errors_m()),
            determined=int(determined.sum()),
            determined_right=_average(right[determined]),
            determined_certain=_average(certain[determined]),
            verdicts={verdict: counts[verdict] for verdict in VERDICTS},
            certain_right=_average(right[certain]),
            certain_right_range=compute_wilson_range(int(right[certain].sum()), int(certain.sum())),
            bins=bin_probabilities(table),
            median_s=find_median(timed),
            p90_s=float(np.quantile(timed, 0.9)) if len(timed) else None,
        )


def find_right(table: ExampleTable) -> Bools:
    """Return whether the first pose of each example (E,) is right: its pose error is at most RIGHT_M."""
    return np.asarray(table.errors_m() <= RIGHT_M)


def measure_recall(table: ExampleTable, thresholds_m: ArrayLike, line: str = "first", metric: str = "mssd") -> Floats:
    """Return the recall (T,), 0 to 1, of a line's poses at thresholds (T,), metres, of a metric, the pose error."""
    return np.asarray((table.errors_m(line, metric)[:, None] <= np.asarray(thresholds_m)).mean(axis=0))


def average_mssd_recall(table: ExampleTable, line: str = "first") -> float:
    """Return the mean recall over the thresholds DIAMETER_SHARES of each object's diameter, 0 to 1."""
    relative = table.errors_m(line) / table["diameter_m"]
    return float((relative[:, None] < np.asarray(DIAMETER_SHARES)).mean())


def bin_probabilities(table: ExampleTable) -> tuple[ProbabilityBin, ...]:
    """Return the reliability of the first pose's probability, in PROBABILITY_BINS."""
    located = np.isfinite(table["probability"])
    p, right = table["probability"][located], find_right(table)[located]
    which = np.clip(np.digitize(p, PROBABILITY_BINS) - 1, 0, len(PROBABILITY_BINS) - 2)
    return tuple(
        ProbabilityBin(low, high, int((which == k).sum()), _average(p[which == k]), _average(right[which == k]))
        for k, (low, high) in enumerate(itertools.pairwise(PROBABILITY_BINS))
    )


def compute_wilson_range(successes: int, trials: int) -> tuple[float, float] | None:
    """Return the 95 % confidence interval of a share, 0 to 1, by Wilson's score (1927); None without trials."""
    from scipy.stats import binomtest

    if not trials:
        return None
    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def find_median(values: Floats) -> float | None:
    """Return the median of values; None if it is not finite, or without values."""
    median = float(np.median(values)) if len(values) else np.inf
    return median if np.isfinite(median) else None


def _average(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if len(values) else None
