"""A figure of the comparison: success rates with intervals, and peak forces."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from experiment import Record
from insertion import STOP_N
from methods import METHODS
from records import compute_interval

COLOURS = {"known": "0.45", "first touch": "C1", "verdict": "C2", "spiral": "C0", "nominal": "C3"}


def draw_comparison(records: Sequence[Record], path: Path) -> None:
    """Draw the success rates with their 95 % intervals, and the peak force of each trial."""
    figure, (rates, forces) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    names = [name for name in METHODS if any(record.method == name for record in records)]
    spread = np.random.default_rng(0)
    for k, name in enumerate(names):
        some = [record for record in records if record.method == name]
        won = sum(record.success for record in some)
        share, (low, high) = won / len(some), compute_interval(won, len(some))
        rates.bar(k, 100 * share, color=COLOURS[name], width=0.65)
        rates.errorbar(k, 100 * share, [[100 * (share - low)], [100 * (high - share)]], color="0.1", capsize=4)
        rates.text(k, 100 * high + 2, f"{won} of {len(some)}", ha="center", fontsize=8)
        for success, marker in ((True, "o"), (False, "x")):
            these = [record.peak_force_n for record in some if record.success == success]
            forces.scatter(
                k + spread.uniform(-0.22, 0.22, len(these)), these, s=16, marker=marker, color=COLOURS[name], lw=1
            )
    forces.axhline(STOP_N, color="0.4", ls="--", lw=1)
    forces.annotate("the arm stops", (-0.4, STOP_N + 0.8), fontsize=8, color="0.3")
    rates.set(ylabel="inserted, %", ylim=(0, 110), xticks=range(len(names)))
    forces.set(ylabel="peak force, N (cross: not inserted)", xticks=range(len(names)))
    for axes in (rates, forces):
        axes.set_xticklabels(names)
        axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
