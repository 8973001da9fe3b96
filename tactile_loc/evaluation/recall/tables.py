"""The results of the evaluation of what `run` answers, as tables, and as JSON in SI units."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from tactile_loc.core.poses.pose_errors import RIGHT_M
from tactile_loc.evaluation.recall.evaluation import RECALL_VERSION
from tactile_loc.evaluation.summary import CURVE_M, DIAMETER_SHARES, WITHIN_M, ExampleSummary
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable, join_runs
from tactile_loc.evaluation.text_tables import (
    EvaluationResults,
    NotedTable,
    Row,
    Table,
    build_document,
    format_length,
    format_share,
    tabulate,
)

SCHEMA_VERSION = 3
ALL = "all"
GROUP = ("object", "encoder", "noise", "touches")
RECALL_TITLE = "share of examples within a pose error: first pose (any listed pose)"
RECALL_NOTE = (
    "Errors are pose errors: the largest displacement of a surface point between the located and the true pose. The "
    "shares are of examples whose first pose (any listed pose) is within the error. Examples without a pose count as "
    "missed. AUC: area under the recall curve, the mean of these shares at 0.1, 0.2, ... 5 mm. AR MSSD: the mean at 5, "
    "10, ... 50 % of the object's diameter, as in BOP. Shape: the shape distance is at most 1 mm. It is the mean "
    "distance of the located surface from the true surface, which forgives a turned shaft. s: median time."
)
VERDICT_NOTE = (
    "Number of examples with each verdict. Right: share of the certain examples whose first pose is within 1 mm, with "
    "its 95 % confidence interval. Determined: examples in which no listed wrong pose explains the touches as well as "
    "the true pose; share of them that are certain."
)
BIN_NOTE = (
    "Probability of the first pose: its mean, the share of first poses within 1 mm, and the number of examples, for "
    "examples whose probability is in the range of the column."
)


def group_answers(table: ExampleTable) -> dict[tuple[Any, ...], ExampleTable]:
    """Return the examples of each GROUP; then those of ALL objects, if there are several."""
    groups = table.group(*GROUP)
    if len(set(table["object"].tolist())) > 1:
        groups |= {(ALL, *key): some for key, some in table.group(*GROUP[1:]).items()}
    return groups


def summarise_answers(table: ExampleTable) -> list[Row]:
    """Return a row for each group of `group_answers`: the GROUP, and the fields of its ExampleSummary."""
    groups = group_answers(table).items()
    return [{**dict(zip(GROUP, key, strict=True)), **asdict(ExampleSummary.of(some))} for key, some in groups]


def _name_group(row: Row) -> dict[str, str]:
    return {name: str(row[name]) for name in GROUP}


def tabulate_recall(rows: Sequence[Row]) -> Table:
    """Return a row for each group: shares of first and listed poses within WITHIN_M, averages, median in mm, time."""
    found = []
    for row in rows:
        pairs = dict(zip(WITHIN_M, zip(row["within"], row["listed_within"], strict=True), strict=True))
        shares = {f"{1e3 * within_m:g} mm": pair for within_m, pair in pairs.items()}
        averages = {"AUC": "auc", "AR MSSD": "average_recall_mssd", "shape, 1 mm": "shape_within_1_mm"}
        for head, name in averages.items():
            shares[head] = row[name], row[f"listed_{name}"]
        found.append(
            {
                **_name_group(row),
                "examples": str(row["examples"]),
                **{head: f"{format_share(first)} ({format_share(listed)})" for head, (first, listed) in shares.items()},
                "median, mm": format_length(row["median_m"]),
                "s": "-" if row["median_s"] is None else f"{row['median_s']:.2f}",
            }
        )
    return tabulate(found)


def tabulate_verdicts(rows: Sequence[Row]) -> Table:
    """Return a row for each group: the number of examples with each verdict, and the verdicts' reliability."""
    return tabulate(
        {
            **_name_group(row),
            **{verdict: str(count) for verdict, count in row["verdicts"].items()},
            "certain: right": _format_right(row),
            "determined": str(row["determined"]),
            "of these certain": format_share(row["determined_certain"]),
        }
        for row in rows
    )


def _format_right(row: Row) -> str:
    if row["certain_right"] is None:
        return "-"
    low, high = row["certain_right_range"]
    return f"{format_share(row['certain_right'])} ({100 * low:.0f} to {100 * high:.0f})"


def tabulate_bins(rows: Sequence[Row]) -> Table:
    """Return a row for each group: for each bin of probabilities, the stated and the right share, and the number."""
    return tabulate(
        {
            **_name_group(row),
            **{f"{100 * one['low']:.0f} to {100 * one['high']:.0f} %": _format_bin(one) for one in row["bins"]},
        }
        for row in rows
    )


def _format_bin(one: Row) -> str:
    shown = f"{format_share(one['stated'])}, {format_share(one['right'])} ({one['examples']})"
    return shown if one["examples"] else "-"


def name_noise(noise: str) -> str:
    """Return the words for a noise: "no noise", "mild noise", or the kind of touches that are not simulated."""
    return {"none": "no noise", "mild": "mild noise", "strong": "strong noise"}.get(noise, noise)


def list_problems(table: ExampleTable) -> list[tuple[str, int]]:
    """Return the reasons why examples have no pose, each with its number of results, the most frequent first."""
    return Counter(problem for problem in table["problem"].tolist() if problem).most_common()


def collect_answers(runs: Sequence[EvaluatedRun], protocol: Mapping[str, Any], heading: str) -> EvaluationResults:
    """Return all results, called "recall"; `protocol` states the examples, noises and seeds."""
    table = join_runs(runs)
    rows = summarise_answers(table)
    asked = {
        "version": RECALL_VERSION,
        "together": np.unique(table["touches"]).tolist(),
        "right_m": RIGHT_M,
        "within_m": list(WITHIN_M),
        "thresholds_m": [round(m, 9) for m in CURVE_M],
        "diameter_shares": [round(share, 9) for share in DIAMETER_SHARES],
        **protocol,
    }
    described = [run.describe() for run in runs]
    document = build_document(SCHEMA_VERSION, protocol=asked, runs=described, summary=rows, examples=table.describe())
    tables = [
        NotedTable(RECALL_TITLE, RECALL_NOTE, tabulate_recall(rows)),
        NotedTable("verdicts; certain: share within 1 mm (95 % interval)", VERDICT_NOTE, tabulate_verdicts(rows)),
        NotedTable("probability of the first pose: mean, share within 1 mm (examples)", BIN_NOTE, tabulate_bins(rows)),
    ]
    details = [f"Presses without a usable touch, which do not count: {table.count_refused()}"]
    if problems := list_problems(table):
        details += ["Examples without a pose:", "\n".join(f"- {count}: {problem}" for problem, count in problems)]
    return EvaluationResults("recall", heading, document, list(map(_list_columns, rows)), tables, details)


def _list_columns(row: Row) -> Row:
    """Return the columns of the CSV: shares as 0 to 1, times in seconds."""
    within = {
        f"{name}_{1e3 * m:g}_mm": share
        for name in ("within", "listed_within")
        for m, share in zip(WITHIN_M, row[name], strict=True)
    }
    averages = ("auc", "average_recall_mssd", "shape_within_1_mm")
    last = ("certain_right", "determined", "determined_right", "determined_certain", "median_s", "p90_s")
    return {
        **{name: row[name] for name in (*GROUP, "examples")},
        **within,
        **{name: row[name] for average in averages for name in (average, f"listed_{average}")},
        "median_m": row["median_m"],
        **{verdict.replace(" ", "_"): count for verdict, count in row["verdicts"].items()},
        **{name: row[name] for name in last},
    }
