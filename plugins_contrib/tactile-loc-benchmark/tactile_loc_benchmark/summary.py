"""Summaries of a benchmark's rows, with bootstrap intervals: one for each source, method and number of touches."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import ExampleSummary, ExampleTable, Verdict

from tactile_loc_benchmark.job import METRICS, RIGHT_M, Row

WITHIN_M = (0.5e-3, 1e-3, 2e-3, 5e-3)
RESAMPLED, RANGE = 1000, (2.5, 97.5)  # number of bootstrap samples; percentiles of the interval
SEED = 0

Float64 = NDArray[np.float64]
Interval = tuple[float, float]


def summarise(rows: Sequence[Row]) -> list[Row]:
    """Return a row of JSON values for each source, method and number of touches, in the order of the rows.

    Shares are 0 to 1, lengths in metres. `within` and `listed_within` are the shares of examples whose first pose, or
    any listed pose, has a pose error of at most WITHIN_M. `within_range` has their 95 % intervals: examples of each
    object are drawn with replacement. `auc` is the mean share at CURVE_M, and `average_recall_mssd` that at BOP's
    shares of the diameter. `shape_within_1_mm` is the share of first poses with a shape distance of at most 1 mm.
    `median_determined_m` is over the examples whose touches determine the pose. `certain` is the number of examples
    called certain, `certain_right` the number of these whose first pose is right. `calibration_error` is the mean
    difference of stated probability and share of right poses, weighted by the examples in bins. `covered` is the share
    of examples in which the poses with 95 % of the probability include a right one. Values that a method does not state
    are None. `refused` is the number of presses that the sensor refused, and `unlocated` that of examples without pose.
    """
    groups = group_examples(rows).items()
    return [
        {"source": source, "method": method, "touches": touches, **_summarise(table)}
        for (source, method, touches), table in groups
    ]


def group_examples(rows: Sequence[Row]) -> dict[tuple[Any, ...], ExampleTable]:
    """Return the examples of each source, method and number of touches, in the order of the rows.

    The table's column `encoder` is the method, and `noise` the source. Touches do not determine the pose if any method
    lists a wrong pose that explains them as well as the true pose.
    """
    if not rows:
        return {}
    errors = {f"first {m}_m": f"{m}_mm" for m in METRICS} | {f"listed {m}_m": f"listed_{m}_mm" for m in METRICS}
    ambiguous = {_name_example(row) for row in rows if not row.get("determined", True)}
    table = ExampleTable.of_rows(
        [
            {
                **{name: 1e-3 * row.get(measured, np.inf) for name, measured in errors.items()},
                **{name: row.get(name) for name in ("probability", "covered", "seconds", "diameter_m")},
                **{name: row.get(name, "") for name in ("verdict", "problem")},
                **{name: row[name] for name in ("object", "example", "touches", "refused")},
                "encoder": row["method"],
                "noise": row["source"],
                "seed": -1,
                "determined": _name_example(row) not in ambiguous,
            }
            for row in rows
        ]
    )
    return table.group("noise", "encoder", "touches")


def _name_example(row: Row) -> tuple[str, str, int, int]:
    return row["source"], row["object"], row["example"], row["touches"]


def _summarise(table: ExampleTable) -> Row:
    summary, errors_m = ExampleSummary.of(table, WITHIN_M), table.errors_m()
    inside = (errors_m[:, None] <= np.array(WITHIN_M)).astype(float)
    certain, covered = table["verdict"] == Verdict.CERTAIN.value, table["covered"].astype(float)
    determined_m = float(np.median(errors_m[table["determined"]])) if summary.determined else np.inf
    return {
        "examples": summary.examples,
        "within": summary.within,
        "within_range": bootstrap(inside, table["object"], lambda some: some.mean(axis=0)),
        "listed_within": summary.listed_within,
        "auc": summary.auc,
        "average_recall_mssd": summary.average_recall_mssd,
        "shape_within_1_mm": summary.shape_within_1_mm,
        "median_m": summary.median_m,
        "determined": summary.determined,
        "determined_within_1_mm": summary.determined_right,
        "median_determined_m": determined_m if np.isfinite(determined_m) else None,
        "calibration_error": measure_calibration_error(summary),
        "covered": float(np.nanmean(covered)) if np.isfinite(covered).any() else None,
        "certain": int(certain.sum()),
        "certain_right": int((certain & (errors_m <= RIGHT_M)).sum()),
        "refused": table.count_refused(),
        "unlocated": int((table["problem"] != "").sum()),
        "median_s": summary.median_s,
    }


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
