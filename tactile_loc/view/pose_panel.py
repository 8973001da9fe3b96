"""Picture of the object on the sensor: a solid at the estimated pose, lines at the true pose, and axes in mm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_loc.core.geometry.rigid import Float32, Floats, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.view.drawn_scene import EDGE, GEL, GEL_M, HOUSING, RIM_M, STEEL, TRUTH, DrawnScene
from tactile_loc.view.palette import Palette
from tactile_loc.view.raytracing import Bounds, Buffers, Tracer, Viewpoint, blend, count_marked, unmultiply

if TYPE_CHECKING:
    from matplotlib.axes import Axes


PIXELS, SUPERSAMPLE = 620, 2
TRUTH_OPACITY = 0.95
LIFT_MM = 0.02  # distance by which points are lifted, so that they do not shade themselves
AZIMUTHS_DEG = (-55.0, -35.0, 35.0, 55.0, -145.0, -125.0, 125.0, 145.0)
TICK_PT, VALUE_PT = 5.0, 12.0  # length of a tick, and distance of its value
LABEL_PT, WIDER_PT = 27.0, 18.0  # distance of an axis's label: the second part is added where the text is beside it
GEL_MM, RIM_MM = 1e3 * GEL_M, 1e3 * RIM_M


def draw_pose(axes: Axes, scene: DrawnScene) -> None:
    """Draw the first sensor of a scene, the object at its first pose, and the object's edges at the true pose."""
    view = choose_view(scene.mesh, scene.poses[0])
    sensor = scene.sensors[0]
    estimate, floor = 1e3 * scene.object_m, [1e3 * sensor.gel_m, 1e3 * sensor.housing_m]
    truth = None if scene.truth_m is None else 1e3 * scene.truth_m
    bounds = fit_bounds(view, [s for s in (estimate, truth, *floor) if s is not None], 0.17, 0.051)
    canvas = Canvas(view, bounds, PIXELS, 0.04 * float(np.ptp(estimate.reshape(-1, 3), axis=0).max()))
    seen, image = canvas.draw_solids([estimate, *floor], [STEEL, GEL, HOUSING])
    if truth is not None:
        image = blend(image, canvas.draw_edges(truth, TRUTH), TRUTH_OPACITY)
    axes.imshow(unmultiply(image), extent=bounds, interpolation="antialiased", zorder=1)
    top_mm = max(float(s[..., 2].max()) for s in (estimate, truth) if s is not None)
    height_mm = max(top_mm - 1e3 * sensor.geometry.surface_m, 5.0)
    _draw_axes(axes, view, sensor.geometry, height_mm, seen)
    axes.set(xlim=bounds[:2], ylim=bounds[2:], aspect="equal")
    axes.set_axis_off()


def choose_view(mesh: TriangleMesh, T: Floats, elevation_deg: float = Viewpoint.elevation_deg) -> Viewpoint:
    """Return the view that best shows both the object at T (4, 4), metres, and the sensor."""
    points = 1e3 * transform_points(T, mesh.vertices_m)

    def rate(view: Viewpoint) -> float:
        nearness_mm = float(view.axes[2, :2] @ points.mean(axis=0)[:2])
        shown = np.sqrt(max(np.linalg.det(np.cov(view.project(points).T)), 0.0))
        return float(shown * (1 - 0.4 * np.tanh(nearness_mm / 15)))

    return max((Viewpoint(azimuth_deg, elevation_deg) for azimuth_deg in AZIMUTHS_DEG), key=rate)


def fit_bounds(view: Viewpoint, surfaces: Sequence[Floats], margin: float, top_margin: float) -> Bounds:
    """Return the borders, mm, of a picture of surfaces (F, 3, 3), mm. Margins are shares of the longer side."""
    flat = np.concatenate([view.project(triangles).reshape(-1, 2) for triangles in surfaces])
    (left, bottom), (right, top) = flat.min(axis=0), flat.max(axis=0)
    side = max(right - left, top - bottom)
    return left - margin * side, right + margin * side, bottom - margin * side, top + top_margin * side


@dataclass(frozen=True)
class Canvas:
    """A picture of solids from a view, with `bounds` (left, right, bottom, top), mm.

    The longer side has `pixels`. A depth step of `step_mm` counts as an edge.
    """

    view: Viewpoint
    bounds: Bounds
    pixels: int
    step_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        """The number of rays (H, W): SUPERSAMPLE x SUPERSAMPLE for each pixel."""
        width, height = self.bounds[1] - self.bounds[0], self.bounds[3] - self.bounds[2]
        scale = self.pixels / max(width, height)
        return max(1, round(height * scale)) * SUPERSAMPLE, max(1, round(width * scale)) * SUPERSAMPLE

    def draw_solids(self, surfaces_mm: Sequence[Floats], colours: Sequence[Floats]) -> tuple[Buffers, Float32]:
        """Return the hits and a picture of shaded surfaces (F, 3, 3), mm, with dark edges."""
        tracer = Tracer(list(surfaces_mm), self.view)
        seen = tracer.look(self.bounds, self.shape)
        return seen, tracer.paint(seen, np.array([*colours, Palette.rgb(EDGE)]), self.step_mm, LIFT_MM, SUPERSAMPLE)

    def draw_edges(self, surface_mm: Floats, colour: str, width: int = 2) -> Float32:
        """Return a picture of the edges of a surface (F, 3, 3), mm. Lines are `width` rays wide."""
        thick = Tracer([surface_mm], self.view).look(self.bounds, self.shape).find_edges(self.step_mm)
        for _ in range(width - 1):
            thick[1:] |= thick[:-1].copy()
            thick[:, 1:] |= thick[:, :-1].copy()
        return count_marked(thick, SUPERSAMPLE)[..., None] * np.array([*Palette.rgb(colour), 1.0], np.float32)


def _draw_axes(axes: Axes, view: Viewpoint, geometry: SensorGeometry, height_mm: float, seen: Buffers) -> None:
    """Draw ticks for x and y along the nearest edges of the sensing rectangle, and ticks for z above a corner."""
    x0, x1, y0, y1 = (1e3 * value for value in geometry.rectangle)
    z0 = 1e3 * geometry.surface_m
    away = RIM_MM + 0.6
    towards = view.axes[2]
    near_x, near_y = (x1 if towards[0] > 0 else x0), (y1 if towards[1] > 0 else y0)
    out_x, out_y = np.sign(near_x - 0.5 * (x0 + x1)), np.sign(near_y - 0.5 * (y0 + y1))
    z_low, xs, ys = z0 - GEL_MM, list_round_values(x0, x1, 6.5), list_round_values(y0, y1, 6.5)
    _draw_scale(axes, view, [(x, near_y + out_y * away, z_low) for x in xs], xs, (0, out_y, 0), "x (mm)")
    _draw_scale(axes, view, [(near_x + out_x * away, y, z_low) for y in ys], ys, (out_x, 0, 0), "y (mm)")
    rim_mm = [x0 - RIM_MM, x1 + RIM_MM, y0 - RIM_MM, y1 + RIM_MM]
    _draw_height(axes, view, rim_mm, z0, list_round_values(z0, z0 + height_mm, 4.5), seen)


def _draw_height(
    axes: Axes, view: Viewpoint, rim_mm: list[float], base_mm: float, ticks: list[float], seen: Buffers
) -> None:
    """Draw the z axis at the sensor's left or right corner, whichever the object covers less."""
    corners = [(x, y) for x in rim_mm[:2] for y in rim_mm[2:]]
    corners.sort(key=lambda c: view.project(np.array([*c, 0.0]))[0])
    sides = [
        ([(*corner, z) for z in ticks], sign * view.axes[0]) for corner, sign in ((corners[0], -1), (corners[-1], 1))
    ]
    reach_mm = 0.05 * (seen.bounds[1] - seen.bounds[0])
    hidden = []
    for points, outwards in sides:
        places = np.concatenate([view.project(np.array(points) + k * reach_mm * outwards) for k in (0, 1, 2)])
        hidden.append(int((seen.find_surfaces(places) == 0).sum()))
    points, outwards = sides[int(np.argmin(hidden))]
    pole = view.project(np.array([[*points[0][:2], base_mm], points[-1]]))
    axes.plot(pole[:, 0], pole[:, 1], color="#777777", lw=0.8, zorder=2)
    _draw_scale(axes, view, points, ticks, outwards, "z (mm)")


def list_round_values(low: float, high: float, most: float = 6.0) -> list[float]:
    """Return round numbers between two limits, in mm. There are at most about `most` numbers."""
    step = next((s for s in (1, 2, 5, 10, 20, 50, 100) if (high - low) / s <= most), 200)
    return [float(k * step) for k in range(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6) + 1)]


def _draw_scale(axes: Axes, view: Viewpoint, points: list[Any], values: list[float], outwards: Any, label: str) -> None:
    """Draw tick marks with their values at points (mm, sensor frame), and the axis's label next to the middle."""
    flat = view.project(np.array(points))
    direction = view.project(np.asarray(outwards, float))
    direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
    point_mm = _measure_point_mm(axes)
    for point, value in zip(flat, values, strict=True):
        end = point + TICK_PT * point_mm * direction
        axes.plot(*np.stack([point, end]).T, color="#777777", lw=0.8, zorder=2)
        _write_text(axes, point + VALUE_PT * point_mm * direction, f"{value:g}", 8)
    middle = 0.5 * (flat[0] + flat[-1])
    distance_pt = LABEL_PT + WIDER_PT * abs(float(direction[0]))
    _write_text(axes, middle + distance_pt * point_mm * direction, label, 9)


def _measure_point_mm(axes: Axes) -> float:
    """Return the size of a typographic point in the drawing of an object, mm."""
    left, right, bottom, top = axes.get_images()[0].get_extent()
    box = axes.get_window_extent()
    dots_mm = max((right - left) / box.width, (top - bottom) / box.height)
    return float(dots_mm * axes.figure.dpi / 72)


def _write_text(axes: Axes, at: Floats, text: str, size: float) -> None:
    from matplotlib.patheffects import withStroke

    look: dict[str, Any] = {"ha": "center", "va": "center", "color": "#333333", "zorder": 3, "clip_on": False}
    axes.text(at[0], at[1], text, size=size, path_effects=[withStroke(linewidth=2.0, foreground="white")], **look)
