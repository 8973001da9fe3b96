"""A picture of how far probabilities can be trusted: the reliability diagram, and errors against entropy."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tactile_loc.drawing.pictures import make_figure
from tactile_loc.evaluation.belief import BELIEF, LEVELS
from tactile_loc.evaluation.figures import COLOURS
from tactile_loc.evaluation.tables import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "os^Dv<>pP*X"
LEAST_MM = 1e-2  # errors below are drawn here: the axis is logarithmic


def draw_reliability(runs: Sequence[Run], title: str) -> Figure:
    """Draw, a curve for each run, how often the truth lies in credible sets against how often it should; and the error
    of the most probable pose, refined, against the posterior's entropy, a dot a touch.
    """
    figure = make_figure(11.5, 5.4, constrained=True)
    figure.suptitle(textwrap.fill(title, 100), size=13, weight="bold")
    trusted, entropy = figure.subplots(1, 2)
    for number, run in enumerate(runs):
        colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number // len(COLOURS) % len(MARKERS)]
        _draw_coverage(trusted, run, colour, marker)
        beliefs = run.evaluation.beliefs[:, BELIEF.index("entropy")]
        errors_mm = np.maximum(1e3 * run.evaluation.errors("reg-1"), LEAST_MM)
        entropy.plot(beliefs, errors_mm, marker, ms=4, alpha=0.6, color=colour, mec="none")
    trusted.plot([0, 100], [0, 100], color="#1a202c", lw=1, ls=(0, (5, 3)), label="as it should be")
    trusted.set(xlim=(0, 100), ylim=(0, 100), aspect="equal")
    trusted.set_xlabel("probability of the credible set (%)")
    trusted.set_ylabel("touches whose true pose is in it (%)")
    entropy.set_yscale("log")
    entropy.set_xlabel("entropy of the posterior (nats)")
    entropy.set_ylabel("ADD of the most probable pose, refined (mm)")
    for axes in (trusted, entropy):
        axes.grid(color="#e2e8f0", lw=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    return figure


def _draw_coverage(axes: Axes, run: Run, colour: str, marker: str) -> None:
    levels = np.sort(run.evaluation.beliefs[:, BELIEF.index("level")])
    sure = np.linspace(0, 1, 101)
    held = np.searchsorted(levels, sure, side="right") / len(levels)
    axes.plot(100 * sure, 100 * held, color=colour, lw=1.6, label=f"{run.object}, {run.encoder}")
    axes.plot(100 * np.array(LEVELS), 100 * np.array(run.trust().coverage), marker, color=colour, ms=6)
