"""Picture of the reason to touch again: the poses that explain one touch, beside the pose that explains all touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_loc.core.geometry.rigid import Float32, Floats
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.formatting import format_millimetres
from tactile_loc.locate.result.localization import Localization
from tactile_loc.view.drawn_scene import EDGE, GEL, HOUSING, STEEL, TRUTH, DrawnScene, DrawnSensor, move_triangles
from tactile_loc.view.palette import LIGHT
from tactile_loc.view.pictures import draw_contact_shape, draw_outline, make_figure
from tactile_loc.view.pose_panel import SUPERSAMPLE, Canvas, choose_view, fit_bounds
from tactile_loc.view.raytracing import average, unmultiply

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Image = Float32  # (H, W, 4): colours, 0 to 1, multiplied by opacity, and opacity

SHAPE = 0.21  # width of a drawn contact shape, in widths of its side of the figure
MOST_GHOSTS, MOST_SHAPES = 6, 4  # largest numbers of drawn poses of the first touch, and of drawn contact shapes
PIXELS = 480
GHOST, SEEN_THROUGH, TRUTH_OPACITY = 0.45, 0.5, 0.95  # opacity of the first touch's poses, other sensors and lines
EDGE_STEP = 0.04  # depth step that counts as an edge, in sizes of the object
WIDTH_IN, HEIGHT_IN = 12.0, 6.8
LABEL = 0.55  # place of a sensor's label: 0 for the gel's middle, 1 for its corner
MARGIN = 0.05  # free space around the drawn solids, in sizes of the picture


def draw_one_versus_several(alone: Localization, together: Localization, title: str) -> Figure:
    """Draw the first touch and the poses that explain it, beside all touches and the first pose that explains them.

    `alone` is the result of the first touch of `together`. Lines show the true pose if it is known.
    """
    figure = make_figure(WIDTH_IN, HEIGHT_IN)
    figure.suptitle(title, size=15, weight="bold", x=0.5, y=0.975)
    panels: Any = figure.subfigures(1, 2)
    left, right = panels
    ghosts = [h.T_sensor_object for h in alone.equal_explanations[:MOST_GHOSTS]]
    view = _SharedView.of(DrawnScene.of(together), ghosts)
    _draw_side(left, alone, "the first touch alone")
    _draw_image(left, view, view.draw_ghosts(ghosts))
    _draw_side(right, together, f"{len(together.touches)} touches together")
    axes = _draw_image(right, view, view.draw_touched())
    view.label_sensors(axes)
    _draw_legend(left, {"poses that explain the touch": STEEL}, alone)
    _draw_legend(right, {"first pose": STEEL}, together)
    return figure


def _draw_side(panel: SubFigure, found: Localization, of: str) -> None:
    """Write what the touches show, and draw their contact shapes."""
    errors_m = found.measure_errors_m(found.object)
    off = "" if errors_m is None else f"; first pose: {format_millimetres(errors_m[0])} off"
    panel.text(0.5, 0.882, f"{of}: {found.verdict}", size=14, ha="center", weight="bold")
    panel.text(0.5, 0.845, f"{found.count_explanations()}{off}", size=11.5, ha="center", color=LIGHT.soft)
    shown = found.touches[:MOST_SHAPES]
    width, height = SHAPE, SHAPE * WIDTH_IN / 2 / HEIGHT_IN
    first = 0.5 - 0.5 * width * len(shown)
    for number, touch in enumerate(shown):
        axes = panel.add_axes((first + number * width + 0.01, 0.83 - height, width - 0.02, height - 0.02))
        draw_contact_shape(axes, touch.contact_shape, touch.geometry)
        draw_outline(axes, touch)
        axes.set(xticks=[], yticks=[])
        axes.set_xlabel(name_touch(number), size=10.5, labelpad=3)


def name_touch(number: int) -> str:
    """Return the label of a touch, which counts from 0."""
    return f"touch {number + 1}"


def _draw_image(panel: SubFigure, view: _SharedView, image: Image) -> Axes:
    axes: Axes = panel.add_axes((0.02, 0.055, 0.96, 0.545))
    axes.imshow(unmultiply(image), extent=view.canvas.bounds, interpolation="antialiased")
    axes.set(xlim=view.canvas.bounds[:2], ylim=view.canvas.bounds[2:], aspect="equal")
    axes.set_axis_off()
    return axes


def _draw_legend(panel: SubFigure, colours: dict[str, Any], found: Localization) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(fc=colour, ec=EDGE, lw=0.8, label=label) for label, colour in colours.items()]
    if found.touch.T_sensor_object is not None:
        handles.append(Line2D([], [], color=TRUTH, lw=1.5, label="true pose"))
    panel.legend(
        handles=handles, loc="lower center", bbox_to_anchor=(0.5, 0.005), ncols=2, frameon=False, fontsize=11.5
    )


@dataclass(frozen=True, eq=False)
class _SharedView:
    """A scene from one viewpoint, for both sides of the figure."""

    scene: DrawnScene
    canvas: Canvas

    @classmethod
    def of(cls, scene: DrawnScene, ghosts: Sequence[Floats]) -> _SharedView:
        """Choose a viewpoint that shows the object, also at the poses `ghosts` (4, 4), metres, and all sensors."""
        view = choose_view(scene.mesh, scene.poses[0])
        posed = [move_triangles(scene.mesh.triangles_m, T) for T in ghosts]
        sensors = [part for sensor in scene.sensors for part in (sensor.gel_m, sensor.housing_m)]
        bounds = fit_bounds(view, [1e3 * part for part in (scene.object_m, *posed, *sensors)], MARGIN, MARGIN)
        size_mm = 1e3 * float(np.ptp(scene.mesh.triangles_m.reshape(-1, 3), axis=0).max())
        return cls(scene, Canvas(view, bounds, PIXELS, EDGE_STEP * size_mm))

    def draw_ghosts(self, T_sensor_object: Sequence[Floats]) -> Image:
        """Return a picture of the first sensor and the object at each pose (4, 4), metres, seen through."""
        first = self.scene.sensors[:1]
        image = self._draw([], first)
        for ghost in map_in_threads(lambda T: self._draw([T], first), T_sensor_object[::-1]):
            image = _blend(image, ghost, GHOST)
        return self._mark_truth(image)

    def draw_touched(self) -> Image:
        """Return a picture of the object at the first pose, on the first sensor; others are seen through."""
        best, sensors = [self.scene.poses[0]], self.scene.sensors
        return self._mark_truth(_blend(self._draw(best, sensors[:1]), self._draw(best, sensors), SEEN_THROUGH))

    def label_sensors(self, axes: Axes) -> None:
        """Write each touch's name on its sensor, in the corner that is farthest from the object and other sensors."""
        from matplotlib.patheffects import withStroke

        solids = [self.scene.object_m, *(sensor.gel_m for sensor in self.scene.sensors)]
        flat = [self.canvas.view.project(1e3 * triangles_m).reshape(-1, 2) for triangles_m in solids]
        middles = np.stack([points.mean(axis=0) for points in flat])
        halo = [withStroke(linewidth=2.5, foreground="white")]
        for number, corners in enumerate(flat[1:]):
            others = np.delete(middles, number + 1, axis=0)
            free_mm = np.linalg.norm(corners[:, None] - others, axis=-1).min(axis=1)
            at = LABEL * corners[free_mm.argmax()] + (1 - LABEL) * middles[number + 1]
            axes.text(at[0], at[1], name_touch(number), size=11.5, ha="center", va="center", path_effects=halo)

    def _draw(self, T_sensor_object: Sequence[Floats], sensors: Sequence[DrawnSensor]) -> Image:
        surfaces = [move_triangles(self.scene.mesh.triangles_m, T) for T in T_sensor_object]
        colours = [STEEL] * len(surfaces) + [GEL, HOUSING] * len(sensors)
        surfaces += [part for sensor in sensors for part in (sensor.gel_m, sensor.housing_m)]
        _, image = self.canvas.draw_solids([1e3 * surface for surface in surfaces], colours)
        return average(image, SUPERSAMPLE)

    def _mark_truth(self, image: Image) -> Image:
        if self.scene.truth_m is None:
            return image
        lines = np.zeros((*self.canvas.shape, 4), np.float32)
        self.canvas.draw_edges(lines, 1e3 * self.scene.truth_m, TRUTH, 1.0)
        return _blend(image, average(lines, SUPERSAMPLE), TRUTH_OPACITY)


def _blend(below: Image, above: Image, opacity: float) -> Image:
    """Return a picture (H, W, 4) with another one over it that is seen through."""
    above = np.float32(opacity) * above
    return above + (1 - above[..., 3:]) * below
