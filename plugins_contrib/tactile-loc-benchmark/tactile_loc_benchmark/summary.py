"""Summaries of a benchmark's rows, with bootstrap intervals: one for each source, method and number of touches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc.evaluation.metrics import METRICS
from tactile_loc.evaluation.summary import ExampleSummary, find_median, find_right
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.evaluation.text_tables import format_share
from tactile_loc.locate.result.verdict import Verdict

from tactile_loc_benchmark.job import Row

WITHIN_M = (0.5e-3, 1e-3, 2e-3, 5e-3)
RESAMPLED, RANGE = 1000, (2.5, 97.5)  # number of bootstrap samples; percentiles of the interval
SEED = 0

Float64 = NDArray[np.float64]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Group:
    """The results of one method with touches of one source: E examples of several objects.

    Shares are 0 to 1, lengths in metres. `within` and `listed_within` are the shares of examples whose first pose, or
    any listed pose, has a surface distance below WITHIN_M. `within_range` has their 95 % intervals: examples of each
    object are drawn with replacement. `auc` is the mean share at CURVE_M, and `average_recall_mssd` that of BOP's MSSD.
    `median_determined_m` is over the examples whose touches determine the pose. `certain` is the number of examples
    called certain, `certain_right` the number of these whose first pose is right. `calibration_error` is the mean
    difference of stated probability and share of right poses, weighted by the examples in bins. `covered` is the share
    of examples in which the poses with 95 % of the probability include a right one. Values that a method does not state
    are None. `refused` is the number of presses that the sensor refused, and `unlocated` that of examples without pose.
    """

    source: str
    method: str
    touches: int
    examples: int
    within: tuple[float, ...]
    within_range: tuple[Interval, ...]
    listed_within: tuple[float, ...]
    auc: float
    average_recall_mssd: float
    median_m: float | None
    determined: int
    determined_within_1_mm: float | None
    median_determined_m: float | None
    calibration_error: float | None
    covered: float | None
    certain: int
    certain_right: int
    refused: int
    unlocated: int
    median_s: float | None

    def describe(self) -> dict[str, Any]:
        """Return all values as JSON values."""
        return asdict(self)

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Group:
        """Return the group of `describe`. Raises TypeError if values are missing or unknown."""
        known = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        return cls(**known | {"within_range": tuple(map(tuple, values.get("within_range", ())))})


def summarise(rows: Sequence[Row]) -> list[Group]:
    """Return the group of each source, method and number of touches, in the order of the rows."""
    determined = find_determined(rows)
    return [_summarise(*key, some, determined) for key, some in group_rows(rows).items()]


def group_rows(rows: Iterable[Row]) -> dict[tuple[str, str, int], list[Row]]:
    """Return the rows of each source, method and number of touches, in the order of the rows."""
    found: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        found.setdefault((row["source"], row["method"], row["touches"]), []).append(row)
    return found


def format_within(group: Group, number: int) -> str:
    """Return the share within WITHIN_M[number] with its interval, in %."""
    low, high = group.within_range[number]
    return f"{format_share(group.within[number])} ({100 * low:.0f} to {100 * high:.0f})"


def find_determined(rows: Iterable[Row]) -> dict[tuple[str, str, int, int], bool]:
    """Return whether touches determine the pose, by source, object, example and number of touches.

    They do not if any method lists a wrong pose that explains them as well as the true pose.
    """
    found: dict[tuple[str, str, int, int], bool] = {}
    for row in rows:
        key = name_example(row)
        found[key] = found.get(key, True) and bool(row.get("determined", True))
    return found


def name_example(row: Row) -> tuple[str, str, int, int]:
    """Return the key of a row's example: source, object, example and number of touches."""
    return row["source"], row["object"], row["example"], row["touches"]


def make_examples(rows: Sequence[Row], determined: dict[tuple[str, str, int, int], bool]) -> ExampleTable:
    """Return rows of one group as a table of examples: `encoder` is the method, and `noise` the source."""
    errors = {
        f"{line} {metric}_m": f"{prefix}{metric}_mm"
        for line, prefix in (("first", ""), ("listed", "listed_"))
        for metric in METRICS
    }
    return ExampleTable.of_rows(
        [
            {
                **{name: 1e-3 * row.get(measured, np.inf) for name, measured in errors.items()},
                **{name: row.get(name) for name in ("probability", "seconds", "diameter_m")},
                **{name: row.get(name, "") for name in ("verdict", "problem")},
                **{name: row[name] for name in ("object", "example", "touches", "refused")},
                "encoder": row["method"],
                "noise": row["source"],
                "seed": -1,
                "determined": determined[name_example(row)],
            }
            for row in rows
        ]
    )


def _summarise(
    source: str, method: str, touches: int, rows: Sequence[Row], determined: dict[tuple[str, str, int, int], bool]
) -> Group:
    found = make_examples(rows, determined)
    summary, right = ExampleSummary.of(found, WITHIN_M), find_right(found)
    inside = (found.errors_m()[:, None] < np.array(WITHIN_M)).astype(float)
    certain = found["verdict"] == Verdict.CERTAIN.value
    covered = [row["covered"] for row in rows if row.get("covered") is not None]
    return Group(
        source,
        method,
        touches,
        summary.examples,
        summary.within,
        bootstrap(inside, found["object"], lambda some: some.mean(axis=0)),
        summary.listed_within,
        summary.auc,
        summary.average_recall_mssd,
        summary.median_m,
        summary.determined,
        summary.determined_right,
        find_median(found.errors_m()[found["determined"]]),
        measure_calibration_error(summary),
        float(np.mean(covered)) if covered else None,
        int(certain.sum()),
        int((certain & right).sum()),
        found.count_refused(),
        int((found["problem"] != "").sum()),
        summary.median_s,
    )


def bootstrap(values: Float64, objects: NDArray[Any], statistic: Callable[[Float64], Float64]) -> tuple[Interval, ...]:
    """Return the 95 % intervals of a statistic (S,) of values (E, S): examples of each object are drawn again.

    The percentile method (Efron, 1979) with RESAMPLED samples; the same seed gives the same interval.
    """
    rng = np.random.default_rng(SEED)
    members = [np.flatnonzero(objects == name) for name in dict.fromkeys(objects.tolist())]
    samples = [
        statistic(values[np.concatenate([rng.choice(some, len(some)) for some in members])]) for _ in range(RESAMPLED)
    ]
    low, high = np.percentile(samples, RANGE, axis=0)
    return tuple(zip(low.tolist(), high.tolist(), strict=True))


def measure_calibration_error(summary: ExampleSummary) -> float | None:
    """Return the expected calibration error, 0 to 1 (Naeini et al., AAAI 2015), of the first pose's probability.

    It is None if no probability is stated.
    """
    bins = [one for one in summary.bins if one.examples]
    total = sum(one.examples for one in bins)
    return sum(one.examples * abs((one.stated or 0.0) - (one.right or 0.0)) for one in bins) / total if total else None
