"""A picture of what each further contact is worth: error against number of contacts, as in the paper."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.drawing.pictures import make_figure
from tactile_loc.evaluation.contact_tables import ContactRun
from tactile_loc.evaluation.figures import COLOURS, RANDOM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR = 1e-3  # errors below this share of a random pose's are drawn here: the axis is logarithmic
KINEMATIC = "#718096"
TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)


def draw_contacts(runs: Sequence[ContactRun], title: str) -> Figure:
    """Draw a panel for each object: median and quartiles of the normalised error against the number of contacts.

    Best-1 of each encoder, and kinematic, of the first one; logarithmic, with mm on the right.
    """
    objects, encoders = (
        list(dict.fromkeys(names)) for names in zip(*((r.object, r.encoder) for r in runs), strict=True)
    )
    colours = dict(zip(encoders, COLOURS * (1 + len(encoders) // len(COLOURS)), strict=False))
    columns = min(3, len(objects))
    rows = -(-len(objects) // columns)
    figure = make_figure(max(6.4, 4.4 * columns), 3.4 * rows + 1.1, constrained=True)
    figure.suptitle(textwrap.fill(title, int(8.5 * figure.get_figwidth())), size=13, weight="bold")
    panels: NDArray[Any] = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, name in zip(panels.flat, objects, strict=False):
        _draw_object(axes, [run for run in runs if run.object == name], colours)
    for axes in panels.flat[len(objects) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("ADD / mean ADD of a random pose")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    columns = min(len(labels), int(figure.get_figwidth() / 2))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _draw_object(axes: Axes, runs: Sequence[ContactRun], colours: dict[str, str]) -> None:
    _draw_line(axes, runs[0], "kinematic", KINEMATIC, "s", "kinematic")
    for run in runs:
        _draw_line(axes, run, "best-1", colours[run.encoder], "o", f"best-1, {run.encoder}")
    axes.axhline(1.0, color=RANDOM, lw=1, ls=(0, (5, 3)), label="random pose, mean")
    axes.set_yscale("log")
    axes.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()
    axes.set_xticks(runs[0].evaluation.contacts)
    axes.set_xlabel("number of contacts")
    random_mm = 1e3 * runs[0].evaluation.scale_m()
    axes.set_title(f"{runs[0].object} (random: {random_mm:.1f} mm)", size=11)
    right = axes.secondary_yaxis("right", functions=_scaling(random_mm))
    right.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    right.minorticks_off()
    right.set_ylabel("ADD (mm)")
    axes.grid(color="#e2e8f0", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top"]].set_visible(False)


def _scaling(factor: float) -> Any:
    """Multiplication by a factor, and its inverse, as an axis takes them."""

    def there(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(values) * factor

    def back(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(values) / factor

    return there, back


def _draw_line(axes: Axes, run: ContactRun, line: str, colour: str, marker: str, label: str) -> None:
    """Medians as a line, the quartiles as a band."""
    contacts = run.evaluation.contacts
    found = [run.statistics(line, n, normalised=True) for n in contacts]
    low, median, high = np.maximum([(s.q25, s.median, s.q75) for s in found], FLOOR).T
    axes.fill_between(contacts, low, high, color=colour, alpha=0.2, lw=0)
    axes.plot(contacts, median, marker=marker, ms=5, lw=1.8, color=colour, label=f"{label}: median, quartiles")
