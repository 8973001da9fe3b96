"""A plate with a step, and touches of altered plates that another renderer draws."""

from __future__ import annotations

import numpy as np
import trimesh
from tactile_loc import ObjectModel, RobotTouches, SensorGeometry, TriangleMesh
from tactile_loc.plugin import Scene, View, registry
from tactile_loc.plugin.helpers import SymmetryGroup, exponential

GEOMETRY = SensorGeometry("orthographic", 120, 90, 8000, 8000, 60, 45, 10e-3, 1e-3)
TOP_M = np.array([1e-3, 0.5e-3, 2e-3])  # the middle of the step's top
PRESS_M = 8e-4


def make_plate(*more: trimesh.Trimesh) -> ObjectModel:
    """Return a plate of 20 x 16 x 2 mm with a step of 6 x 5 x 1 mm, and further solids, mm."""
    plate = trimesh.creation.box([20, 16, 2])
    step = trimesh.creation.box([6, 5, 1]).apply_translation([1, 0.5, 1.5])
    solid = trimesh.util.concatenate([plate, step, *more])
    mesh = TriangleMesh(1e-3 * np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64))
    return ObjectModel("plate", mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def make_burr(height_mm: float) -> trimesh.Trimesh:
    """Return a ball that rises above the middle of the step."""
    return trimesh.creation.icosphere(4, 1.0).apply_translation(1e3 * TOP_M + [0, 0, height_mm - 1.0])


def make_dome() -> trimesh.Trimesh:
    """Return a ball of radius 6 mm that rises 0.9 mm above the step, which it covers."""
    return trimesh.creation.icosphere(5, 6.0).apply_translation(1e3 * TOP_M + [0, 0, 0.9 - 6.0])


def press(
    part: ObjectModel, seed: int = 0, count: int = 2, model: ObjectModel | None = None, press_m: float = PRESS_M
) -> list[View]:
    """Return views of a model, by default the plate, with touches of a `part` on the step, drawn by the z-buffer."""
    rng, model, geometry = np.random.default_rng(seed), model or make_plate(), GEOMETRY
    source = RobotTouches(part, geometry, registry().create("renderer", "zbuffer", {}))
    mine = registry().create("renderer", "heightmap", {})
    views = []
    for number in range(count):
        T = exponential(np.r_[rng.normal(size=3) * 0.02, 0, 0, 0], np.zeros(3)) @ np.diag([1.0, -1, -1, 1])
        aside = np.array([*rng.normal(size=2), 0]) * 5e-4
        T[:3, 3] = TOP_M + aside - T[:3, :3] @ [0, 0, geometry.standoff_m + 5e-3]
        touch = source.approach(T, press_m, f"touch-{number}", rng)
        assert touch is not None
        views.append(View(touch, Scene(model, touch.geometry, mine)))
    return views


def misplace(views: list[View], seed: int = 0) -> list[np.ndarray]:
    """Return the true poses of the views' touches with an error of 0.1 mm and 0.2 degrees."""
    twist = np.r_[[3.5e-3] * 3, [1e-4] * 3] * np.random.default_rng(seed).normal(size=6)
    return [exponential(twist, GEOMETRY.gel_middle_m) @ view.touch.T_sensor_object for view in views]
