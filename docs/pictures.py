#!/usr/bin/env python3
"""Draw pictures of the guide (method, conventions, tracking, next touch, test object) from results of the code."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc_benchmark.sliding_touches import SlidingTouches
from tactile_loc_test_object.picture import draw_places

from tactile_loc.core.geometry.lie import compute_pose_errors, move_covariance
from tactile_loc.core.geometry.rigid import Poses, invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.formatting import format_millimetres, format_percent
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.planning.approaches import draw_approaches
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.slots.registry import registry
from tactile_loc.tracking.pose_modes import MOST_MODES
from tactile_loc.tracking.tracked_pose import TrackedPose
from tactile_loc.tracking.tracker import Tracker
from tactile_loc.view.drawn_scene import DrawnScene, DrawnSensor
from tactile_loc.view.one_versus_several import draw_one_versus_several, save_picture
from tactile_loc.view.palette import DARK, LIGHT
from tactile_loc.view.pictures import (
    compute_extent_mm,
    draw_contact_shape,
    draw_outline,
    draw_touches,
    make_figure,
    save_figure,
)
from tactile_loc.view.pose_panel import draw_pose
from tactile_loc.view.tasks import draw_next_touch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGES = Path(__file__).parent / "images"
OBJECT = "hook"
SPACING_MM = 4.51  # about 10 000 poses
NEIGHBOURS = 5
SHOWN = 4  # number of shown poses, the most probable ones
TOUCH_SEED = 3
SLIDE_FRAMES, SLIDE_SEED, SLIDE_LIFT = 500, 5, (250, 300)  # SLIDE_LIFT: the range of frames without contact
NEXT_SEED = 5
GEL_SEED, GEL_PRESS_M = 1, 6e-4
TRACKED, TRUE, SURE, STARTED = "#2b6cb0", "#e03131", "#bee3f8", "#2f855a"
SHADES = {
    Verdict.AMBIGUOUS: "#fefcbf", Verdict.POOR_FIT: "#fed7d7", Verdict.NOT_FOUND: "#fed7d7",
    Verdict.NO_CONTACT: "#edf2f7",
}  # fmt: skip
DEVIATIONS = 2.0  # drawn range about zero, in standard deviations
SURFACE_POINTS = 4000


def draw_rendering(localizer: Localizer) -> Figure:
    """Draw a pose on the sensor, the depths that the sensor's camera sees, and the contact shape of these depths."""
    geometry, scene = localizer.sensor.geometry, localizer.scene
    T = _touch(localizer).T_sensor_object
    z_m = scene.renderer.render(scene.object.mesh, T[None], geometry)[0]
    figure = make_figure(13.6, 4.5)
    left, middle, right = figure.subfigures(1, 3, width_ratios=[5, 4.3, 4.3])
    left.suptitle("the object in contact", size=10, y=0.93)
    drawn = DrawnScene(scene.object.mesh, (DrawnSensor(geometry),), T[None])
    draw_pose(left.add_axes((0.02, 0.02, 0.96, 0.86)), drawn)
    extent = compute_extent_mm(geometry)
    views = (
        (middle, "camera depth z(u) beyond the surface (mm)", np.where(np.isfinite(z_m), z_m, np.nan)),
        (right, "contact shape c(u): depth from full penetration (mm)", None),
    )
    for panel, name, depth_m in views:
        axes = panel.add_axes((0.14, 0.1, 0.76, 0.78))
        if depth_m is None:
            image = draw_contact_shape(axes, scene.contact_shape(T, geometry.max_depth_m), geometry)
        else:
            image = axes.imshow(1e3 * (depth_m - geometry.standoff_m), cmap="cividis", extent=extent, origin="upper")
            axes.set_facecolor("#eceff1")
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
        panel.colorbar(image, ax=axes, fraction=0.046)
        axes.set_title(name, size=10)
    return figure


def draw_neighbours(localizer: Localizer) -> Figure:
    """Draw the contact shapes of a grid pose and of the grid poses nearest to it, with the distances."""
    grid, geometry = localizer.model.grid, localizer.sensor.geometry
    own = int(grid.nearest(_touch(localizer).T_sensor_object[None])[1][0])
    distances_m = np.linalg.norm(grid.phi - grid.phi[own], axis=1)
    nearest = np.argsort(distances_m)[: NEIGHBOURS + 1]
    figure = make_figure(2.6 * len(nearest), 3.0, constrained=True)
    for axes, i in zip(figure.subplots(1, len(nearest)), nearest, strict=True):
        shape = localizer.scene.contact_shape(grid.T_sensor_object[i], geometry.max_depth_m)
        draw_contact_shape(axes, shape, geometry)
        axes.set_title(
            "a pose of the grid" if i == own else f"{format_millimetres(float(distances_m[i]))} away", size=10
        )
        axes.set_xlabel("x (mm)", size=8)
    figure.suptitle(f"neighbours in a grid of {len(grid)} poses, root mean square distance of the surface", size=12)
    return figure


def draw_noise(localizer: Localizer, seed: int = 0) -> Figure:
    """Draw five touches of a localizer's object. Each row has the same touches with another level of noise.

    Titles give the press depth that the sensor measures, in mm. If noise removes the contact, another touch is drawn,
    and the columns differ.
    """
    touches = [
        replace(touch, name=f"{level}, {format_millimetres(touch.press_depth_m)}")
        for level in NOISE
        for touch in localizer.simulate(5, seed, noise=level)
    ]
    return draw_touches(touches, f"{localizer.object.name} on {localizer.config.sensor.name}: touch noise")


def draw_matching(localizers: dict[str, Localizer]) -> Figure:
    """Draw a noisy touch and, for each encoder, the contact shapes of the most probable poses, and the posterior."""
    first = next(iter(localizers.values()))
    touch = _touch(first)
    figure = make_figure(3.0 * (SHOWN + 2), 3.0 * len(localizers) + 0.5, constrained=True)
    panels: NDArray[Any] = figure.subplots(len(localizers), SHOWN + 2, squeeze=False)
    for row, (name, localizer) in zip(panels, localizers.items(), strict=True):
        posterior = localizer.posterior(touch)
        draw_contact_shape(row[0], touch.contact_shape, touch.geometry)
        row[0].set_title("touch, strong noise", size=10)
        row[0].set_ylabel(f"{name}\ny (mm)", size=11)
        metric, T_true = posterior.grid.metric, touch.T_sensor_object
        for axes, index in zip(row[1:], posterior.top(SHOWN), strict=False):
            pose = posterior.grid.T_sensor_object[index]
            shape: ContactShape = localizer.scene.contact_shape(pose, touch.press_depth_m)
            draw_contact_shape(axes, shape, touch.geometry)
            draw_outline(axes, touch)
            off_m = float(metric.symmetric_distance(pose[None], T_true[None])[0])
            axes.set_title(
                f"{format_percent(float(posterior.probabilities[index]))}, {format_millimetres(off_m)} off", size=10
            )
        _draw_posterior(row[-1], posterior, T_true)
    figure.suptitle("most probable poses (red: observed outline), and the posterior over all poses", size=12)
    return figure


def _draw_posterior(axes: Any, posterior: Any, T_true: NDArray[np.float64]) -> None:
    """Draw each pose's place as a dot. The dot's area is the probability, and its colour is the yaw."""
    T = posterior.grid.T_sensor_object
    likely = posterior.top(300)
    centroid = posterior.grid.metric.object.mesh.centroid_m
    at = 1e3 * (T[likely, :2, :3] @ centroid + T[likely, :2, 3])
    yaw = np.degrees(np.arctan2(T[likely, 1, 0], T[likely, 0, 0]))
    dots = axes.scatter(
        *at.T, s=2 + 600 * posterior.probabilities[likely], c=yaw, cmap="twilight", vmin=-180, vmax=180, alpha=0.8
    )
    true_at = 1e3 * (T_true[:2, :3] @ centroid + T_true[:2, 3])
    axes.plot(*true_at, "x", color="#e03131", ms=11, mew=2.2)
    reach = 1e3 * (T[:, :2, :3] @ centroid + T[:, :2, 3])
    (left, top), (right, bottom) = reach.min(axis=0), reach.max(axis=0)
    axes.set(aspect="equal", xlabel="x of the centroid (mm)", ylabel="y (mm)", xlim=(left, right), ylim=(bottom, top))
    axes.set_title("area: probability; cross: truth", size=10)
    axes.figure.colorbar(dots, ax=axes, fraction=0.046, label="yaw (°)")


def draw_slide(localizer: Localizer) -> Figure:
    """Draw the tracking of a slide over the object, with a lift in the middle."""
    renderer = registry().create("renderer", "zbuffer", {})
    source = RobotTouches(
        localizer.object, localizer.sensor.geometry, renderer, noise=NOISE["mild"], sensor_std_m=1e-4,
        sensor_std_rad=np.radians(0.1),
    )  # fmt: skip
    frames = SlidingTouches(source).draw_example(SLIDE_FRAMES, np.random.default_rng(SLIDE_SEED))
    tracker, found = Tracker(localizer), []
    tracker.start(frames[0].T_base_sensor @ frames[0].T_sensor_object, np.diag([3e-7] * 3 + [1e-4] * 3))
    for k, frame in enumerate(frames):
        touch = None if SLIDE_LIFT[0] <= k < SLIDE_LIFT[1] else frame.touch
        found.append(tracker.update(frame.time_s, touch, frame.T_base_sensor))
    gel_m = np.array([0.0, 0.0, localizer.sensor.geometry.standoff_m])
    truth = np.array([frame.T_sensor_object for frame in frames])
    title = f"{localizer.object.name}: a slide of {frames[-1].time_s:.0f} seconds, tracked"
    return draw_track(found, truth, localizer.object, gel_m, title)


@dataclass(frozen=True, eq=False)
class TrackErrors:
    """Errors of N tracked poses: distances of the centroids (N,), metres, and angles (N,), radians.

    `shift_std_m` and `turn_std_rad` (N,) are the standard deviations of both from the covariances: the root of the
    variances' sum over the axes.
    """

    shift_m: NDArray[np.float64]
    turn_rad: NDArray[np.float64]
    shift_std_m: NDArray[np.float64]
    turn_std_rad: NDArray[np.float64]


def draw_track(
    found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel, gel_m: NDArray[np.float64], title: str
) -> Figure:
    """Draw the gel's path over the object, tracked and true, and the errors of N frames over time.

    `T_true` (N, 4, 4) are the true poses. `gel_m` (3,), metres, is the gel's middle in the sensor's frame. Frames
    without a pose are left out.
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
    _draw_errors(above, times_s, 1e3 * errors.shift_m, 1e3 * errors.shift_std_m, "position error (mm)")
    turn_deg, turn_std_deg = np.degrees(errors.turn_rad), np.degrees(errors.turn_std_rad)
    _draw_errors(below, times_s, turn_deg, turn_std_deg, "rotation error (degrees)")
    for axes in (above, below):
        _shade(axes, found)
    below.set_xlabel("time (s)")
    above.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    return figure


def measure_track(found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel) -> TrackErrors:
    """Return the errors of tracked poses, given the true poses (N, 4, 4)."""
    T = np.array([one.T_sensor_object for one in found])
    C = np.array([one.covariance for one in found])
    at_centroid = move_covariance(C, T[:, :3, :3] @ obj.mesh.centroid_m)
    variances = np.diagonal(at_centroid, axis1=1, axis2=2)
    centroid = [*obj.mesh.centroid_m, 1.0]
    shift_m = np.linalg.norm(((T - T_true) @ centroid)[:, :3], axis=1)
    turn_rad = np.linalg.norm(compute_pose_errors(T, T_true)[:, 3:], axis=1)
    stds = (np.sqrt(variances[:, some].sum(axis=1)) for some in (slice(0, 3), slice(3, 6)))
    return TrackErrors(shift_m, turn_rad, *stds)


def _draw_path(
    axes: Any, found: Sequence[TrackedPose], T_true: Poses, obj: ObjectModel, gel_m: NDArray[np.float64]
) -> None:
    """Draw the path of the gel's middle in the object's frame, mm, seen along the axis with the shortest extent."""
    tracked = np.array([one.T_sensor_object for one in found])
    paths_mm = [1e3 * transform_points(invert(T), gel_m[None])[:, 0] for T in (T_true, tracked)]
    surface_mm = 1e3 * obj.mesh.sample(SURFACE_POINTS, np.random.default_rng(0))
    x, y = sorted(np.argsort(np.ptp(paths_mm[0], axis=0))[1:])
    axes.scatter(surface_mm[:, x], surface_mm[:, y], s=1, color="#cbd5e0", lw=0)
    for path_mm, color, label, width in zip(paths_mm, (TRUE, TRACKED), ("true", "tracked"), (2.4, 1.0), strict=True):
        axes.plot(path_mm[:, x], path_mm[:, y], color=color, lw=width, label=label)
    axes.scatter(*paths_mm[0][0, [x, y]], color=STARTED, s=26, zorder=3, label="start")
    axes.set(aspect="equal", xlabel=f"{'xyz'[x]} of the object (mm)", ylabel=f"{'xyz'[y]} of the object (mm)")
    axes.set_title("path of the gel centre on the object", size=10)
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
        if one.verdict in SHADES:
            axes.axvspan(one.time_s, after.time_s, color=SHADES[one.verdict], lw=0, alpha=0.7, zorder=1.5)


def draw_next(localizer: Localizer) -> Figure:
    """Draw the contact shapes, at the best of 100 approaches, of the poses that are possible after one touch."""
    touch = localizer.simulate(1, NEXT_SEED)[0]
    found = localizer.localize(replace(touch, T_base_sensor=invert(np.asarray(touch.T_sensor_object))), top=MOST_MODES)
    rng = np.random.default_rng(NEXT_SEED)
    chosen = choose_next_touch(found, draw_approaches(localizer.object, localizer.scene.geometry, 100, 0.8, rng))
    return draw_next_touch(chosen, f"{localizer.object.name}: {len(chosen.modes.probabilities)} possible poses")


def draw_gel(localizer: Localizer) -> Figure:
    """Draw one press on a rigid gel and on the localizer's elastic gel, where the latter touches, and a profile."""
    (touch,) = localizer.simulate(1, seed=GEL_SEED, press_depth_m=GEL_PRESS_M)
    scene = localizer.scene.match_touch(touch)
    rigid = ContactShape(scene.render_contact_depths(np.asarray(touch.T_sensor_object)[None])[0], GEL_PRESS_M)
    figure = make_figure(13.5, 4.2, constrained=True)
    panels: Any = figure.subplots(1, 3, width_ratios=[1, 1, 1.1])
    for axes, shape, title in zip(panels, (rigid, touch.contact_shape), ("rigid gel", "elastic gel"), strict=False):
        draw_contact_shape(axes, shape, touch.geometry)
        axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    x_mm, y_mm = (1e3 * slopes for slopes in touch.geometry.pixel_slopes)
    touching = touch.touching_shape.contact
    panels[1].contour(x_mm, y_mm, touching.astype(float), levels=[0.5], colors=TRUE, linewidths=1.2)
    row = int(np.unravel_index(touch.contact_shape.depth_m.argmin(), touch.contact_shape.depth_m.shape)[0])
    for axes in panels[:2]:
        axes.axhline(y_mm[row], color="#4a5568", linewidth=0.8, linestyle=":")
    profile = panels[2]
    surfaces = {"rigid gel": (rigid, TRACKED), "elastic gel": (touch.contact_shape, STARTED)}
    for label, (shape, colour) in surfaces.items():
        profile.plot(x_mm, 1e3 * (shape.depth_m[row] - GEL_PRESS_M), color=colour, label=label)
    here = touching[row]
    height_mm = np.where(here, 1e3 * (touch.contact_shape.depth_m[row] - GEL_PRESS_M), np.nan)
    profile.plot(x_mm, height_mm, color=TRUE, linewidth=3, alpha=0.6, label="where it touches the object")
    profile.set(xlabel="x (mm)", ylabel="gel surface (mm)", title="along the dotted line")
    profile.legend(loc="lower right", fontsize=8)
    return figure


def _touch(localizer: Localizer) -> Touch:
    return localizer.simulate(1, TOUCH_SEED, noise="strong")[0]


def save_demo(out: Path) -> None:
    """Draw the demo of `tactile-loc run` for light and for dark pages."""
    localizer = Localizer.create(OBJECT)
    observations = [(localizer, touch) for touch in localizer.simulate_together(3, 0)]
    alone, together = localize_together(observations[:1]), localize_together(observations)
    title = f"{together.verdict}: {localizer.object.name} on {localizer.config.sensor.name}"
    for name, palette in (("demo", LIGHT), ("demo-dark", DARK)):
        print(save_picture(out / f"{name}.png", draw_one_versus_several(alone, together, title, palette)))


def tell_stories(out: Path) -> None:
    """Run the code of the page of worked examples in the folder of pictures; this code draws the page's pictures."""
    with chdir(out):
        page = IMAGES.parent / "stories.md"
        for code in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE):
            exec(compile(code, page.name, "exec"), {})


def main() -> None:
    """Draw all pictures. The learned encoder is trained unless the store has it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=IMAGES)
    out = parser.parse_args().out
    grid = {"name": "face", "spacing_mm": SPACING_MM}
    localizers = {name: Localizer.create(OBJECT, grid=grid, encoder=name) for name in ("pixel", "moco")}
    plain = localizers["pixel"]
    figures = {
        "rendering": draw_rendering(plain),
        "neighbours": draw_neighbours(plain),
        "noise": draw_noise(plain),
        "matching": draw_matching(localizers),
        "track": draw_slide(Localizer.create(OBJECT, sensor="gelsight-mini")),
        "test-object": draw_places(),
        "gel": draw_gel(Localizer.create("pin", sensor={"name": "gelsight-mini", "gel": "layer"})),
        "next-touch": draw_next(Localizer.create("head", sensor="gelsight-mini", temperature=0.05)),
    }
    for name, figure in figures.items():
        print(save_figure(out / f"{name}.png", figure))
    save_demo(out)
    tell_stories(out.absolute())


if __name__ == "__main__":
    main()
