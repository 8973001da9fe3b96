"""Figures of the paper's protocol: errors as violins, galleries, credible sets, and errors by number of contacts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.formatting import format_millimetres
from tactile_loc.evaluation.metrics import LEVELS
from tactile_loc.evaluation.protocol import LINES
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import find_scale_m, measure_coverage, normalise_errors, summarise_lines
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.io.shape_pictures import OUTLINE
from tactile_loc.locate.localizer import Localizer
from tactile_loc.view.pictures import add_panels, draw_contact_shape, draw_outline, make_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DRAWN = ("best-1", "best-10", "best-50", "reg-1", "chosen", "reg-10")
COLOURS = ("#2b6cb0", "#dd6b20", "#2f855a", "#6b46c1", "#b83280", "#4a5568")
RANDOM, CLOSEST = "#c53030", "#1a202c"
FLOOR = 1e-4  # smaller errors, as shares of a random pose's error, are drawn at this value
ROOM = 0.82  # share of the distance between lines that the lines' violins fill
LETTER_IN, HANDLE_IN = 0.085, 0.6  # width of a letter, and of a handle with its margins, in a legend, inches
GALLERY_LINE = "reg-1"
EACH = 2  # touches of each kind in a gallery
MARKERS = "os^Dv<>pP*X"
LEAST_MM = 1e-2  # smaller errors are drawn at this value, since the axis is logarithmic
FUSION_FLOOR = 1e-3  # the same as FLOOR, for several touches
KINEMATIC = "#718096"
TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)


def draw_violins(table: ExampleTable, title: str) -> Figure:
    """Draw a panel for each object: the distribution of each line's normalised ADD, with a colour for each encoder.

    The error axis is logarithmic. White dots are medians, thick bars extend between quartiles. Dashed lines are the
    medians of a random pose and of the grid pose nearest to the true pose.
    """
    figure, panels, colours = _make_object_panels(table, title, (4.9, 3.6), 0.5)
    for (name,), some in table.group("object").items():
        _draw_object(panels[name], some, colours)
    runs = table.group("object", "encoder").values()
    lowest = min(_take_logarithm(normalise_errors(run, line)).min() for run in runs for line in DRAWN)
    _scale_errors(next(iter(panels.values())), lowest)
    _add_legend(figure, _make_handles(colours))
    return figure


def _add_legend(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend below the panels, with as many columns as fit into the figure's width."""
    widest_in = LETTER_IN * max(len(handle.get_label()) for handle in handles) + HANDLE_IN
    columns = min(len(handles), max(1, int(figure.get_figwidth() / widest_in)))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)


def _make_object_panels(
    table: ExampleTable, title: str, size: tuple[float, float], wider: float = 0.0
) -> tuple[Figure, dict[str, Axes], dict[str, str]]:
    """Make a figure with a panel, width by height in inches, for each object; choose a colour for each encoder."""
    objects, encoders = (dict.fromkeys(table[name].tolist()) for name in ("object", "encoder"))
    width, height = size
    columns = min(3, len(objects))
    rows = -(-len(objects) // columns)
    figure = make_figure(max(6.4, width * columns) + wider, height * rows + 1.1, constrained=True, title=title)
    panels = add_panels(figure, len(objects), columns, sharey=True)
    for axes in panels[:, 0]:
        axes.set_ylabel("ADD / mean ADD of a random pose")
    colours = dict(zip(encoders, itertools.cycle(COLOURS), strict=False))
    return figure, dict(zip(objects, panels.flat, strict=False)), colours


def draw_gallery(localizer: Localizer, table: ExampleTable, touches: SimulatedTouches, title: str) -> Figure:
    """Draw the best, median and worst touches of an evaluation, by the error of the refined most probable pose.

    The upper row shows the observed contact shapes. The lower row shows the contact shapes of the estimated poses
    without noise, with the observed outline.
    """
    errors_m = table.errors_m(GALLERY_LINE, "add")
    chosen = _choose_touches(errors_m)
    figure = make_figure(2.35 * len(chosen) + 1.3, 5.8, constrained=True, title=title)
    panels: NDArray[Any] = figure.subplots(2, len(chosen), squeeze=False, sharex=True, sharey=True)
    deepest_m = localizer.scene.geometry.max_depth_m
    for column, (kind, number) in zip(panels.T, chosen, strict=True):
        touch = touches.draw_touch(localizer, number)
        T = table["T_sensor_object"][number, LINES.index(GALLERY_LINE)]
        shape = localizer.scene.contact_shape(T, touch.press_depth_m)
        draw_contact_shape(column[0], touch.contact_shape, touch.geometry, deepest_m)
        image = draw_contact_shape(column[1], shape, touch.geometry, deepest_m)
        draw_outline(column[1], touch)
        column[0].set_title(f"{kind}: {format_millimetres(float(errors_m[number]))}\n{touch.name}", size=10)
        column[1].set_xlabel("x (mm)", size=9)
    panels[0, 0].set_ylabel("observed\ny (mm)", size=10)
    panels[1, 0].set_ylabel("estimated, refined\ny (mm)", size=10)
    bar = figure.colorbar(image, ax=list(panels.flat), shrink=0.7, aspect=35, pad=0.015)
    bar.set_label("depth from full penetration (mm); grey: no contact", size=9)
    figure.text(0.5, 0.008, "red: outline of the observed contact", size=10, color=OUTLINE, ha="center", va="bottom")
    figure.get_layout_engine().set(rect=(0, 0.04, 1, 0.96))  # type: ignore[union-attr, call-arg]
    return figure


def _draw_object(axes: Axes, table: ExampleTable, colours: dict[str, str]) -> None:
    runs = table.group("encoder")
    width = ROOM / len(runs)
    for i, ((encoder,), run) in enumerate(runs.items()):
        shift = (i - 0.5 * (len(runs) - 1)) * width
        for place, line in enumerate(DRAWN):
            _draw_violin(axes, place + shift, width, normalise_errors(run, line), colours[encoder])
    first = next(iter(runs.values()))
    for line, colour in (("random", RANDOM), ("closest", CLOSEST)):
        level = float(_take_logarithm(np.median(normalise_errors(first, line))))
        axes.axhline(level, color=colour, lw=1.2, ls=(0, (5, 3)), zorder=1)
    scale = format_millimetres(find_scale_m(first))
    axes.set_title(f"{first['object'][0]} (random: {scale} on average)", size=11)
    axes.set_xticks(range(len(DRAWN)), [line.capitalize() for line in DRAWN], size=9)
    axes.set_xlim(-0.6, len(DRAWN) - 0.4)
    draw_grid(axes, axis="y")


def draw_grid(axes: Axes, axis: Literal["both", "x", "y"] = "both") -> None:
    """Draw grid lines behind everything, and remove the panel's upper and right borders."""
    axes.set_axisbelow(True)
    axes.grid(axis=axis, color="#e2e8f0", lw=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def _scale_errors(axes: Axes, lowest: float) -> None:
    """Draw ticks on the shared error axis, whose values are decimal logarithms, from `lowest` upwards."""
    bottom, top = float(np.floor(lowest)), 0.5
    axes.set_ylim(bottom, top)
    decades = np.arange(bottom, 1)
    axes.set_yticks(decades, [f"{10**d:g}" for d in decades], size=9)
    minor = np.log10(np.outer(10**decades, np.arange(2, 10))).ravel()
    axes.set_yticks(minor[minor < top], minor=True)


def _draw_violin(axes: Axes, place: float, width: float, values: Floats, colour: str) -> None:
    """Draw the distribution of values (T,) on a logarithmic axis, its quartiles as a bar, its median as a dot."""
    logarithms = _take_logarithm(values)
    if np.ptp(logarithms) > 1e-9:  # a density needs different values
        parts: Any = axes.violinplot([logarithms], [place], widths=0.92 * width, showextrema=False, points=200)
        parts["bodies"][0].set(facecolor=colour, edgecolor=colour, alpha=0.45, linewidth=0.8, zorder=2)
    low, median, high = _take_logarithm(np.quantile(values, (0.25, 0.5, 0.75)))
    axes.vlines(place, low, high, color=colour, lw=4, zorder=3)
    axes.plot(place, median, "o", ms=4.5, mfc="white", mec=colour, mew=1.2, zorder=4)


def _make_handles(colours: dict[str, str]) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dashes = (0, (5, 3))
    return [
        *(Patch(fc=colour, alpha=0.6, label=f"encoder {encoder}") for encoder, colour in colours.items()),
        Line2D([], [], color=RANDOM, lw=1.2, ls=dashes, label="random pose, median"),
        Line2D([], [], color=CLOSEST, lw=1.2, ls=dashes, label="closest in the grid, median"),
        Line2D([], [], color="#4a5568", lw=4, marker="o", mfc="white", ms=6, label="quartiles and median"),
    ]


def _take_logarithm(values: Floats | np.floating[Any]) -> Floats:
    return np.asarray(np.log10(np.maximum(values, FLOOR)))


def _choose_touches(errors_m: Floats) -> list[tuple[str, int]]:
    """Return up to EACH best, median and worst touches, each with its kind, in order of increasing error."""
    order = np.argsort(errors_m, kind="stable")
    each = min(EACH, max(1, len(order) // 3))
    middle = (len(order) - each) // 2
    starts = {"best": 0, "median": middle, "worst": len(order) - each}
    found: dict[int, str] = {}
    for kind, start in starts.items():
        for number in order[start : start + each]:
            found.setdefault(int(number), kind)
    return [(kind, number) for number, kind in found.items()]


def draw_reliability(table: ExampleTable, title: str) -> Figure:
    """Draw how reliable the posteriors are, in two panels.

    The left panel shows the coverage of credible sets against their probability, with a curve for each run. The right
    panel shows the error of the refined most probable pose against the posterior's entropy, with a dot for each touch.
    """
    figure = make_figure(11.5, 5.4, constrained=True, title=title)
    coverage, entropy = figure.subplots(1, 2)
    for number, (names, run) in enumerate(table.group("object", "encoder").items()):
        colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number // len(COLOURS) % len(MARKERS)]
        levels = np.sort(run["credible_level"])
        sure = np.linspace(0, 1, 101)
        held = np.searchsorted(levels, sure, side="right") / len(levels)
        coverage.plot(100 * sure, 100 * held, color=colour, lw=1.6, label=", ".join(names))
        coverage.plot(100 * np.array(LEVELS), 100 * np.array(measure_coverage(run)), marker, color=colour, ms=6)
        errors_mm = np.maximum(1e3 * run.errors_m("reg-1", "add"), LEAST_MM)
        entropy.plot(run["entropy_nats"], errors_mm, marker, ms=4, alpha=0.6, color=colour, mec="none")
    coverage.plot([0, 100], [0, 100], color="#1a202c", lw=1, ls=(0, (5, 3)), label="ideal")
    coverage.set(xlim=(0, 100), ylim=(0, 100), aspect="equal")
    coverage.set_xlabel("probability of the credible set (%)")
    coverage.set_ylabel("touches whose true pose is in it (%)")
    entropy.set_yscale("log")
    entropy.set_xlabel("entropy of the posterior (nats)")
    entropy.set_ylabel("ADD of the most probable pose, refined (mm)")
    for axes in (coverage, entropy):
        draw_grid(axes)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    return figure


def draw_contacts(table: ExampleTable, title: str) -> Figure:
    """Draw a panel for each object: median and quartiles of the normalised error against the number of contacts.

    The lines are best-1 and reg-1 of each encoder, and kinematic of the first encoder. The error axis is logarithmic;
    a second axis on the right is in mm.
    """
    figure, panels, colours = _make_object_panels(table, title, (4.4, 3.4))
    for (name,), some in table.group("object").items():
        _draw_fused_object(panels[name], some, colours)
    _add_legend(figure, next(iter(panels.values())).get_legend_handles_labels()[0])
    return figure


def _draw_fused_object(axes: Axes, table: ExampleTable, colours: dict[str, str]) -> None:
    runs = table.group("encoder")
    first = next(iter(runs.values()))
    _draw_line(axes, first, "kinematic", "kinematic", color=KINEMATIC, marker="s")
    for (encoder,), run in runs.items():
        _draw_line(axes, run, "best-1", f"best-1, {encoder}", color=colours[encoder], marker="o")
        _draw_line(axes, run, "reg-1", f"reg-1, {encoder}", color=colours[encoder], marker="D", ls=(0, (4, 2)))
    axes.axhline(1.0, color=RANDOM, lw=1, ls=(0, (5, 3)), label="random pose, mean")
    axes.set_yscale("log")
    axes.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()
    axes.set_xticks(np.unique(first["touches"]))
    axes.set_xlabel("number of contacts")
    random_mm = 1e3 * find_scale_m(first)
    axes.set_title(f"{first['object'][0]} (random: {random_mm:.1f} mm)", size=11)
    right = axes.secondary_yaxis(
        "right", functions=(lambda v: np.multiply(v, random_mm), lambda v: np.divide(v, random_mm))
    )
    right.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    right.minorticks_off()
    right.set_ylabel("ADD (mm)")
    draw_grid(axes)
    axes.spines["right"].set_visible(True)


def _draw_line(axes: Axes, run: ExampleTable, line: str, label: str, **style: Any) -> None:
    """Draw the medians as a line and the quartiles as a band."""
    rows = summarise_lines(run, [line])
    contacts = [row["contacts"] for row in rows]
    found = [[row[f"{name}_normalised"] for name in ("q25", "median", "q75")] for row in rows]
    low, median, high = np.maximum(found, FUSION_FLOOR).T
    axes.fill_between(contacts, low, high, color=style["color"], alpha=0.2, lw=0)
    axes.plot(contacts, median, ms=5, lw=1.8, label=f"{label}: median, quartiles", **style)
