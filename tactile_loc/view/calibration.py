"""Pictures of a calibration: the circles found in its photos, and the estimates for held-out presses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.sensors.calibration.folder import PICTURE
from tactile_loc.sensors.calibration.layouts import SHEET
from tactile_loc.sensors.calibration.outcome import CalibrationOutcome
from tactile_loc.sensors.calibration.unlabelled import FoundPress, FoundPresses
from tactile_loc.sensors.reading.circles import compare_colours
from tactile_loc.sensors.reading.reading import read_gel
from tactile_loc.view.pictures import add_panels, compute_extent_mm, make_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 4
READ_PANELS = "known", "estimated", "along x, at the deepest point"
USED, DROPPED = "#ffffff", "#e03131"
TILE_INCH, NAMED_INCH, MOST_COLUMNS = 1.9, 0.42, 8  # width of a tile, and height of its title
STRONG = 0.995  # quantile of the absolute colour changes that reaches the end of the drawn range
LONGEST = 30  # characters of a name


def save_held_out(folder: Path, outcome: CalibrationOutcome) -> Path:
    """Draw the held-out presses of a calibration into its folder, and return the picture's path. Raises OutputError."""
    return save_figure(folder / PICTURE, draw_held_out(outcome))


def save_labels(folder: Path, found: FoundPresses) -> Path:
    """Draw the circles found in the images of a folder into it, and return the picture's path. Raises OutputError."""
    return save_figure(folder / SHEET, draw_labels(found))


def draw_held_out(outcome: CalibrationOutcome) -> Figure:
    """Draw a row for each of at most `MOST` held-out presses.

    A row shows the image, the known and the estimated indentation, and the profiles of both along x through the deepest
    estimated point.
    """
    shown = outcome.held_out[:MOST]
    figure = make_figure(13.5, 2.9 * len(shown) + 0.6, constrained=True, title=outcome.title)
    rows: NDArray[Any] = figure.subplots(len(shown), 4, squeeze=False)
    for row, number in zip(rows, shown, strict=True):
        _draw_reading(figure, row, outcome, number)
    for axes, name in zip(rows[0, 1:], READ_PANELS, strict=True):
        axes.set_title(name, size=10)
    return figure


def draw_reading(outcome: CalibrationOutcome, number: int) -> Figure:
    """Draw one press, given by its number, in the width of a narrow page: the panels of `draw_held_out`."""
    figure = make_figure(6.2, 5.2, constrained=True)
    panels = list(figure.subplots(2, 2).flat)
    _draw_reading(figure, panels, outcome, number)
    for axes, name in zip(panels[1:], READ_PANELS, strict=True):
        axes.set_title(name, size=10)
    return figure


def _draw_reading(figure: Figure, panels: Sequence[Axes], outcome: CalibrationOutcome, number: int) -> None:
    """Draw a press into four panels: the image, the known and the estimated indentation, and their profiles."""
    estimator, presses = outcome.estimator, outcome.presses
    extent = compute_extent_mm(estimator.geometry)
    image, label = presses.read_press(number)
    found_mm = 1e3 * read_gel(estimator, image, estimator.geometry.gel).indentation_m
    known_mm = 1e3 * label.indentation_m
    if not label.absolute:  # its depth has an unknown offset: take the offset from the estimate
        known_mm = np.where(label.contact, known_mm + (found_mm - known_mm)[label.contact].mean(), known_mm)
    deepest = float(max(found_mm.max(), known_mm.max()))
    panels[0].imshow(image, extent=extent)
    panels[0].set_title(presses.name(number), size=9)
    for axes, depth in zip(panels[1:3], (known_mm, found_mm), strict=True):
        drawn = axes.imshow(depth, extent=extent, cmap="viridis", vmin=0, vmax=deepest)
    figure.colorbar(drawn, ax=list(panels[1:3]), shrink=0.85, label="indentation (mm)")
    _draw_profile(panels[3], found_mm, known_mm, label.known, extent)
    for axes in panels[:3]:
        axes.set_xlabel("x (mm)", size=8)


def _draw_profile(axes: Any, found_mm: Any, known_mm: Any, known: Any, extent: Sequence[float]) -> None:
    line = int(np.unravel_index(found_mm.argmax(), found_mm.shape)[0])
    x = np.linspace(extent[0], extent[1], found_mm.shape[1])
    axes.plot(x, np.where(known[line], known_mm[line], np.nan), color="#1a202c", lw=2.0, label="known")
    axes.plot(x, found_mm[line], color="#dd6b20", lw=1.2, label="estimated")
    axes.set_xlabel("x (mm)", size=8)
    axes.set_ylabel("indentation (mm)", size=8)
    axes.legend(frameon=False, fontsize=8)


def draw_labels(found: FoundPresses) -> Figure:
    """Draw the image of the untouched gel, and the amplified difference of each press from this image.

    The tile of a press shows its circle, name and radius. The tile of a dropped press has a red frame, and states the
    reason instead of the radius.
    """
    count = len(found.presses) + 1
    columns = min(MOST_COLUMNS, max(3, math.ceil(math.sqrt(count))))
    height, width = found.untouched.shape[:2]
    rows, tile = -(-count // columns), TILE_INCH * height / width
    wide, high = TILE_INCH * columns + 0.2, (tile + NAMED_INCH) * rows + 0.5
    figure = make_figure(wide, high, title=found.title)
    gaps = {"wspace": 0.05, "hspace": NAMED_INCH / tile}
    borders = {"left": 0.1 / wide, "right": 1 - 0.1 / wide, "bottom": 0.1 / high, "top": 1 - (0.4 + NAMED_INCH) / high}
    tiles: list[Any] = list(add_panels(figure, count, columns, gridspec_kw={**borders, **gaps}).flat)
    for axes in tiles:
        axes.set(xticks=[], yticks=[])
    tiles[0].imshow(found.untouched)
    names = ", ".join(found.untouched_names) or "composed from presses"
    tiles[0].set_title(f"untouched gel\n{_shorten(names)}", size=7.5)
    for axes, press, change in zip(tiles[1:], found.presses, _amplify_changes(found, found.presses), strict=False):
        _draw_press(axes, press, change)
    return figure


def draw_circle(found: FoundPresses, number: int) -> Figure:
    """Draw the circle of one press, given by its number, on the image and on its amplified change."""
    press = found.presses[number]
    height, width = found.untouched.shape[:2]
    figure = make_figure(6.2, 3.0 * height / width + 0.5, constrained=True)
    panels = list(figure.subplots(1, 2).flat)
    for axes, picture in zip(panels, (press.frame.image, *_amplify_changes(found, [press])), strict=True):
        axes.set(xticks=[], yticks=[])
        _draw_press(axes, press, picture)
    panels[1].set_title("change from the untouched gel\n", size=7.5)
    return figure


def _amplify_changes(found: FoundPresses, presses: Sequence[FoundPress]) -> list[NDArray[np.uint8]]:
    """Return the amplified changes (H, W, 3) of presses from the untouched gel, around grey, all by one factor."""
    changes = [compare_colours(press.frame.image, found.untouched) for press in presses]
    factor = 127 / max(1.0, float(np.median([np.quantile(np.abs(change), STRONG) for change in changes])))
    return [np.clip(128 + factor * change, 0, 255).astype(np.uint8) for change in changes]


def _draw_press(axes: Axes, press: FoundPress, picture: NDArray[np.uint8]) -> None:
    from matplotlib.patches import Circle

    height, width = picture.shape[:2]
    colour = DROPPED if press.dropped else USED
    axes.imshow(picture, extent=(0, width, height, 0))
    text = f"dropped: {press.dropped}" if press.dropped else ""
    if press.circle is not None:
        centre = press.circle.x_px, press.circle.y_px
        axes.add_patch(Circle(centre, press.circle.radius_px, fill=False, color=colour, lw=1.0))
        axes.plot(*centre, "+", color=colour, ms=4, mew=0.8)
        text = text or f"radius {press.circle.radius_px:.1f} px"
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_title(f"{_shorten(press.name)}\n{text}", size=7.5, color=DROPPED if press.dropped else "black")
    if press.dropped:
        for spine in axes.spines.values():
            spine.set(color=DROPPED, linewidth=2.5)


def _shorten(name: str) -> str:
    return name if len(name) <= LONGEST else f"...{name[3 - LONGEST :]}"
