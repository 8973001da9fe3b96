"""Pictures of touches and results, in millimetres and per cent. They do not use matplotlib's global state."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.formatting import format_millimetres, format_percent
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.images import load_image
from tactile_loc.io.shape_pictures import NO_CONTACT, OUTLINE
from tactile_loc.locate.result.localization import Localization
from tactile_loc.store.files import write_atomically
from tactile_loc.view.drawn_scene import EDGE, STEEL, TRUTH, DrawnScene, find_extent_m
from tactile_loc.view.palette import LIGHT
from tactile_loc.view.pose_panel import draw_pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.image import AxesImage
    from matplotlib.layout_engine import LayoutEngine

EXPECTED = "#ffffff"  # colour of the predicted outline on a photo
MOST_TOUCHES = 30
MOST_TOGETHER = 6  # number of touches drawn in the result of several touches
LONGEST_NAME, LONGEST_LINE = 18, 95  # characters of a touch's name above its panel, and of a line below the panels
DPI = 130
LAYOUT: LayoutEngine | Literal["constrained"] = "constrained"  # keeps the labels of panels apart


Errors = Sequence[float] | Floats | None
"""The errors (K,) of hypotheses, metres, if they are known."""


def draw_result(localization: Localization, scene: Scene, title: str, errors_m: Errors = None) -> Figure:
    """Draw the touches, the contact shapes of the best hypotheses, and the object on the sensor.

    Each contact shape has the touch's outline. If a single touch was estimated from an image, the image comes first,
    with the outline that the best pose predicts. Of several touches, at most `MOST_TOGETHER` are drawn and the others
    are named; the hypotheses and the object are those of the first touch. `scene` must have the first touch's geometry.
    `errors_m` (K,) are the errors of the K hypotheses, in metres.
    """
    several, columns = len(localization.touches) > 1, 1 if len(localization.hypotheses) < 3 else 2
    photo = [] if several or localization.touch.image is None else [3.9]
    widths = [*photo, 5.6 if several else 3.9, 2.0 * columns, 4.4]
    figure = make_figure(sum(widths), 5.4)
    figure.suptitle(title, size=15, weight="bold", x=0.5, y=0.978)
    panels: Any = figure.subfigures(1, len(widths), width_ratios=widths)
    left, middle, right = panels[-3:]
    if photo:
        _draw_photo(panels[0], localization, scene)
    draw = _draw_all_observed if several else _draw_observed
    draw(left, localization)
    _draw_candidates(middle, localization, scene, errors_m, columns)
    _draw_scene(right, localization)
    return figure


def draw_touches(touches: Sequence[Touch], title: str) -> Figure:
    """Draw the contact shapes of at most `MOST_TOUCHES` touches as a sheet."""
    shown = list(touches)[:MOST_TOUCHES]
    columns = min(5, len(shown))
    rows = -(-len(shown) // columns)
    figure = make_figure(2.5 * columns + 1.0, 2.7 * rows + 0.9, constrained=True, title=title)
    grid = add_panels(figure, len(shown), columns)
    deepest_m = max(touch.press_depth_m for touch in shown)  # one colour scale for all
    for axes, touch in zip(grid.flat, shown, strict=False):
        image = draw_contact_shape(axes, touch.contact_shape, touch.geometry, deepest_m)
        axes.set_title(touch.name, size=8)
    grid[0, 0].set_ylabel("y (mm)", size=8)
    grid[0, 0].set_xlabel("x (mm)", size=8)
    figure.colorbar(image, ax=list(grid.flat), shrink=0.8, label="depth from full penetration (mm)")
    return figure


def draw_contact_shape(
    axes: Axes, shape: ContactShape, geometry: SensorGeometry, deepest_m: float | None = None
) -> AxesImage:
    """Draw a contact shape (H, W) as the sensor sees it, x right and y down, in mm on the sensing surface.

    The colour scale ends at `deepest_m` metres. The default is the shape's press depth.
    """
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator

    colours = colormaps["viridis"].with_extremes(bad=NO_CONTACT)
    depth_mm = np.ma.masked_where(~shape.contact, 1e3 * shape.depth_m)
    extent = compute_extent_mm(geometry)
    image: AxesImage = axes.imshow(
        depth_mm, cmap=colours, vmin=0.0, vmax=1e3 * (deepest_m or shape.press_depth_m), extent=extent, origin="upper"
    )
    if not geometry.observed_mask.all():
        unseen = np.ma.masked_where(geometry.observed_mask, np.ones(geometry.shape))
        axes.imshow(unseen, cmap=colormaps["Greys"], vmin=0, vmax=4, extent=extent, origin="upper", alpha=0.8)
    x0, x1, y0, y1 = (1e3 * value for value in geometry.rectangle)
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, lw=1.0, ec=LIGHT.soft, clip_on=False))
    axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.tick_params(labelsize=9, length=2.5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))  # few and round, so that labels stay apart
    return image


def save_figure(path: str | Path, figure: Figure, dpi: int | None = None) -> Path:
    """Write a figure atomically with `dpi` (default `DPI`) dots per inch, and return the path.

    The suffix chooses the format, such as PDF; the default is PNG. Raises OutputError if the file cannot be
    written.
    """
    return write_atomically(Path(path), lambda temporary: _save(figure, temporary, dpi))


def render_figure(figure: Figure, dpi: int | None = None) -> NDArray[np.uint8]:
    """Return a figure as a picture (H, W, 3) with `dpi` (default `DPI`) dots per inch."""
    file = BytesIO()
    _save(figure, file, dpi)
    return load_image(BytesIO(file.getvalue()), "RGB")[1]


def _save(figure: Figure, file: Path | BytesIO, dpi: int | None) -> None:
    """Write a figure. A $ in a text, which comes from the name of a file, does not begin a formula."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if "$" in text.get_text() and "mathdefault" not in text.get_text():  # of a logarithmic axis
            text.set_parse_math(False)
    asked = file.suffix[1:].lower() if isinstance(file, Path) else ""
    kind = asked if asked in figure.canvas.get_supported_filetypes() else "png"
    figure.savefig(file, dpi=dpi or DPI, facecolor=figure.get_facecolor(), format=kind)


def _draw_observed(panel: SubFigure, localization: Localization) -> None:
    touch = localization.touch
    axes = panel.add_axes((0.125, 0.19, 0.85, 0.68))
    image = draw_contact_shape(axes, touch.contact_shape, touch.geometry)
    draw_outline(axes, touch)
    axes.set_xlabel("x (mm)", size=10, labelpad=2)
    axes.set_ylabel("y (mm)", size=10, labelpad=-2)
    _write_heading(panel, "observed contact shape")
    _add_depth_bar(panel, image, 0.85)


def _add_depth_bar(panel: SubFigure, image: AxesImage, width: float) -> None:
    bar = panel.add_axes((0.125, 0.095, width, 0.022))
    panel.colorbar(image, cax=bar, orientation="horizontal")
    bar.set_xlabel("depth from full penetration (mm); grey: no contact", size=10, labelpad=2)
    bar.tick_params(labelsize=9)


def _draw_all_observed(panel: SubFigure, localization: Localization) -> None:
    """Draw the contact shapes of several touches on one colour scale, and name the touches that are not drawn."""
    shown = localization.touches[:MOST_TOGETHER]
    ious = localization.best.imprint_ious or (math.nan,) * len(shown)
    columns = 2 if len(shown) < 5 else 3
    rows = -(-len(shown) // columns)
    deepest_m = max(touch.press_depth_m for touch in shown)
    for k, touch in enumerate(shown):
        row, column = divmod(k, columns)
        width, height = 0.94 / columns, 0.70 / rows
        axes = panel.add_axes((0.07 + column * width, 0.19 + (rows - 1 - row) * height, width - 0.09, height - 0.11))
        image = draw_contact_shape(axes, touch.contact_shape, touch.geometry, deepest_m)
        draw_outline(axes, touch)
        axes.set_title(_write_touch(touch, ious[k], k in localization.agreement.outliers), size=9, pad=4)
    _write_heading(panel, f"{len(localization.touches)} observed contact shapes (mm)")
    _add_depth_bar(panel, image, 0.8)
    if text := _name_others(localization):
        panel.text(0.5, 0.012, text, size=9.5, ha="center", va="bottom", color=LIGHT.soft)


def _write_touch(touch: Touch, iou: float, contradicts: bool) -> str:
    """Return a touch's name, and how well the best pose explains the touch."""
    name = _shorten(touch.name)
    fit = "contradicts the others" if contradicts else "" if math.isnan(iou) else f"IoU {100 * iou:.0f} %"
    return f"{name}\n{fit}"


def _shorten(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 3]}..."


def _name_others(localization: Localization) -> str:
    """Name the touches that are not drawn, and those that were left out."""
    parts = {"not drawn": localization.touches[MOST_TOGETHER:], "left out": localization.left_out}
    text = "; ".join(f"{word}: {', '.join(touch.name for touch in some)}" for word, some in parts.items() if some)
    return textwrap.shorten(text, LONGEST_LINE, placeholder=" ...")


def _draw_photo(panel: SubFigure, localization: Localization, scene: Scene) -> None:
    """Draw the touch's image, and the contact outline that the best pose predicts."""
    touch = localization.touch
    axes = panel.add_axes((0.125, 0.19, 0.85, 0.68))
    axes.imshow(np.asarray(touch.image), extent=compute_extent_mm(touch.geometry), origin="upper")
    made = scene.show_like(localization.best.T_sensor_object, touch)
    draw_outline(axes, dataclasses.replace(touch, contact_shape=made), EXPECTED)
    axes.tick_params(labelsize=9, length=2.5)
    axes.set_xlabel("x (mm)", size=10, labelpad=2)
    axes.set_ylabel("y (mm)", size=10, labelpad=-2)
    _write_heading(panel, "image")
    panel.text(0.55, 0.085, "white: outline predicted by the best pose", size=10, ha="center", color=LIGHT.soft)


def _draw_candidates(
    panel: SubFigure, localization: Localization, scene: Scene, errors_m: Errors, columns: int
) -> None:
    touch = localization.touch
    width, top = 0.92 / columns, 0.475 if len(localization.hypotheses) > 1 else 0.28
    for i, hypothesis in enumerate(localization.hypotheses[: 2 * columns]):
        left, bottom = 0.04 + (i % columns) * (width + 0.01), top - (i // columns) * 0.42
        axes = panel.add_axes((left, bottom, width - 0.01, 0.36))
        shape = scene.show_like(hypothesis.T_sensor_object, touch)
        draw_contact_shape(axes, shape, touch.geometry)
        draw_outline(axes, touch)
        axes.set(xticks=[], yticks=[])
        error = "" if errors_m is None else f"\n{format_millimetres(errors_m[i])} off"
        fit = f"{format_percent(hypothesis.probability)},  IoU {100 * hypothesis.imprint_iou:.0f} %"
        axes.set_title(f"{i + 1}:  {fit}{error}", size=9.5, pad=4)
    first = f" of {_shorten(touch.name)}" if localization.others else ""
    _write_heading(panel, f"best explanations{first}" if columns == 2 else f"best poses{first}")
    panel.text(0.5, 0.012, "red: observed outline", size=10, ha="center", va="bottom", color=OUTLINE)


def _write_heading(panel: SubFigure, text: str) -> None:
    panel.text(0.5, 0.893, text, size=12, ha="center", va="bottom")


def _draw_scene(panel: SubFigure, localization: Localization) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    axes = panel.add_axes((0.08, 0.075, 0.83, 0.815))
    draw_pose(axes, DrawnScene.of(localization))
    handles: list[Any] = [Patch(fc=STEEL, ec=EDGE, lw=0.8, label="best pose")]
    if localization.touch.T_sensor_object is not None:
        handles.append(Line2D([], [], color=TRUTH, lw=1.5, label="true pose"))
    _write_heading(panel, "the object on the sensor")
    panel.legend(
        handles=handles, loc="lower center", bbox_to_anchor=(0.5, -0.005), ncols=2, frameon=False, fontsize=10.5
    )


def group_nearby(places: Floats, apart: float) -> list[list[int]]:
    """Group places (N, D), and return the indices of the places in each group.

    Each place is nearer than `apart` to the first place of its group.
    """
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        near = next((g for g in groups if np.linalg.norm(places[g[0]] - place) < apart), None)
        groups.append([i]) if near is None else near.append(i)
    return groups


def add_panels(parent: Figure | SubFigure, count: int, columns: int, **options: Any) -> NDArray[Any]:
    """Add axes (R, C) to a figure, with `columns` in each row, and return them; only the first `count` are visible."""
    panels: NDArray[Any] = parent.subplots(-(-count // columns), columns, squeeze=False, **options)
    for axes in panels.flat[count:]:
        axes.set_axis_off()
    return panels


def draw_outline(axes: Axes, touch: Touch, colour: str = OUTLINE) -> None:
    """Draw the outline of the touch's contact with the object as the sensor sees it, in mm."""
    left, right, bottom, top = compute_extent_mm(touch.geometry)
    height, width = touch.geometry.shape
    x = left + (np.arange(width) + 0.5) / width * (right - left)
    y = top + (np.arange(height) + 0.5) / height * (bottom - top)
    axes.contour(x, y, touch.touching_shape.contact.astype(float), levels=[0.5], colors=colour, linewidths=1.1)


def compute_extent_mm(geometry: SensorGeometry) -> tuple[float, float, float, float]:
    """Return the image's borders (left, right, bottom, top) on the sensing surface, in mm; y points down."""
    left, right, bottom, top = find_extent_m(geometry)
    return 1e3 * left, 1e3 * right, 1e3 * bottom, 1e3 * top


def make_figure(width: float, height: float, constrained: bool = False, title: str = "") -> Figure:
    """Return an empty figure of `width` by `height` inches that can be saved without matplotlib's global state.

    A `title` is for figures that are `constrained`, whose layout keeps labels apart.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=LAYOUT if constrained else None)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(textwrap.fill(title, int(8.5 * width)), size=13, weight="bold")
    return figure
