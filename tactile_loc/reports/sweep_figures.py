"""Pictures of a sweep: error against time with the Pareto front, and the effect of each component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.evaluation.sweep.plan import find_varying_slots, name_choices
from tactile_loc.evaluation.sweep.sweep import ChoiceMedian, Sweep
from tactile_loc.evaluation.sweep.tables import write_sweep_tables
from tactile_loc.evaluation.sweep.uncertainty import Estimate, estimate_geometric_mean
from tactile_loc.reports.evaluation_figures import COLOURS
from tactile_loc.slots.registry import SLOTS
from tactile_loc.view.pictures import group_nearby, make_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

MARKERS = "osD^vP*Xh<>"
FRONT, INK, FAINT = "#c53030", "#1a202c", "#cbd5e0"
# the first of these slots that varies determines the colours, the second the markers
BY_COLOUR = ("refiner", "encoder", "matcher", "renderer", "grid", "fuser", "sensor")
MOST_LISTED = 60
PANEL, LETTER = 7.2, 0.068  # inches: width of a panel, and of a letter in the list
LIST_LINE = 0.19  # inches: the height of a line in the list
LEAST_MM = 1e-6  # smaller errors are clipped before taking logarithms
DIGIT, LINE, MARKER = 5.6, 10.0, 7.0  # points: width of a character, height of a label, size of a point's marker
OFFSETS = [(5, 3), (5, -12), (-5, 3), (-5, -12), (0, 8), (0, -17), (5, 13), (-5, 13), (5, -22), (-5, -22), (9, -5)]


class Point(NamedTuple):
    """Error, mm, and time, ms, of a choice of components, with their intervals; see `ChoiceMedian`."""

    choices: tuple[int, ...]
    label: str
    error: Estimate
    time: Estimate

    @property
    def error_mm(self) -> float:
        """The error."""
        return self.error.value

    @property
    def time_ms(self) -> float:
        """The time per touch."""
        return self.time.value


Points = Sequence[Point]


def write_sweep(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write all results into the folder `out` and return their paths.

    The summary and the pictures show the errors of `line`, one of the protocol's LINES. A picture without data is left
    out. Raises OutputError.
    """
    written = write_sweep_tables(out, sweep, line)
    for name, draw in (("error-time", draw_error_time), ("effects", draw_effects)):
        figure = draw(sweep, line)
        path = out / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)  # an older sweep may have drawn it
        else:
            written.append(save_figure(path, figure))
    return written


def list_points(sweep: Sweep, line: str, noise: str) -> list[Point]:
    """Return a point for each combination of components that succeeded on all objects, in the plan's order.

    Errors and times are geometric means over the objects.
    """
    found: dict[tuple[int, ...], list[ChoiceMedian]] = {}
    for one in sweep.compute_medians(line):
        if one.noise == noise:
            found.setdefault(one.choices, []).append(one)
    return [
        Point(
            choices,
            some[0].label,
            estimate_geometric_mean([one.error.values for one in some]),
            estimate_geometric_mean([one.time.values for one in some]),
        )
        for choices, some in found.items()
        if all(np.isfinite(one.error_mm + one.time_ms) for one in some)
    ]


def find_pareto_front(found: Points) -> list[Point]:
    """Return the points that no other point beats in both error and time, in order of increasing time."""
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (p.time_ms, p.error_mm)):
        if not front or point.error_mm < front[-1].error_mm:
            front.append(point)
    return front


def compute_effects(sweep: Sweep, line: str) -> dict[str, dict[str, Floats]]:
    """Return natural logarithms (K,) of error ratios for each choice of each slot that varies.

    A ratio divides the error with this choice by the geometric mean over all choices of the slot, all else being equal.
    K is the number of settings of all else (objects, noises, other slots) for which no choice failed.
    """
    medians, labels = sweep.compute_medians(line), name_choices(sweep.plan)
    found = {}
    for slot in find_varying_slots(sweep.plan):
        place = SLOTS.index(slot)
        logs: dict[Any, dict[int, float]] = {}
        for one in medians:
            others = one.object, one.noise, one.choices[:place], one.choices[place + 1 :]
            logs.setdefault(others, {})[one.choices[place]] = np.log(np.maximum(one.error_mm, LEAST_MM))
        rows = np.array([[choices[k] for k in sorted(choices)] for _, choices in sorted(logs.items())])
        rows = rows[np.isfinite(rows).all(axis=1)]
        ratios = rows - rows.mean(axis=1, keepdims=True)
        found[slot] = {label: ratios[:, k] for k, label in enumerate(labels[slot])}
    return found


def draw_error_time(sweep: Sweep, line: str) -> Figure | None:
    """Draw a panel for each noise, with a numbered point for each combination of components, and a list of the names.

    Error and time are medians over touches, then geometric means over objects. Lines show their 95 % intervals. Names
    on the Pareto front are bold.
    Returns None if no combination succeeded on all objects.
    """
    panels = {noise: found for noise in sweep.plan.noises if (found := list_points(sweep, line, noise))}
    if not panels:
        return None
    listed = min(MOST_LISTED, max(map(len, panels.values())))
    height = max(4.6, 1.3 + LIST_LINE * listed)
    aside = 1.0 + LETTER * max(22 + len(point.label) for found in panels.values() for point in found)
    objects = [show_name(one.path.rpartition("/")[2]) for one in sweep.plan.objects]
    among = "" if len(objects) == 1 else "geometric mean over "
    title = f"Error against time: {among}{', '.join(objects)}; {sweep.plan.count} touches each"
    figure = make_figure(PANEL + aside, height * len(panels) + 0.6, constrained=True, title=title)
    axes: NDArray[Any] = figure.subplots(len(panels), 2, squeeze=False, width_ratios=[PANEL, aside])
    style = _Style(sweep)
    for (noise, found), (left, right) in zip(panels.items(), axes, strict=True):
        front = find_pareto_front(found)
        numbers = {p.choices: i + 1 for i, p in enumerate(sorted(found, key=lambda p: (p.error_mm, p.time_ms)))}
        _draw_points(left, found, front, numbers, style)
        left.set_title(f"noise: {noise}", size=11)
        left.set_ylabel(f"median error of {line} (mm)")
        left.set_xlabel(f"median time of {line} per touch (ms)")
        _write_list(right, found, front, numbers)
    figure.legend(handles=style.make_handles(), loc="outside lower left", ncols=6, frameon=False, fontsize=9)
    return figure


def draw_effects(sweep: Sweep, line: str) -> Figure | None:
    """Draw a panel for each slot that varies: the factor by which each choice changes the error.

    The titles of slots state whether all else is equal, or what else changes by its nature.

    Each dot is one setting of all else, and the line is the geometric mean of the dots. Returns None if no slot varies,
    or if every setting has a failed choice.
    """
    found = {slot: ratios for slot, ratios in compute_effects(sweep, line).items() if min(map(len, ratios.values()))}
    if not found:
        return None
    heights = [0.62 + 0.42 * len(ratios) for ratios in found.values()]
    changed = sweep.find_changed()
    title = "Effect of each component (left is better)"
    figure = make_figure(9.5, sum(heights) + 1.4, constrained=True, title=title)
    panels: NDArray[Any] = figure.subplots(len(found), 1, squeeze=False, sharex=True, height_ratios=heights)
    for axes, (slot, ratios) in zip(panels.flat, found.items(), strict=True):
        also = f"; also changes the {' and the '.join(changed[slot])}" if slot in changed else ", all else equal"
        _draw_effect(axes, f"{slot}{also}", ratios)
    _scale_ratios(panels[-1, 0], np.concatenate([r for ratios in found.values() for r in ratios.values()]))
    panels[-1, 0].set_xlabel(f"error of {line} with this choice / geometric mean over the slot's choices")
    return figure


class _Style:
    """A colour for each choice of one slot, and a marker for each choice of another slot."""

    def __init__(self, sweep: Sweep) -> None:
        slots = [slot for slot in BY_COLOUR if slot in find_varying_slots(sweep.plan)]
        self._labels = name_choices(sweep.plan)
        self._places = {slot: list(sweep.plan.slots).index(slot) for slot in slots}
        self._colour, self._marker = [*slots, None, None][:2]

    def choose(self, point: Point) -> dict[str, Any]:
        """Return the colour and the marker of a point."""
        colour = COLOURS[self._index(point, self._colour) % len(COLOURS)]
        return {"color": colour, "marker": MARKERS[self._index(point, self._marker) % len(MARKERS)]}

    def make_handles(self) -> list[Any]:
        """Return the entries of the legend."""
        from matplotlib.lines import Line2D

        shown: list[Any] = [
            Line2D([], [], color=FRONT, lw=1.4, label="Pareto front"),
            Line2D([], [], color="#718096", lw=1.0, alpha=0.6, label="95 % interval"),
        ]
        for slot, by_colour in ((self._colour, True), (self._marker, False)):
            for i, name in enumerate(self._labels[slot] if slot else []):
                colour = COLOURS[i % len(COLOURS)] if by_colour else "#718096"
                marker = "o" if by_colour else MARKERS[i % len(MARKERS)]
                shown.append(Line2D([], [], color=colour, marker=marker, ls="", label=f"{slot} {name}"))
        return shown

    def _index(self, point: Point, slot: str | None) -> int:
        return point.choices[self._places[slot]] if slot else 0


def _draw_points(
    axes: Axes, found: Points, front: Points, numbers: Mapping[tuple[int, ...], int], style: _Style
) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.07)
    axes.step([p.time_ms for p in front], [p.error_mm for p in front], where="post", color=FRONT, lw=1.4, zorder=2)
    for point in found:
        colour = style.choose(point)["color"]
        for low, high, draw, other in (
            (*point.error[1:], axes.vlines, point.time_ms),
            (*point.time[1:], axes.hlines, point.error_mm),
        ):
            if np.isfinite(low):
                draw(other, low, high, color=colour, lw=1.0, alpha=0.45, zorder=2)
        axes.plot(point.time_ms, point.error_mm, ms=7, ls="", mec="white", mew=0.7, zorder=3, **style.choose(point))
    for label in place_labels(_locate_points(axes, found), [numbers[point.choices] for point in found]):
        at, best = found[label.members[0]], any(found[i] in front for i in label.members)
        axes.annotate(
            label.text,
            (at.time_ms, at.error_mm),
            label.offset_pt,
            textcoords="offset points",
            ha=label.alignment,
            size=8,
            color=INK,
            weight="bold" if best else "normal",
            zorder=4,
        )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
        axis.set_tick_params(which="both", labelsize=9)
    axes.set_axisbelow(True)
    axes.grid(which="both", color="#edf2f7", lw=0.8)
    axes.spines[["top", "right"]].set_visible(False)


def _write_list(axes: Axes, found: Points, front: Points, numbers: Mapping[tuple[int, ...], int]) -> None:
    """Write the names of the numbered points, the best first."""
    axes.set_axis_off()
    ordered = sorted(found, key=lambda p: (p not in front, numbers[p.choices]))
    rows = sorted(ordered[:MOST_LISTED], key=lambda p: numbers[p.choices])
    for place, point in enumerate(rows):
        text = f"{numbers[point.choices]:>3}  {point.label}  ({point.error_mm:.3g} mm, {point.time_ms:.3g} ms)"
        y = 1 - (place + 0.5) / max(len(rows), 20)
        axes.text(
            0, y, text, transform=axes.transAxes, size=8, va="center", weight="bold" if point in front else "normal"
        )
    if len(ordered) > len(rows):
        axes.set_title(f"the Pareto front and the next best, {len(rows)} of {len(ordered)}", size=9, loc="left")


def _locate_points(axes: Axes, found: Points) -> Floats:
    """Return the approximate positions (N, 2) of points in a panel, in 1/72 inch, before margins are laid out."""
    figure = axes.get_figure()
    height = (figure.get_figheight() if figure else 1.0) / axes.get_gridspec().nrows  # type: ignore[union-attr]
    logs = np.log([(p.time_ms, p.error_mm) for p in found])
    share = (logs - logs.min(axis=0)) / np.maximum(np.ptp(logs, axis=0), 1e-9)
    return share * [72 * 0.8 * PANEL, 72 * (height - 1.6)]


def _draw_effect(axes: Axes, title: str, ratios: Mapping[str, Floats]) -> None:
    """Draw the choices of a slot from top to bottom, on an axis of natural logarithms of ratios."""
    axes.axvline(0, color=FAINT, lw=1.2, zorder=1)
    for place, (values, colour) in enumerate(zip(ratios.values(), COLOURS * len(ratios), strict=False)):
        spread = np.linspace(-0.22, 0.22, len(values)) if len(values) > 1 else np.zeros(1)
        axes.plot(values, place + spread, "o", ms=3.5, color=colour, alpha=0.45, mew=0, zorder=2)
        mean = float(values.mean())
        axes.vlines(mean, place - 0.34, place + 0.34, color=INK, lw=2.2, zorder=3)
        axes.text(1.01, place, f"x {np.exp(mean):.2f}", transform=axes.get_yaxis_transform(), size=9, va="center")
    axes.set_yticks(range(len(ratios)), list(ratios), size=9)
    axes.set_ylim(len(ratios) - 0.45, -0.55)
    axes.set_title(title, size=11, loc="left", weight="bold")
    axes.grid(axis="x", color="#edf2f7", lw=0.8)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _scale_ratios(axes: Axes, values: Floats) -> None:
    """Label an axis of natural logarithms with ratios."""
    reach = max(0.1, 1.08 * float(np.abs(values).max()))
    tried = (1, 1.5, 2, 3, 5, 10, 20, 50, 100, 1000, 10000) if reach > 1 else (1, 1.1, 1.25, 1.5, 2)
    up = [t for t in tried if np.log(t) <= reach]
    while len(up) > 5:
        up = [up[0], *up[2::2]]
    shown = sorted({1 / t for t in up} | set(up))
    axes.set_xticks(np.log(shown), [f"{r:.3g}" if r >= 1 else f"{r:.2g}" for r in shown], size=9)
    axes.set_xlim(-reach, reach)


class NumberLabel(NamedTuple):
    """One label for nearly coincident points, which have the indices `members`.

    The label is placed at `offset_pt`, in 1/72 inch, from the first point. `alignment` is the side of the text there,
    as matplotlib calls it: left if the first number of the offset is positive, right if it is negative.
    """

    text: str
    members: tuple[int, ...]
    offset_pt: tuple[float, float]
    alignment: str


def place_labels(places_pt: Floats, numbers: Sequence[int]) -> list[NumberLabel]:
    """Return labels for points (N, 2), in 1/72 inch, with these numbers.

    Nearly coincident points share a label. Each label takes the first of OFFSETS at which it covers nothing, or the
    first of all if there is none.
    """
    markers = [_make_box(x, y - MARKER / 2, MARKER, MARKER, 0) for x, y in places_pt]
    taken: list[Bbox] = []
    labels = []
    for members in map(tuple, group_nearby(places_pt, MARKER / 2, np.inf)):
        text = write_ranges([numbers[i] for i in members])
        x, y = places_pt[members[0]]
        boxes = [_make_box(x + dx, y + dy, DIGIT * len(text), LINE, dx) for dx, dy in OFFSETS]
        own = set(members)
        others = [*taken, *(box for i, box in enumerate(markers) if i not in own)]
        free = [k for k, box in enumerate(boxes) if not any(box.fully_overlaps(other) for other in others)]
        chosen = free[0] if free else 0
        taken.append(boxes[chosen])
        side = OFFSETS[chosen][0]
        alignment = "center" if side == 0 else "left" if side > 0 else "right"
        labels.append(NumberLabel(text, members, OFFSETS[chosen], alignment))
    return labels


def write_ranges(numbers: Sequence[int]) -> str:
    """Write whole numbers in ascending order, with ranges: 1, 3-5."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    texts = [", ".join(map(str, run)) if len(run) < 3 else f"{run[0]}-{run[-1]}" for run in runs]
    return ", ".join(texts)


def _make_box(x: float, y: float, width: float, height: float, side: float) -> Bbox:
    """Make a box to the right of x if `side` is positive, to the left if negative, or centred at x if zero."""
    from matplotlib.transforms import Bbox

    left = x - width * (0.5 if side == 0 else 0.0 if side > 0 else 1.0)
    return Bbox.from_bounds(left, y, width, height)
