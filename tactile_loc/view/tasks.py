"""Pictures of tasks: the predicted next touch, and the residuals of a mount."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.planning.hand_eye_calibration import HandEyeCalibration
from tactile_loc.planning.next_touch import NextTouch, RatedApproach
from tactile_loc.view.pictures import add_panels, draw_contact_shape, make_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIRST, LAST, LEFT_OUT = "#a0aec0", "#2b6cb0", "#e03131"
SHOWN, COLUMNS = 12, 4
BEST, OTHERS = "#2b6cb0", "#a0aec0"


def draw_next_touch(found: NextTouch, title: str) -> Figure:
    """Draw the best approach's contact shapes at the most probable modes, and the entropy expected per approach."""
    depths = found.contacts(found.best)
    count = min(SHOWN, len(depths))
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = make_figure(2.6 * columns + 4.6, max(3.6, 2.45 * rows + 1.0), constrained=True, title=title)
    parts: Any = figure.subfigures(1, 2, width_ratios=[2.6 * columns, 4.6])
    left, right = parts
    panels = add_panels(left, count, columns)
    for k, axes in enumerate(panels.flat[:count]):
        _draw_mode(axes, found, depths[k], k)
    left.supxlabel(f"contact shape of each mode at {found.best.approach.name or 'the best approach'}", size=9)
    _draw_entropies(right.subplots(), found.ranked, found.modes.entropy)
    return figure


def _draw_mode(axes: Any, found: NextTouch, depth_m: Float32, number: int) -> None:
    rated, modes = found.best, found.modes
    press_m = modes.press_m if rated.approach.press_m is None else rated.approach.press_m
    geometry = modes.geometry.press(press_m)
    draw_contact_shape(axes, ContactShape(depth_m, press_m), geometry)
    axes.set(xticks=[], yticks=[])
    travel_m = rated.travel_m[number]
    stops = "no contact" if np.isnan(travel_m) else f"contact after {1e3 * travel_m:.1f} mm"
    axes.set_title(f"{number + 1}: {format_percent(float(modes.probabilities[number]))}, {stops}", size=8)


def _draw_entropies(axes: Any, ranked: tuple[RatedApproach, ...], before: float) -> None:
    """Draw the entropy expected after each approach; the best approach comes first."""
    left = [rated.entropy for rated in ranked]
    axes.bar(np.arange(1, len(left) + 1), left, width=1.0, color=[BEST, *[OTHERS] * (len(left) - 1)])
    axes.axhline(before, color="#37474f", lw=1.0, ls="--")
    axes.text(len(left) + 0.5, before, "now", ha="right", va="bottom", size=8)
    axes.set(xlim=(0.5, len(left) + 0.5), ylim=(0, max(1.15 * before, 0.1)))
    axes.set_xlabel("approach, by rank", size=9)
    axes.set_ylabel("expected entropy afterwards (nats)", size=9)
    axes.tick_params(labelsize=8)


def draw_hand_eye(found: HandEyeCalibration, title: str) -> Figure:
    """Draw the residual of each touch, in mm and in degrees, at the first guess and at the found mount."""
    names = [touch.name for touch in found.given.touches]
    figure = make_figure(max(7.0, 0.45 * len(names) + 2.5), 6.4, constrained=True, title=title)
    panels: Any = figure.subplots(2, 1, sharex=True)
    kinds = (("residual (mm)", 1e3), ("residual (degrees)", float(np.degrees(1.0))))
    for k, (axes, (label, unit)) in enumerate(zip(panels, kinds, strict=True)):
        _draw_residuals(axes, unit * found.first_residuals[:, k], unit * found.residuals[:, k], found.kept)
        axes.set_ylabel(label)
    panels[0].legend(frameon=False, fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    panels[1].set_xticks(range(len(names)), names, rotation=60, ha="right", size=8)
    panels[1].set_xlabel("touch")
    return figure


def _draw_residuals(axes: Any, first: Floats, last: Floats, kept: Bools) -> None:
    """Draw the first and last residuals (N,) of touches on a logarithmic axis; `kept` (N,) marks the used touches."""
    numbers = np.arange(len(kept))
    axes.vlines(numbers, np.minimum(first, last), np.maximum(first, last), color=FIRST, lw=0.8, zorder=1)
    axes.scatter(numbers, first, s=22, color=FIRST, label="first guess")
    axes.scatter(numbers[kept], last[kept], s=30, color=LAST, label="found mount")
    if not kept.all():
        axes.scatter(numbers[~kept], last[~kept], s=34, color=LEFT_OUT, marker="x", label="left out")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.grid(axis="y", which="both", lw=0.3)
