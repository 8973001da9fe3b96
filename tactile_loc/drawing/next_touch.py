"""What each mode would show if a touch were made next, as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.formatting import percent
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.drawing.pictures import draw_contact_shape, make_figure
from tactile_loc.tasks.next_touch import NextTouch, RatedApproach

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN, COLUMNS = 12, 4
BEST, OTHERS = "#2b6cb0", "#a0aec0"


def draw_next_touch(found: NextTouch, title: str) -> Figure:
    """Draw what the likeliest modes would show at the best approach, and how much doubt each approach would leave."""
    depths = found.contacts(found.best)
    count = min(SHOWN, len(depths))
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = make_figure(2.6 * columns + 4.6, max(3.6, 2.45 * rows + 1.0), constrained=True)
    figure.suptitle(title, size=12, weight="bold")
    parts: Any = figure.subfigures(1, 2, width_ratios=[2.6 * columns, 4.6])
    left, right = parts
    panels: NDArray[Any] = left.subplots(rows, columns, squeeze=False)
    for axes in panels.flat[count:]:
        axes.set_axis_off()
    for k, axes in enumerate(panels.flat[:count]):
        _draw_mode(axes, found, depths[k], k)
    left.supxlabel(f"what each mode would show at {found.best.approach.name or 'the best approach'}", size=9)
    _draw_doubt(right.subplots(), found.ranked, found.modes.entropy)
    return figure


def _draw_mode(axes: Any, found: NextTouch, depth_m: NDArray[np.float32], number: int) -> None:
    rated, modes = found.best, found.modes
    press_m = modes.press_m if rated.approach.press_m is None else rated.approach.press_m
    geometry = modes.geometry.pressed(press_m)
    draw_contact_shape(axes, ContactShape(depth_m, press_m), geometry)
    axes.set(xticks=[], yticks=[])
    travel_m = rated.travel_m[number]
    stops = "meets nothing" if np.isnan(travel_m) else f"stops after {1e3 * travel_m:.1f} mm"
    axes.set_title(f"{number + 1}: {percent(float(modes.probabilities[number]))}, {stops}", size=8)


def _draw_doubt(axes: Any, ranked: tuple[RatedApproach, ...], before: float) -> None:
    """The entropy that each approach would leave, the best one's first."""
    left = [rated.entropy for rated in ranked]
    axes.bar(np.arange(1, len(left) + 1), left, width=1.0, color=[BEST, *[OTHERS] * (len(left) - 1)])
    axes.axhline(before, color="#37474f", lw=1.0, ls="--")
    axes.text(len(left) + 0.5, before, "now", ha="right", va="bottom", size=8)
    axes.set(xlim=(0.5, len(left) + 0.5), ylim=(0, max(1.15 * before, 0.1)))
    axes.set_xlabel("approach, by rank", size=9)
    axes.set_ylabel("doubt that is expected to be left (nats)", size=9)
    axes.tick_params(labelsize=8)
