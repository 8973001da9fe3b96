"""Approaches from random directions: to an object in its own frame, or to an object whose pose is not certain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import (
    Poses,
    draw_rotations,
    invert,
    make_transform,
    make_translation,
    transform_points,
)
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.approach_files import Approach
from tactile_loc.tasks.pose_modes import PoseModes

CLEAR_M = 0.02  # distance between the object's bounding sphere and a sensor at its start
POINTS = 4000  # samples of the object's surface among which the first point of contact is found
SHIFTS = 10  # most shifts of a sensor until the object touches its gel before the rest of the finger
INSIDE = 0.8  # the first point of contact lies in this share of the gel, about its centre


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


def draw_approaches_to_modes(
    modes: PoseModes, count: int, rng: np.random.Generator, finger: TriangleMesh | None = None
) -> list[Approach]:
    """Return approaches from random directions, in the frame of the modes, aimed at the object in its possible poses.

    Each approach is aimed at the object in a mode that is drawn by its probability. Sensors start clear of the object
    in every mode, and press as deep as in the previous touch. A `finger` in the sensor frame is moved sideways until,
    in this mode, the object touches its gel before the rest of the finger, if that is possible.
    """
    centres_m = modes.T_base_object[:, :3, :3] @ modes.object.mesh.centroid_m + modes.T_base_object[:, :3, 3]
    apart_m = np.linalg.norm(centres_m[:, None] - centres_m[None], axis=-1).max()
    drawn = _draw_clear(modes.object, modes.geometry, count, CLEAR_M + float(apart_m), rng)
    aimed = rng.choice(len(modes.probabilities), count, p=modes.probabilities)
    if finger is not None:
        surface = np.concatenate([modes.object.mesh.sample(POINTS, rng), modes.object.mesh.hull_corners_m])
        drawn = [
            replace(approach, T_base_sensor=_bring_contact_to_gel(approach.T_base_sensor, surface, finger, modes, rng))
            for approach in drawn
        ]
    return [
        replace(approach, T_base_sensor=T_base_object @ approach.T_base_sensor)
        for approach, T_base_object in zip(drawn, modes.T_base_object[aimed], strict=True)
    ]


def _bring_contact_to_gel(
    T_object_sensor: Poses, surface_m: NDArray[np.float64], finger: TriangleMesh, modes: PoseModes,
    rng: np.random.Generator,
) -> Poses:  # fmt: skip
    """Move a sensor's pose (4, 4) sideways until the first of the points (P, 3) before the finger meets the gel.

    The points are on the object's surface, and lengths are in metres. After SHIFTS trials, the pose stays where it is.
    """
    x0, x1, y0, y1 = modes.geometry.rectangle
    middle, half = np.array([x0 + x1, y0 + y1]) / 2, np.array([x1 - x0, y1 - y0]) / 2
    low, high = finger.corners_m[:, :2].min(axis=0), finger.corners_m[:, :2].max(axis=0)
    low, high = np.minimum(low, middle - half), np.maximum(high, middle + half)
    points = transform_points(invert(T_object_sensor), surface_m)
    moved = np.zeros(2)
    for _ in range(SHIFTS):
        beside = points[:, :2] - moved
        before = np.flatnonzero(((beside >= low) & (beside <= high)).all(axis=1))
        if not len(before):
            break
        first = beside[before[points[before, 2].argmin()]]
        if (np.abs(first - middle) <= half).all():
            break
        moved += first - middle - INSIDE * half * rng.uniform(-1, 1, 2)
    return np.asarray(T_object_sensor @ make_translation([*moved, 0.0]))


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
