"""What was found in images without labels, as one sheet to look at: each press, its circle, and why it was dropped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.circles import compare_colours
from tactile_loc.calibration.unlabelled import FoundPress, FoundPresses
from tactile_loc.drawing.pictures import make_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

USED, DROPPED = "#ffffff", "#e03131"
TILE_INCH, MOST_COLUMNS = 1.9, 8
STRONG = 0.995  # of the colours' changes lie within what is drawn
LONGEST = 30  # characters of a name


def draw_labels(found: FoundPresses, title: str) -> Figure:
    """Draw the untouched gel, and of each press how it differs from that, amplified, with circle, name and radius.

    Dropped presses are framed in red and say why.
    """
    count = len(found.presses) + 1
    columns = min(MOST_COLUMNS, max(3, math.ceil(math.sqrt(count))))
    height, width = found.untouched.shape[:2]
    rows, tile = -(-count // columns), TILE_INCH * height / width + 0.42
    figure = make_figure(TILE_INCH * columns + 0.2, tile * rows + 0.6, constrained=True)
    figure.suptitle(title, size=12, weight="bold")
    tiles: list[Any] = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in tiles:
        axes.set(xticks=[], yticks=[])
    for axes in tiles[count:]:
        axes.set_axis_off()
    tiles[0].imshow(found.untouched)
    names = ", ".join(found.untouched_names) or "pieced together"
    tiles[0].set_title(f"untouched gel\n{_short(names)}", size=7.5)
    changes = [compare_colours(press.frame.image, found.untouched) for press in found.presses]
    amplified = 127 / max(1.0, float(np.median([np.quantile(np.abs(change), STRONG) for change in changes])))
    for axes, press, change in zip(tiles[1:], found.presses, changes, strict=False):
        _draw_press(axes, press, np.clip(128 + amplified * change, 0, 255).astype(np.uint8))
    return figure


def _draw_press(axes: Axes, press: FoundPress, picture: NDArray[np.uint8]) -> None:
    from matplotlib.patches import Circle

    height, width = picture.shape[:2]
    colour = DROPPED if press.dropped else USED
    axes.imshow(picture, extent=(0, width, height, 0))
    said = press.dropped
    if press.circle is not None:
        centre = press.circle.x_px, press.circle.y_px
        axes.add_patch(Circle(centre, press.circle.radius_px, fill=False, color=colour, lw=1.0))
        axes.plot(*centre, "+", color=colour, ms=4, mew=0.8)
        said = said or f"radius {press.circle.radius_px:.1f} px"
    axes.set(xlim=(0, width), ylim=(height, 0))
    text = f"dropped: {said}" if press.dropped else said
    axes.set_title(f"{_short(press.name)}\n{text}", size=7.5, color=DROPPED if press.dropped else "black")
    if press.dropped:
        for spine in axes.spines.values():
            spine.set(color=DROPPED, linewidth=2.5)


def _short(name: str) -> str:
    return name if len(name) <= LONGEST else f"...{name[3 - LONGEST :]}"
