#!/usr/bin/env python3
"""How often verdicts and stated probabilities are right, on parts that no fit has seen.

`outcomes.py draw` draws and locates the examples. Their evidence is judged by the shipped model. A result is right if
no point of the object is more than 1 mm away. The tables show the results by group, the stated probabilities beside
the shares that are right, and the parts. `--picture` writes them as a picture.

The plain gap rule calls a result certain if no listed pose that is more than 1 mm away has an imprint IoU within a gap
of the first one's. In each row, the gap is chosen for 2 % of wrong answers among the same results, so the rule knows
more than a verdict can. The interval of the difference is that of redrawn parts, with the same gap. A touch determines
a pose if the search of `determined.py` finds no other pose that fits.
"""

import argparse
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from asked import write_head
from numpy.typing import NDArray

from tactile_loc.locate.probability.evidence import TIE_IOU
from tactile_loc.locate.probability.outcome_model import LEAST, load_outcome_model, settle
from tactile_loc.locate.result.verdict import Outcome, judge

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
Row = dict[str, Any]
Range = tuple[float, float, float, float, int]

GROUPS = ("touches", "noise", "gel", "sensor", "kind", "mistake")
EDGES = (0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0001)
COARSE = (0, 0.2, 0.5, 0.8, 0.95, 1.0001)  # for the groups
GAPS = np.linspace(0.005, 0.5, 100)
MOST_WRONG = 0.02  # of the answers of the gap rule
DRAWS = 2000  # of parts, for intervals


def read_rows(folder: Path) -> list[Row]:
    """Return the rows of all parts in a folder, without those that were refused."""
    rows = [row for path in sorted(folder.glob("*.json")) for row in json.loads(path.read_text())]
    arrays = ("values", "fits", "near", "errors_m", "ious", "outcomes")
    return [row | {name: np.array(row[name]) for name in arrays} for row in rows if "error" not in row]


def judge_rows(rows: Sequence[Row]) -> None:
    """Set the probability and the verdict of rows at 1 mm to those of the shipped model."""
    model = load_outcome_model()
    for row in rows:
        outcome = settle_row(row, model.trees.predict(row["values"][0]))
        poor = bool((model.measure_excess(SimpleNamespace(fits=row["fits"])) > 0).any())  # type: ignore[arg-type]
        row["right"], row["verdict"] = outcome.right, str(judge(outcome, poor=poor))


def settle_row(row: Row, p: Float64) -> Outcome:
    """Return the outcome of a row with the probabilities (3,) of the trees, as `OutcomeModel.predict` does."""
    right, another, missed = np.clip(p, LEAST, 1 - LEAST).tolist()
    ties = int((~row["near"] & (row["ious"] > row["ious"][0] - TIE_IOU)).sum())
    return settle(right, another, missed, row["near"], ties)


def list_groups(rows: Sequence[Row]) -> Iterator[tuple[str, Bools]]:
    """Yield the names of groups of R rows, and their masks (R,)."""
    yield "all", np.ones(len(rows), bool)
    for key in GROUPS:
        values = [row.get(key) for row in rows]
        for value in sorted(set(values), key=str):
            if len(set(values)) > 1:
                yield f"{key} {value}", np.array([one == value for one in values])


def find_first_right(rows: Sequence[Row]) -> Bools:
    """Return whether the first pose of each of R rows is right, (R,)."""
    return np.array([row["outcomes"][0] == 0 for row in rows])


def apply_gap_rule(gaps: Float64, right: Bools) -> Bools:
    """Return which rows (R,) the gap rule calls certain: as many as possible with at most MOST_WRONG wrong ones."""
    rules = [gaps > least for least in GAPS]
    fair = [rule for rule in rules if rule.any() and (~right[rule]).mean() <= MOST_WRONG]
    return max(fair, key=lambda rule: int((rule & right).sum()), default=np.zeros(len(right), bool))


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    print(f"\n{write_head(*columns)}")
    for cells in rows:
        print(f"| {' | '.join(cells)} |")


def print_verdicts(rows: Sequence[Row]) -> None:
    """Print how often certain is right, by group, and how often a probability is."""
    right, certain = find_first_right(rows), np.array([row["verdict"] == "certain" for row in rows])
    gaps = np.array([row["iou_gap"] for row in rows])
    columns = "results", "number", "first right", "certain", "wrong of these", "right by the gap rule", "right by ours"
    part, times = redraw_parts(rows)
    lines = []
    for name, some in list_groups(rows):
        sure, wrong = certain & some, int((certain & some & ~right).sum())
        ruled = apply_gap_rule(gaps[some], right[some]) & right[some]
        share = f"{wrong} of {sure.sum()} ({wrong / max(1, sure.sum()):.1%})"
        shares = right[some].mean(), certain[some].mean(), ruled.mean(), (sure & right)[some].mean()
        first, stated, by_rule, ours = map("{:.1%}".format, shares)
        more = np.bincount(part[some], (sure & right)[some] * 1.0 - ruled, times.shape[1])
        number = times @ np.bincount(part[some], minlength=times.shape[1])
        low, high = np.quantile(100 * (times @ more)[number > 0] / number[number > 0], (0.025, 0.975))
        apart = f"{100 * (shares[3] - shares[2]):+.1f} ({low:+.1f} to {high:+.1f})"
        lines.append([name, str(some.sum()), first, stated, share, by_rule, ours, apart])
    print_table((*columns, "ours less the rule, points"), lines)
    print_determined(rows)
    poor = np.array([row["verdict"] == "poor fit" for row in rows])
    print(f"\npoor fits among right first poses: {poor[right].mean():.1%}; among wrong ones: {poor[~right].mean():.1%}")
    print_reliability(rows, EDGES, {"all": np.ones(len(rows), bool)})
    print_reliability(rows, COARSE, dict(list_groups(rows)))
    print_parts(rows, certain, right)


def print_determined(rows: Sequence[Row]) -> None:
    """Print how many of the determined examples are certain, if they were searched for."""
    searched = [row for row in rows if row.get("rival_m") is not None]
    lines = []
    for count in sorted({row["touches"] for row in searched}):
        some = [row for row in searched if row["touches"] == count]
        determined = np.array([row["rival_m"] == 0 for row in some])
        certain = np.array([row["verdict"] == "certain" for row in some])
        right = find_first_right(some)
        shares = (right[determined], certain[determined], certain[~determined])
        share, sure, others = (f"{one.mean():.1%}" if len(one) else "" for one in shares)
        lines.append([str(count), str(len(some)), str(determined.sum()), share, sure, others])
    if lines:
        columns = "touches", "searched", "determined", "first right of these", "certain of these", "of the others"
        print_table(columns, lines)


def print_reliability(rows: Sequence[Row], edges: Sequence[float], groups: Mapping[str, Bools]) -> None:
    """Print the stated probabilities between edges beside the shares that are right, for groups of rows."""
    lines = []
    for name, some in groups.items():
        chosen = [row for row, one in zip(rows, some, strict=True) if one]
        for stated, share, low, high, count in measure_reliability(chosen, edges):
            lines.append([name, f"{stated:.1%}", f"{share:.1%}", f"{low:.0%} to {high:.0%}", str(count)])
    print_table(("results", "stated", "right", "95 % interval", "number"), lines)


def measure_reliability(rows: Sequence[Row], edges: Sequence[float]) -> Iterator[Range]:
    """Yield for each range of probabilities the mean, the share that is right, its 95 % interval, and the number.

    The intervals are of redrawn parts.
    """
    p, right = np.array([row["right"] for row in rows]), find_first_right(rows)
    part, times = redraw_parts(rows)
    for low, high in itertools.pairwise(edges):
        some = (p >= low) & (p < high)
        if not some.any():
            continue
        all_of, right_of = (np.bincount(part[mask], minlength=times.shape[1]) for mask in (some, some & right))
        shares = (times @ right_of) / np.maximum(times @ all_of, 1)
        interval = np.quantile(shares[times @ all_of > 0], (0.025, 0.975))
        yield float(p[some].mean()), float(right[some].mean()), *map(float, interval), int(some.sum())


def redraw_parts(rows: Sequence[Row]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of the part of each of R rows, (R,), and how often each of P parts is in each draw, (D, P)."""
    names, part = np.unique([row["part"] for row in rows], return_inverse=True)
    return part, np.random.default_rng(0).multinomial(len(names), np.full(len(names), 1 / len(names)), DRAWS)


def print_parts(rows: Sequence[Row], certain: Bools, right: Bools) -> None:
    """Print how many certain answers of each part are wrong."""
    lines = []
    for name in sorted({row["part"] for row in rows}):
        some = np.array([row["part"] == name for row in rows])
        wrong, sure = int((some & certain & ~right).sum()), int((some & certain).sum())
        kind = next(row.get("kind", "") for row in rows if row["part"] == name)
        lines.append([name, kind, str(some.sum()), f"{right[some].mean():.0%}", str(sure), str(wrong)])
    print_table(("part", "kind", "results", "first right", "certain", "wrong of these"), lines)


def draw_picture(rows: Sequence[Row], path: Path) -> None:
    """Draw the stated probabilities beside the shares that are right, and the answers by number of touches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    left, axes = figure.subplots(1, 2)
    stated, share, low, high, counts = np.array(list(measure_reliability(rows, EDGES))).T
    left.plot([0, 100], [0, 100], color="0.6", linewidth=1)
    spread = 100 * np.stack([share - low, high - share]).clip(0)
    left.errorbar(100 * stated, 100 * share, spread, fmt="none", color="#0072b2", linewidth=1)
    left.scatter(100 * stated, 100 * share, 10 + 0.4 * counts, color="#0072b2", zorder=3)
    left.set(xlabel="stated probability, %", ylabel="first poses that are right, %", xlim=(0, 101), ylim=(0, 101))
    left.set_title("Probability within 1 mm (95 % intervals by part)", fontsize=10)
    right, certain = find_first_right(rows), np.array([row["verdict"] == "certain" for row in rows])
    touches = np.array([row["touches"] for row in rows])
    numbers = sorted(set(touches.tolist()))
    series = (
        ("first pose right", [right[touches == n].mean() for n in numbers], "#bbbbbb"),
        ("certain and right", [(right & certain)[touches == n].mean() for n in numbers], "#009e73"),
        ("certain and wrong", [(~right & certain)[touches == n].mean() for n in numbers], "#d55e00"),
    )
    for k, (label, values, colour) in enumerate(series):
        places = np.arange(len(numbers)) + 0.28 * (k - 1)
        bars = axes.bar(places, 100 * np.array(values), 0.28, label=label, color=colour)
        axes.bar_label(bars, fmt="%.0f", fontsize=8)
    axes.set_xticks(range(len(numbers)), [str(n) for n in numbers])
    axes.set(xlabel="touches", ylabel="results, %", ylim=(0, 100))
    axes.set_title(f"Answers ({len({row['part'] for row in rows})} parts, {len(rows)} results)", fontsize=10)
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    for one in (left, axes):
        one.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def main() -> None:
    """Judge the rows of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="written by `outcomes.py draw`")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    rows = read_rows(arguments.folder)
    judge_rows(rows)
    print_verdicts(rows)
    if arguments.picture:
        draw_picture(rows, arguments.picture)


if __name__ == "__main__":
    main()
