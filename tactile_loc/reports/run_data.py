"""What the scripts of a run's page draw, as JSON values; millimetres, degrees, per cent."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry import transform_points
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.locate.result_arrays import ResultArrays
from tactile_loc.locate.result_json import ResultRecord
from tactile_loc.reports import scene3d
from tactile_loc.reports.rotations import SideMap, side_map, yaw_histogram
from tactile_loc.reports.surface import SurfaceDistribution, surface_distribution, touched_points, vertex_normals

SPACING_MM = 4.0  # of the grid, if its options do not say
SPREAD = 0.5  # of the grid's spacing: what is between its poses
LEAST_SPREAD_MM = 0.5
DECADES = 3  # shown of the density over the surface
BEFORE = ("model",)  # stages that are no part of a localisation
NAMED = 5  # candidates marked on the surface
LIFT_MM, TOGETHER_MM = 1.5, 4.0  # marks are so far above the surface, and those so near to one another are one
AROUND_MM, AXES_MM = 14.0, 10.0


def run_data(record: ResultRecord, arrays: ResultArrays) -> dict[str, Any]:
    """Return the data of a run's page."""
    poses = scene3d.candidate_poses(record.hypotheses)
    T_true = record.touch.T_sensor_object
    truth = None if T_true is None else np.array(T_true, float)
    return {
        "candidates": _candidates(record, poses),
        "mesh": scene3d.packed_mesh(arrays.mesh),
        "creases": [] if truth is None else scene3d.creases(arrays.mesh),
        "truth": None if truth is None else scene3d.rows_mm(truth),
        **_scene(arrays, poses, truth),
        "surface": _surface(record, arrays, poses, truth),
        **_rotations(arrays),
        "times": [[stage, 1e3 * s] for stage, s in record.seconds.items() if stage not in BEFORE],
    }


def side_sentence(side: dict[str, Any]) -> str:
    """Say in words which sides of the object can face the sensor."""
    x, y, z = side["normal"]
    if side["kind"] == "one":
        return f"All poses of the grid lie on one side of the object, ({x:.2f}, {y:.2f}, {z:.2f}) in its own frame."
    if side["kind"] == "lean":
        return f"Around the side ({x:.2f}, {y:.2f}, {z:.2f}) of the object's own frame:"
    return f"Any side can face the sensor; most probable is ({x:.2f}, {y:.2f}, {z:.2f}) in the object's own frame."


def _candidates(record: ResultRecord, poses: NDArray[np.float64]) -> list[dict[str, Any]]:
    return [
        {
            "rank": h.rank, "probability": h.probability, "imprint_iou": h.imprint_iou, "T": scene3d.rows_mm(T),
            "error_mm": None if h.error_m is None else 1e3 * h.error_m,
        }
        for h, T in zip(record.hypotheses, poses, strict=True)
    ]  # fmt: skip


def _scene(arrays: ResultArrays, poses: NDArray[np.float64], truth: NDArray[np.float64] | None) -> dict[str, Any]:
    """The sensors under the object, and from where both are seen."""
    pads = [scene3d.pad(touch) for touch in arrays.touches]
    bounds = scene3d.bounds_mm(arrays.mesh, [*poses, *([] if truth is None else [truth])], pads)
    view, geometry = scene3d.view_of(arrays.mesh, poses[0]), arrays.touches[0].geometry
    best_mm = 1e3 * transform_points(poses[0], arrays.mesh.vertices_m)
    seen_mm = np.concatenate([best_mm, *(np.stack([pad["housing"][k] for k in "xyz"], axis=1) for pad in pads)])
    return {
        "pads": pads, "bounds": bounds, "camera": scene3d.camera_on(seen_mm, bounds, view),
        "ticks": scene3d.pad_ticks(geometry, view),
    }  # fmt: skip


def surface_of(record: ResultRecord, arrays: ResultArrays) -> SurfaceDistribution:
    """Return where on the surface the first touch's sensor may be."""
    options = record.configuration.get("grid", {}).get("options", {})
    spacing_mm = options.get("spacing_mm")
    spread_mm = max(SPREAD * float(spacing_mm if isinstance(spacing_mm, (int, float)) else SPACING_MM), LEAST_SPREAD_MM)
    geometry = arrays.touches[0].geometry
    return surface_distribution(arrays.mesh, arrays.T_sensor_object, arrays.weights, geometry, 1e-3 * spread_mm)


def _surface(
    record: ResultRecord, arrays: ResultArrays, poses: NDArray[np.float64], truth: NDArray[np.float64] | None
) -> dict[str, Any]:
    found = surface_of(record, arrays)
    density = np.log10(np.maximum(100 * 1e-6 * found.density, 1e-30))  # per cent per square millimetre
    high = float(density.max())
    peak = found.mesh.vertices_m[int(found.density.argmax())]
    points_mm = 1e3 * found.mesh.vertices_m
    box = np.stack([points_mm.min(axis=0), points_mm.max(axis=0)], axis=1)
    bounds = (box + np.array([-AROUND_MM, AROUND_MM])).round(2).tolist()
    view = scene3d.view_on(peak, found.mesh.centroid_m)
    triad = scene3d.triad(box, view, AXES_MM)
    seen_mm = np.concatenate([points_mm, np.stack([triad["names"][k] for k in "xyz"], axis=1)])
    return {
        "mesh": scene3d.packed_mesh(found.mesh),
        "log_density": scene3d.packed(np.maximum(density, high - DECADES), "<f4"),
        "range": [high - DECADES, high],
        "marks": _marks(arrays, found.mesh, poses, truth),
        "spread_mm": 1e3 * found.spread_m,
        "bounds": bounds,
        "camera": scene3d.camera_on(seen_mm, bounds, view),
        "triad": triad,
    }


def _marks(
    arrays: ResultArrays, mesh: TriangleMesh, poses: NDArray[np.float64], truth: NDArray[np.float64] | None
) -> dict[str, Any]:
    """Where the first candidates and the truth are, a little above the surface; those that are near share a mark."""
    names = [*map(str, range(1, 1 + min(NAMED, len(poses)))), *([] if truth is None else ["true"])]
    named = np.stack([*poses[:NAMED], *([] if truth is None else [truth])])
    vertices = touched_points(mesh, named, arrays.touches[0].geometry)
    normals = vertex_normals(mesh)
    places = 1e3 * mesh.vertices_m[vertices] + LIFT_MM * normals[vertices]
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        near = next((g for g in groups if np.linalg.norm(places[g[0]] - place) < TOGETHER_MM), None)
        groups.append([i]) if near is None else near.append(i)
    at = np.stack([places[group].mean(axis=0) for group in groups])
    text = [", ".join(names[i] for i in group) for group in groups]
    return {**{k: np.round(at[:, i], 3).tolist() for i, k in enumerate("xyz")}, "text": text}


def _rotations(arrays: ResultArrays) -> dict[str, Any]:
    R, weights = arrays.T_sensor_object[:, :3, :3], arrays.weights
    yaw = yaw_histogram(R, weights)
    return {
        "yaw": {"deg": yaw.yaw_deg.round(3).tolist(), "percent": (100 * yaw.mass).tolist(), "width": yaw.width_deg},
        "side": _side(side_map(R, weights)),
    }


def _side(side: SideMap) -> dict[str, Any]:
    return {
        "kind": side.kind, "normal": side.normal.tolist(), "x": side.x.tolist(), "y": side.y.tolist(),
        "percent": (100 * side.mass).tolist(),
    }  # fmt: skip
