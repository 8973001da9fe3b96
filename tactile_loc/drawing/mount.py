"""By how much each touch contradicts a sensor's mount, as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.drawing.pictures import make_figure
from tactile_loc.tasks.mount import FoundMount

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIRST, LAST, LEFT_OUT = "#a0aec0", "#2b6cb0", "#e03131"


def draw_mount(found: FoundMount, title: str) -> Figure:
    """Draw the residual of each touch, in mm and in degrees, at the first guess and at the mount that was found."""
    names = [touch.name for touch in found.given.touches]
    figure = make_figure(max(7.0, 0.45 * len(names) + 2.5), 6.4, constrained=True)
    figure.suptitle(title, size=12, weight="bold")
    panels: Any = figure.subplots(2, 1, sharex=True)
    kinds = (("residual (mm)", 1e3), ("residual (degrees)", float(np.degrees(1.0))))
    for k, (axes, (label, unit)) in enumerate(zip(panels, kinds, strict=True)):
        _draw_residuals(axes, unit * found.first_residuals[:, k], unit * found.residuals[:, k], found.kept)
        axes.set_ylabel(label)
    panels[0].legend(frameon=False, fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    panels[1].set_xticks(range(len(names)), names, rotation=60, ha="right", size=8)
    panels[1].set_xlabel("touch")
    return figure


def _draw_residuals(axes: Any, first: NDArray[np.float64], last: NDArray[np.float64], kept: NDArray[np.bool_]) -> None:
    """Residuals (N,) of touches as points, on an axis that shows small and large ones."""
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
