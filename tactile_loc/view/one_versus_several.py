"""Picture of the reason to touch again: the poses that explain one touch, beside the pose that explains all touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.formatting import format_millimetres
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.result.localization import Localization
from tactile_loc.view.pictures import draw_contact_shape, draw_outline, make_figure
from tactile_loc.view.pose_panel import (
    EDGE,
    GEL,
    HOUSING,
    STEEL,
    TRUTH,
    build_sensor_mm,
    choose_view,
    paint,
    thicken,
)
from tactile_loc.view.raytracing import Bounds, Tracer, View, average, shade, unmultiply

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Array = NDArray[np.float64]
Image = NDArray[np.float32]  # (H, W, 4): colours, 0 to 1, multiplied by opacity, and opacity

SHAPE = 0.21  # width of a drawn contact shape, in widths of its side of the figure
MOST_GHOSTS, MOST_SHAPES = 6, 4  # largest numbers of drawn poses of the first touch, and of drawn contact shapes
PIXELS, SUPERSAMPLE = 480, 2
GHOST, SEEN_THROUGH, TRUTH_OPACITY = 0.45, 0.5, 0.95  # opacity of the first touch's poses, other sensors and lines
EDGE_STEP = 0.04  # depth step that counts as an edge, in sizes of the object
WIDTH_IN, HEIGHT_IN = 13.6, 7.0
LABEL = 0.55  # place of a sensor's label: 0 for the gel's middle, 1 for its corner
MARGIN = 0.05  # free space around the drawn solids, in sizes of the picture


def draw_touching_again(alone: Localization, together: Localization, scene: Scene, title: str) -> Figure:
    """Draw the first touch and the poses that explain it, beside all touches and the first pose that explains them.

    `alone` is the result of the first touch of `together`. `scene` has the object, and the first touch's sensor. Lines
    show the true pose if it is known.
    """
    figure = make_figure(WIDTH_IN, HEIGHT_IN)
    figure.suptitle(title, size=14, weight="bold", x=0.5, y=0.975)
    panels: Any = figure.subfigures(1, 2)
    left, right = panels
    view = _SharedView.of(alone, together, scene)
    _draw_side(left, alone, scene.object, "the first touch alone")
    _draw_image(left, view, view.draw_ghosts([h.T_sensor_object for h in alone.equal_explanations[:MOST_GHOSTS]]))
    _draw_side(right, together, scene.object, f"{len(together.touches)} touches together")
    axes = _draw_image(right, view, view.draw_touched(together.best.T_sensor_object))
    view.label_sensors(axes, together.best.T_sensor_object)
    _draw_legend(left, {"poses that explain the touch": STEEL}, alone)
    _draw_legend(right, {"first pose": STEEL}, together)
    return figure


def _draw_side(panel: SubFigure, found: Localization, obj: ObjectModel, of: str) -> None:
    """Write what the touches show, and draw their contact shapes."""
    errors_m = found.measure_errors_m(obj)
    off = "" if errors_m is None else f"; first pose: {format_millimetres(errors_m[0])} off"
    panel.text(0.5, 0.882, f"{of}: {found.verdict}", size=13, ha="center", weight="bold")
    panel.text(0.5, 0.845, f"{found.count_explanations()}{off}", size=10.5, ha="center", color="#37474f")
    shown = found.touches[:MOST_SHAPES]
    width, height = SHAPE, SHAPE * WIDTH_IN / 2 / HEIGHT_IN
    first = 0.5 - 0.5 * width * len(shown)
    for number, touch in enumerate(shown):
        axes = panel.add_axes((first + number * width + 0.01, 0.83 - height, width - 0.02, height - 0.02))
        _draw_shape(axes, touch, name_touch(number))


def name_touch(number: int) -> str:
    """Return the label of a touch, which counts from 0."""
    return f"touch {number + 1}"


def _draw_shape(axes: Axes, touch: Touch, name: str) -> None:
    draw_contact_shape(axes, touch.contact_shape, touch.geometry)
    draw_outline(axes, touch)
    axes.set(xticks=[], yticks=[])
    axes.set_xlabel(name, size=9, labelpad=3)


def _draw_image(panel: SubFigure, view: _SharedView, image: Image) -> Axes:
    axes: Axes = panel.add_axes((0.02, 0.055, 0.96, 0.545))
    axes.imshow(unmultiply(image), extent=view.bounds, interpolation="antialiased")
    axes.set(xlim=view.bounds[:2], ylim=view.bounds[2:], aspect="equal")
    axes.set_axis_off()
    return axes


def _draw_legend(panel: SubFigure, colours: dict[str, Any], found: Localization) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(fc=colour, ec=EDGE, lw=0.8, label=label) for label, colour in colours.items()]
    if found.touch.T_sensor_object is not None:
        handles.append(Line2D([], [], color=TRUTH, lw=1.5, label="true pose"))
    panel.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 0.005), ncols=2, frameon=False, fontsize=10)


@dataclass(frozen=True, eq=False)
class _SharedView:
    """An object and N sensors from one viewpoint, for both sides of the figure, in the first sensor's frame.

    `triangles_mm` (F, 3, 3) are the object's, in its frame. Each sensor is its gel and its housing, as triangles in mm.
    """

    triangles_mm: Array
    sensors_mm: Sequence[list[Array]]
    T_true: Array | None
    view: View
    bounds: Bounds

    @classmethod
    def of(cls, alone: Localization, together: Localization, scene: Scene) -> _SharedView:
        """Choose a viewpoint that shows all poses and sensors."""
        mesh, best = scene.object.mesh, together.best.T_sensor_object
        triangles_mm = 1e3 * mesh.vertices_m[mesh.faces]
        sensors_mm = [_place_sensor(touch, together.touch) for touch in together.touches]
        view = choose_view(mesh, best)
        ghosts = alone.equal_explanations[:MOST_GHOSTS]
        posed = [_move(triangles_mm, T) for T in (best, *(h.T_sensor_object for h in ghosts))]
        bounds = _fit_bounds(view, [*posed, *(part for sensor in sensors_mm for part in sensor)])
        return cls(triangles_mm, sensors_mm, together.touch.T_sensor_object, view, bounds)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Size (H, W) of the pictures before they are averaged."""
        left, right, bottom, top = self.bounds
        scale = PIXELS * SUPERSAMPLE / max(right - left, top - bottom)
        height, width = (SUPERSAMPLE * round(scale * mm / SUPERSAMPLE) for mm in (top - bottom, right - left))
        return height, width

    @cached_property
    def step_mm(self) -> float:
        """The depth step that counts as an edge, mm."""
        return EDGE_STEP * float(np.ptp(self.triangles_mm.reshape(-1, 3), axis=0).max())

    def draw_ghosts(self, T_sensor_object: Sequence[Array]) -> Image:
        """Return a picture of the first sensor and the object at each pose, seen through."""
        image = self._draw([], self.sensors_mm[:1])
        for ghost in map_in_threads(lambda T: self._draw([T], self.sensors_mm[:1]), T_sensor_object[::-1]):
            image = _blend(image, ghost, GHOST)
        return self._mark_truth(image)

    def draw_touched(self, T_sensor_object: Array) -> Image:
        """Return a picture of the object at a pose, on the first sensor; others are seen through."""
        image = self._draw([T_sensor_object], self.sensors_mm[:1])
        every = self._draw([T_sensor_object], self.sensors_mm)
        return self._mark_truth(_blend(image, every, SEEN_THROUGH))

    def label_sensors(self, axes: Axes, T_sensor_object: Array) -> None:
        """Write each touch's name on its sensor, in the corner that is farthest from the object and other sensors."""
        from matplotlib.patheffects import withStroke

        solids = [_move(self.triangles_mm, T_sensor_object), *(gel for gel, _ in self.sensors_mm)]
        flat = [self.view.project(triangles).reshape(-1, 2) for triangles in solids]
        middles = np.stack([points.mean(axis=0) for points in flat])
        halo = [withStroke(linewidth=2.5, foreground="white")]
        for number, corners in enumerate(flat[1:]):
            others = np.delete(middles, number + 1, axis=0)
            free_mm = np.linalg.norm(corners[:, None] - others, axis=-1).min(axis=1)
            at = LABEL * corners[free_mm.argmax()] + (1 - LABEL) * middles[number + 1]
            axes.text(at[0], at[1], name_touch(number), size=10, ha="center", va="center", path_effects=halo)

    def _draw(self, T_sensor_object: Sequence[Array], sensors_mm: Sequence[list[Array]]) -> Image:
        surfaces = [_move(self.triangles_mm, T) for T in T_sensor_object]
        colours = [STEEL] * len(surfaces) + [GEL, HOUSING] * len(sensors_mm)
        tracer = Tracer([*surfaces, *(part for sensor in sensors_mm for part in sensor)], self.view)
        seen = tracer.look(self.bounds, self.shape)
        image = shade(seen, np.array(colours), tracer.cast_shadow(seen, 0.02))
        paint(image, seen.find_edges(self.step_mm) & seen.hit, EDGE, 0.75)
        return average(image, SUPERSAMPLE)

    def _mark_truth(self, image: Image) -> Image:
        if self.T_true is None:
            return image
        seen = Tracer([_move(self.triangles_mm, self.T_true)], self.view).look(self.bounds, self.shape)
        lines = np.zeros((*self.shape, 4), np.float32)
        paint(lines, thicken(seen.find_edges(self.step_mm)), TRUTH, 1.0)
        return _blend(image, average(lines, SUPERSAMPLE), TRUTH_OPACITY)


def _fit_bounds(view: View, surfaces: Sequence[Array]) -> Bounds:
    """Return the borders of a picture that shows all surfaces, mm."""
    flat = np.concatenate([view.project(triangles).reshape(-1, 2) for triangles in surfaces])
    (left, bottom), (right, top) = flat.min(axis=0), flat.max(axis=0)
    margin = MARGIN * max(right - left, top - bottom)
    return left - margin, right + margin, bottom - margin, top + margin


def _place_sensor(touch: Touch, first: Touch) -> list[Array]:
    """Return the gel and the housing of a touch's sensor, as triangles (12, 3, 3), mm, in the first sensor's frame."""
    parts = build_sensor_mm(touch.geometry)
    if touch is first or touch.T_base_sensor is None or first.T_base_sensor is None:
        return parts
    T_first_sensor = invert(first.T_base_sensor) @ touch.T_base_sensor
    return [_move(part, T_first_sensor) for part in parts]


def _move(triangles_mm: Array, T: Array) -> Array:
    """Return triangles (F, 3, 3), mm, moved by a transform (4, 4), metres."""
    moved: Array = 1e3 * transform_points(T, 1e-3 * triangles_mm.reshape(-1, 3)).reshape(-1, 3, 3)
    return moved


def _blend(below: Image, above: Image, opacity: float) -> Image:
    """Return a picture (H, W, 4) with another one over it that is seen through."""
    above = np.float32(opacity) * above
    return above + (1 - above[..., 3:]) * below
