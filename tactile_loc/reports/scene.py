"""The 3D scenes that a browser draws: the object on the sensors' pads, and the distribution over its surface.

All values are for the page's scripts, in mm. Pads are in the sensor frame of the first touch. The surface is in the
object frame.
"""

import base64
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Poses, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.reports.distribution import SurfaceDistribution, find_touched_vertices
from tactile_loc.view.drawn_scene import DrawnScene, DrawnSensor
from tactile_loc.view.pictures import group_nearby
from tactile_loc.view.pose_panel import choose_view
from tactile_loc.view.raytracing import CREASE_DEG, Viewpoint, compute_normals

ELEVATION_DEG = 28.0
ASIDE_DEG = 25.0  # angle between the view and the peak's direction; seen from the side, the object looks solid
FIELD_DEG = 45.0
ROOM = 1.06  # factor on the camera's distance
MOST_CREASES = 20_000
MARGIN_MM = 16.0  # space around the pads
DECADES = 3  # range of the density's colour scale
NAMED = 5  # candidates marked on the surface
LIFT_MM, TOGETHER_MM = 1.5, 4.0  # height of marks above the surface, and distance below which marks are merged
AROUND_MM, AXES_MM = 14.0, 10.0


def build_sensor_scene(scene: DrawnScene) -> dict[str, Any]:
    """Return an object at the poses of a scene, on its sensors."""
    pads, mesh, truth = [build_pad(sensor) for sensor in scene.sensors], scene.mesh, scene.T_true
    bounds = compute_bounds_mm(mesh, [*scene.poses, *([] if truth is None else [truth])], pads)
    view = choose_view(mesh, scene.poses[0], ELEVATION_DEG)
    best_mm = 1e3 * transform_points(scene.poses[0], mesh.vertices_m)
    seen_mm = np.concatenate([best_mm, _stack_points(pads[0]["housing"])])  # not those of further touches
    return {
        "mesh": pack_mesh(mesh),
        "creases": [] if truth is None else find_creases(mesh),
        "truth": None if truth is None else list_rows_mm(truth),
        "pads": pads,
        "bounds": bounds,
        "camera": place_camera(seen_mm, bounds, view),
    }


def build_surface_scene(
    found: SurfaceDistribution, poses: Poses, truth: Floats | None, geometry: SensorGeometry
) -> dict[str, Any]:
    """Return the scene of the object's surface, coloured by the density.

    Marks show where the sensor touches at the candidates' poses (K, 4, 4), metres, and at the true pose (4, 4).
    """
    density = np.log10(np.maximum(100 * 1e-6 * found.density, 1e-30))  # per cent per square millimetre
    high = float(density.max())
    return {
        **frame_surface(found.mesh, found.mesh.vertices_m[int(found.density.argmax())]),
        "log_density": pack_array(np.maximum(density, high - DECADES), "<f4"),
        "range": [high - DECADES, high],
        "marks": _place_marks(found.mesh, poses, truth, geometry),
        "spread_mm": 1e3 * found.spread_m,
    }


def frame_surface(mesh: TriangleMesh, shown_m: Floats) -> dict[str, Any]:
    """Return a surface with its axes, ranges and a camera that sees its point `shown_m` (3,), metres, in front."""
    points_mm = 1e3 * mesh.vertices_m
    box_mm = np.stack([points_mm.min(axis=0), points_mm.max(axis=0)], axis=1)
    bounds = (box_mm + np.array([-AROUND_MM, AROUND_MM])).round(2).tolist()
    view = choose_view_on(shown_m, mesh.centroid_m)
    axes = build_triad(box_mm, view, AXES_MM)
    return {
        "mesh": pack_mesh(mesh),
        "bounds": bounds,
        "camera": place_camera(np.concatenate([points_mm, _stack_points(axes["names"])]), bounds, view),
        "triad": axes,
    }


def _place_marks(mesh: TriangleMesh, poses: Poses, truth: Floats | None, geometry: SensorGeometry) -> dict[str, Any]:
    """Return marks for the first candidates and the true pose, a little above the surface. Nearby marks are merged."""
    names = [*map(str, range(1, 1 + min(NAMED, len(poses)))), *([] if truth is None else ["true"])]
    named = np.stack([*poses[:NAMED], *([] if truth is None else [truth])])
    vertices = find_touched_vertices(mesh, named, geometry)
    places = 1e3 * mesh.vertices_m[vertices] + LIFT_MM * mesh.vertex_normals[vertices]
    groups = group_nearby(places, TOGETHER_MM)
    at = np.stack([places[group].mean(axis=0) for group in groups])
    return {**_split_columns(at), "text": [", ".join(names[i] for i in group) for group in groups]}


def pack_array(values: NDArray[Any], kind: str) -> str:
    """Return an array as base64 of little-endian float32 ("<f4") or int32 ("<i4"), row by row."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()


def pack_mesh(mesh: TriangleMesh) -> dict[str, str]:
    """Return a mesh as packed arrays, with vertices in mm."""
    return {"vertices_mm": pack_array(1e3 * mesh.vertices_m, "<f4"), "faces": pack_array(mesh.faces, "<i4")}


def list_rows_mm(T: Floats) -> list[float]:
    """Return the first three rows of a transform (4, 4) in metres as twelve numbers, with the translation in mm."""
    rows = np.array(T[:3], float)
    rows[:, 3] *= 1e3
    return [round(float(v), 7) for v in rows.ravel()]


def build_pad(sensor: DrawnSensor) -> dict[str, Any]:
    """Return a sensor's gel, its housing and the outline of the contact, in mm, in the frame of the scene."""
    parts = {"gel": sensor.gel_m, "housing": sensor.housing_m}
    return {
        **{name: _list_triangles(part_m) for name, part_m in parts.items()},
        "contact": join_lines(sensor.outlines_m),
    }


def find_creases(mesh: TriangleMesh) -> list[list[int]]:
    """Return at most `MOST_CREASES` edges, as pairs of vertices, where the surface bends sharply or ends."""
    normals = compute_normals(mesh.triangles_m)
    edges = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    faces = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort((faces, edges[:, 1], edges[:, 0]))
    edges, faces = edges[order], faces[order]
    unique, first, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    second = faces[np.minimum(first + 1, len(faces) - 1)]
    bend = (normals[faces[first]] * normals[second]).sum(axis=1) < np.cos(np.radians(CREASE_DEG))
    sharp: list[list[int]] = unique[(count != 2) | bend][:MOST_CREASES].tolist()
    return sharp


def compute_bounds_mm(mesh: TriangleMesh, poses: Sequence[Floats], pads: Iterable[dict[str, Any]]) -> list[list[float]]:
    """Return the ranges (low, high) along x, y and z, in mm, that contain the pads and the object at all poses."""
    clouds = [1e3 * transform_points(T, mesh.vertices_m) for T in poses]
    clouds += [_stack_points(one["housing"]) for one in pads]
    low = np.min([cloud.min(axis=0) for cloud in clouds], axis=0)
    high = np.max([cloud.max(axis=0) for cloud in clouds], axis=0)
    return [[round(float(a - MARGIN_MM), 2), round(float(b + MARGIN_MM), 2)] for a, b in zip(low, high, strict=True)]


def place_camera(points_mm: Floats, bounds: Sequence[Sequence[float]], view: Viewpoint) -> dict[str, dict[str, float]]:
    """Return a camera for plotly that sees all points (P, 3), mm, from a view; `bounds` are the axes' ranges.

    Plotly's unit of length is the geometric mean of the ranges. Plotly's origin is the middle of the ranges, and its
    field of view is `FIELD_DEG`.
    """
    low, high = np.array(bounds, float).T
    unit, middle = float(np.prod(high - low) ** (1 / 3)), 0.5 * (low + high)
    centre = 0.5 * (points_mm.min(axis=0) + points_mm.max(axis=0))
    flat = (points_mm - centre) @ view.axes.T
    distance = float((np.abs(flat[:, :2]).max(axis=1) / np.tan(np.radians(0.5 * FIELD_DEG)) + flat[:, 2]).max())
    eye = centre + ROOM * distance * view.axes[2]
    places = {"eye": (eye - middle) / unit, "center": (centre - middle) / unit, "up": np.array([0.0, 0.0, 1.0])}
    return {name: {k: round(float(v), 5) for k, v in zip("xyz", place, strict=True)} for name, place in places.items()}


def choose_view_on(point: Floats, centre: Floats) -> Viewpoint:
    """Return a view in which a point (3,) of a surface lies in front of the surface's centre."""
    x, y, z = point - centre
    azimuth_deg = float(np.degrees(np.arctan2(x, -y)))
    elevation_deg = float(np.degrees(np.arctan2(z, np.hypot(x, y))))
    return Viewpoint(azimuth_deg + ASIDE_DEG, float(np.clip(elevation_deg, -60, 60)))


def build_triad(box_mm: Floats, view: Viewpoint, length_mm: float) -> dict[str, Any]:
    """Return lines and names of the frame's axes at the corner of a box (3, 2), mm, that is lower left in the view."""
    corners = np.array(np.meshgrid(*box_mm, indexing="ij")).reshape(3, -1).T
    origin_mm = corners[(view.project(corners) @ [1.0, 1.0]).argmin()]
    lines = join_lines([1e-3 * np.stack([origin_mm, end]) for end in origin_mm + length_mm * np.eye(3)])
    names = origin_mm + 1.25 * length_mm * np.eye(3)
    return {"lines": lines, "names": {**_split_columns(names), "text": ["x", "y", "z"]}}


def _stack_points(columns: Mapping[str, Any]) -> Floats:
    """Return points (P, 3) from their separate coordinates x, y and z."""
    return np.stack([columns[k] for k in "xyz"], axis=1)


def _split_columns(points: Floats) -> dict[str, list[float]]:
    """Return the separate coordinates x, y and z of points (P, 3)."""
    return {name: np.round(points[:, k], 3).tolist() for k, name in enumerate("xyz")}


def _list_triangles(triangles_m: Floats) -> dict[str, list[float]]:
    """Return triangles (F, 3, 3), metres, as a plotly mesh in mm."""
    corners = 1e3 * triangles_m.reshape(-1, 3)
    numbers = np.arange(len(corners)).reshape(-1, 3)
    return _split_columns(corners) | {name: numbers[:, k].tolist() for k, name in enumerate("ijk")}


def join_lines(lines_m: Sequence[Floats]) -> dict[str, list[float | None]]:
    """Return lines (P, 3), metres, as a single line with gaps, in mm."""
    columns: dict[str, list[float | None]] = {"x": [], "y": [], "z": []}
    for line in lines_m:
        for k, name in enumerate("xyz"):
            columns[name] += [*np.round(1e3 * line[:, k], 3).tolist(), None]
    return columns
