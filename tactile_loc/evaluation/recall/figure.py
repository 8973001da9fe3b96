"""The figure of an evaluation of what `run` answers: recall curves, and the reliability of the probabilities."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_loc.evaluation.figures import COLOURS, draw_grid
from tactile_loc.evaluation.recall.summary import WITHIN_M, Outcomes, RecallRun, bin_probabilities
from tactile_loc.evaluation.recall.tables import ALL, Group, group_runs, name_noise
from tactile_loc.view.pictures import make_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORTEST_MM, LONGEST_MM = 0.02, 50.0  # range of the thresholds
TICKS_MM = (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (5, 2, 1, 2)))
FEW = 5  # bins with fewer examples are not drawn


def draw_recall(runs: Sequence[RecallRun], title: str) -> Figure:
    """Draw the recall of the first pose against the threshold, and the reliability of its probability, in two panels.

    The panels show all objects together. The colour is the number of touches, the line style the noise. A thin line is
    the recall of any listed pose. Bins with fewer than FEW examples are left out.
    """
    groups = _join_objects(runs)
    figure = make_figure(11.5, 5.6, constrained=True)
    figure.suptitle(textwrap.fill(title, 100), size=13, weight="bold")
    recall, reliability = figure.subplots(1, 2, width_ratios=[1.25, 1])
    colours = dict(zip(dict.fromkeys(g.touches for g in groups), itertools.cycle(COLOURS), strict=False))
    styles = dict(zip(dict.fromkeys((g.encoder, g.noise) for g in groups), itertools.cycle(DASHES), strict=False))
    for group in groups:
        _draw_curves(recall, group, colours[group.touches], styles[group.encoder, group.noise])
    for number, (touches, colour) in enumerate(colours.items()):
        joined = Outcomes.join(g.outcomes for g in groups if g.touches == touches)
        _draw_reliability(reliability, joined, colour, -10 * (number + 1))
    _label_recall(recall)
    _label_reliability(reliability)
    handles, labels = recall.get_legend_handles_labels()
    columns = min(4, max(2, len(styles)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    return figure


def _join_objects(runs: Sequence[RecallRun]) -> list[Group]:
    """Return a group of all objects for each encoder, noise and number of touches."""
    groups = group_runs(runs)
    several = len({run.object for run in runs}) > 1
    return [group for group in groups if not several or group.object == ALL]


def _draw_curves(axes: Axes, group: Group, colour: str, dash: Any) -> None:
    thresholds_mm = np.geomspace(SHORTEST_MM, LONGEST_MM, 400)
    first, listed = (
        100 * group.outcomes.measure_recall((1e-3 * thresholds_mm).tolist(), kind) for kind in (False, True)
    )
    label = f"{_count_touches(group.touches)}, {name_noise(group.noise)}"
    axes.plot(thresholds_mm, listed, lw=0.8, alpha=0.8, color=colour, ls=dash)
    axes.plot(thresholds_mm, first, lw=2, label=label, color=colour, ls=dash)


def _draw_reliability(axes: Axes, outcomes: Outcomes, colour: str, below: int) -> None:
    """Draw the reliability, with the number of examples of each bin `below` its dot, in points."""
    bins = [b for b in bin_probabilities(outcomes) if b.examples >= FEW]
    if not bins:
        return
    stated, right = (100 * np.array([getattr(b, name) for b in bins], float) for name in ("stated", "right"))
    axes.plot(stated, right, "o-", color=colour, lw=1.4, ms=6, clip_on=False, zorder=3)
    for b, x, y in zip(bins, stated, right, strict=True):
        axes.annotate(str(b.examples), (x, y), (5, below), textcoords="offset points", size=8, color=colour)


def _label_recall(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.set_xticks(TICKS_MM, [f"{tick:g}" for tick in TICKS_MM], size=9)
    axes.minorticks_off()
    axes.set(xlim=(SHORTEST_MM, LONGEST_MM), ylim=(0, 101))
    for within_m in WITHIN_M:
        axes.axvline(1e3 * within_m, color="#a0aec0", lw=1, ls=(0, (2, 2)), zorder=0)
    axes.set_xlabel("surface distance (mm)")
    axes.set_ylabel("examples with a smaller error (%)")
    axes.set_title("Recall: thick = first pose, thin = any listed pose", size=10)
    draw_grid(axes)


def _label_reliability(axes: Axes) -> None:
    axes.plot([0, 100], [0, 100], color="#1a202c", lw=1, ls=(0, (5, 3)))
    axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal")
    axes.set_xlabel("stated probability of the first pose (%)")
    axes.set_ylabel("first poses within 1 mm (%)")
    axes.set_title("Reliability; numbers of examples beside the dots", size=10)
    draw_grid(axes)


def _count_touches(number: int) -> str:
    return "1 touch" if number == 1 else f"{number} touches"
