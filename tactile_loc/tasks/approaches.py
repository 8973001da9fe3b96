"""Approaches from random directions: to an object in its own frame, or to an object whose pose is not certain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.approach_files import Approach
from tactile_loc.tasks.pose_modes import PoseModes

CLEAR_M = 0.02  # distance between the object's bounding sphere and a sensor at its start


def draw_approaches(
    obj: ObjectModel, geometry: SensorGeometry, count: int, press: float, rng: np.random.Generator
) -> list[Approach]:
    """Return approaches from random directions, in the object's frame, aimed at random points of the object's surface.

    Sensors start clear of the object, and press by the share `press` of the maximal depth.
    """
    return [
        replace(approach, press_m=press * geometry.max_depth_m)
        for approach in _draw_clear(obj, geometry, count, CLEAR_M, rng)
    ]


def draw_approaches_to_modes(modes: PoseModes, count: int, rng: np.random.Generator) -> list[Approach]:
    """Return approaches from random directions, in the frame of the modes, aimed at the object in its possible poses.

    Each approach is aimed at the object in a mode that is drawn by its probability. Sensors start clear of the object
    in every mode, and press as deep as in the previous touch.
    """
    centres_m = modes.T_base_object[:, :3, :3] @ modes.object.mesh.centroid_m + modes.T_base_object[:, :3, 3]
    apart_m = np.linalg.norm(centres_m[:, None] - centres_m[None], axis=-1).max()
    drawn = _draw_clear(modes.object, modes.geometry, count, CLEAR_M + float(apart_m), rng)
    aimed = rng.choice(len(modes.probabilities), count, p=modes.probabilities)
    return [
        replace(approach, T_base_sensor=T_base_object @ approach.T_base_sensor)
        for approach, T_base_object in zip(drawn, modes.T_base_object[aimed], strict=True)
    ]


def _draw_clear(
    obj: ObjectModel, geometry: SensorGeometry, count: int, clear_m: float, rng: np.random.Generator
) -> list[Approach]:
    """Return approaches in the object's frame whose gels start `clear_m` metres clear of the bounding sphere."""
    centre = obj.mesh.centroid_m
    start_m = clear_m + float(np.linalg.norm(obj.mesh.corners_m - centre, axis=1).max())
    found = []
    for k, (R, aim_m) in enumerate(zip(draw_rotations(count, rng), obj.mesh.sample(count, rng), strict=True)):
        z = R[:, 2]
        beside_m = aim_m - centre - z * (z @ (aim_m - centre))
        T = make_transform(R, centre + beside_m - z * (start_m + geometry.surface_m))
        found.append(Approach(T, travel_m=2 * start_m, name=f"approach-{k:03d}"))
    return found
