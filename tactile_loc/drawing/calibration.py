"""What a calibration makes of presses that it did not learn from, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.estimator import GelEstimator
from tactile_loc.calibration.labels import LabelledPresses
from tactile_loc.drawing.pictures import extent_mm, make_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 4


def draw_held_out(estimator: GelEstimator, presses: LabelledPresses, numbers: Sequence[int], title: str) -> Figure:
    """Draw presses (by number): the image, what is known of the indentation, the estimate, and both along a line."""
    shown = list(numbers)[:MOST]
    figure = make_figure(13.5, 2.9 * len(shown) + 0.6, constrained=True)
    figure.suptitle(title, size=13, weight="bold")
    rows: NDArray[Any] = figure.subplots(len(shown), 4, squeeze=False)
    extent = extent_mm(estimator.geometry)
    for row, number in zip(rows, shown, strict=True):
        image, label = presses.read_press(number)
        found_mm, known_mm = 1e3 * estimator.read_indentation(image), 1e3 * label.indentation_m
        if not label.absolute:  # how deep the visible circle lies is taken from the estimate
            known_mm = np.where(label.contact, known_mm + (found_mm - known_mm)[label.contact].mean(), known_mm)
        deepest = float(max(found_mm.max(), known_mm.max()))
        row[0].imshow(image, extent=extent)
        row[0].set_title(presses.name(number), size=9)
        for axes, depth in zip(row[1:3], (known_mm, found_mm), strict=True):
            drawn = axes.imshow(depth, extent=extent, cmap="viridis", vmin=0, vmax=deepest)
        figure.colorbar(drawn, ax=list(row[1:3]), shrink=0.85, label="indentation (mm)")
        _draw_profile(row[3], found_mm, known_mm, label.known, extent)
        for axes in row[:3]:
            axes.set_xlabel("x (mm)", size=8)
    for axes, name in zip(rows[0, 1:], ("known", "estimated", "along x, through the deepest"), strict=True):
        axes.set_title(name, size=10)
    return figure


def _draw_profile(axes: Any, found_mm: Any, known_mm: Any, known: Any, extent: Sequence[float]) -> None:
    line = int(np.unravel_index(found_mm.argmax(), found_mm.shape)[0])
    x = np.linspace(extent[0], extent[1], found_mm.shape[1])
    axes.plot(x, np.where(known[line], known_mm[line], np.nan), color="#1a202c", lw=2.0, label="known")
    axes.plot(x, found_mm[line], color="#dd6b20", lw=1.2, label="estimated")
    axes.set_xlabel("x (mm)", size=8)
    axes.set_ylabel("indentation (mm)", size=8)
    axes.legend(frameon=False, fontsize=8)
