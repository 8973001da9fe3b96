"""Pictures of tasks: a track and its errors, what a next touch would show, and the residuals of a mount."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.formatting import percent
from tactile_loc.core.geometry.hand_eye import pose_errors
from tactile_loc.core.geometry.rigid import Poses, covariance_at, invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.drawing.pictures import add_panels, draw_contact_shape, make_figure
from tactile_loc.tasks.mount import FoundMount
from tactile_loc.tasks.next_touch import NextTouch, RatedApproach
from tactile_loc.tasks.tracker import TrackedPose

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIRST, LAST, LEFT_OUT = "#a0aec0", "#2b6cb0", "#e03131"
SHOWN, COLUMNS = 12, 4
BEST, OTHERS = "#2b6cb0", "#a0aec0"
TRACKED, TRUE, SURE, STARTED = "#2b6cb0", "#e03131", "#bee3f8", "#2f855a"
SHADES = {"searching": "#fefcbf", "lost": "#fed7d7", "no contact": "#edf2f7"}
DEVIATIONS = 2.0  # that are drawn about nothing
SURFACE_POINTS = 4000


@dataclass(frozen=True, eq=False)
class TrackErrors:
    """How far N tracked poses are off: the distance of their centroids (N,), metres, and the turn (N,), radians; and
    one standard deviation of each as the covariances say, root sums over the axes."""

    shift_m: NDArray[np.float64]
    turn_rad: NDArray[np.float64]
    shift_std_m: NDArray[np.float64]
    turn_std_rad: NDArray[np.float64]


def draw_track(
    found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel, gel_m: NDArray[np.float64], title: str
) -> Figure:
    """Draw the gel's path over the object, tracked and true (N, 4, 4), and the errors of N frames over time.

    `gel_m` (3,), metres, is the gel's middle in the sensor's frame. Frames without any pose are left out.
    """
    known = [k for k, one in enumerate(found) if one.T_sensor_object is not None]
    some, truth = [found[k] for k in known], T_true[known]
    figure = make_figure(11.5, 4.8, constrained=True)
    figure.suptitle(title, size=12, weight="bold")
    panels: Any = figure.subfigures(1, 2, width_ratios=[5, 6.5])
    left, right = panels
    same = PoseMetric(obj).nearest_equivalents(truth, np.array([one.T_sensor_object for one in some]))
    _draw_path(left.subplots(), some, same, obj, gel_m)
    above, below = right.subplots(2, 1, sharex=True)
    errors = measure_track(some, same, obj)
    times_s = np.array([one.time_s for one in some])
    _draw_errors(above, times_s, 1e3 * errors.shift_m, 1e3 * errors.shift_std_m, "off by (mm)")
    _draw_errors(below, times_s, np.degrees(errors.turn_rad), np.degrees(errors.turn_std_rad), "turned by (degrees)")
    for axes in (above, below):
        _shade(axes, found)
    below.set_xlabel("time (s)")
    above.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    return figure


def measure_track(found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel) -> TrackErrors:
    """Return how far tracked poses are off true ones (N, 4, 4)."""
    T = np.array([one.T_sensor_object for one in found])
    C = np.array([one.covariance for one in found])
    at_centroid = covariance_at(C, T[:, :3, :3] @ obj.mesh.centroid_m)
    variances = np.diagonal(at_centroid, axis1=1, axis2=2)
    centroid = [*obj.mesh.centroid_m, 1.0]
    shift_m = np.linalg.norm(((T - T_true) @ centroid)[:, :3], axis=1)
    turn_rad = np.linalg.norm(pose_errors(T, T_true)[:, 3:], axis=1)
    stds = (np.sqrt(variances[:, some].sum(axis=1)) for some in (slice(0, 3), slice(3, 6)))
    return TrackErrors(shift_m, turn_rad, *stds)


def _draw_path(
    axes: Any, found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel, gel_m: NDArray[np.float64]
) -> None:
    """The gel's middle in the object's frame, seen along the axis in which the path is shortest; mm."""
    tracked = np.array([one.T_sensor_object for one in found])
    paths_mm = [1e3 * transform_points(invert(T), gel_m[None])[:, 0] for T in (T_true, tracked)]
    surface_mm = 1e3 * obj.mesh.sample(SURFACE_POINTS, np.random.default_rng(0))
    x, y = sorted(np.argsort(np.ptp(paths_mm[0], axis=0))[1:])
    axes.scatter(surface_mm[:, x], surface_mm[:, y], s=1, color="#cbd5e0", lw=0)
    for path_mm, color, label, width in zip(paths_mm, (TRUE, TRACKED), ("true", "tracked"), (2.4, 1.0), strict=True):
        axes.plot(path_mm[:, x], path_mm[:, y], color=color, lw=width, label=label)
    axes.scatter(*paths_mm[0][0, [x, y]], color=STARTED, s=26, zorder=3, label="start")
    axes.set(aspect="equal", xlabel=f"{'xyz'[x]} of the object (mm)", ylabel=f"{'xyz'[y]} of the object (mm)")
    axes.set_title("the gel's middle over the object", size=10)
    axes.legend(frameon=False, fontsize=8)


def _draw_errors(
    axes: Any, times_s: NDArray[np.float64], off: NDArray[np.float64], std: NDArray[np.float64], label: str
) -> None:
    axes.fill_between(times_s, 0, DEVIATIONS * std, color=SURE, lw=0, label=f"{DEVIATIONS:g} standard deviations")
    axes.plot(times_s, off, color=TRACKED, lw=1.2, label="error")
    axes.set_ylabel(label)
    axes.set_ylim(0, 1.1 * max(np.quantile(off, 0.99), np.quantile(DEVIATIONS * std, 0.9)))
    axes.margins(x=0)
    axes.grid(lw=0.3)


def _shade(axes: Any, found: Sequence[TrackedPose]) -> None:
    """Shade the times at which the track was not certain."""
    for one, after in zip(found, [*found[1:], found[-1]], strict=True):
        if one.state in SHADES:
            axes.axvspan(one.time_s, after.time_s, color=SHADES[one.state], lw=0, alpha=0.7, zorder=1.5)


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
    panels = add_panels(left, count, columns)
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
