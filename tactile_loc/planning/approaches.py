"""Approaches from random directions: to an object in its own frame, or to an object whose pose is not certain."""

from dataclasses import replace

import numpy as np

from tactile_loc.core.geometry.rigid import (
    Floats,
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
from tactile_loc.tracking.pose_modes import PoseModes

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
        for approach in _draw_clear(obj, geometry, count, CLEAR_M + _measure_radius_m(obj), rng)
    ]


def draw_approaches_to_modes(
    modes: PoseModes, count: int, rng: np.random.Generator, finger: TriangleMesh | None = None
) -> list[Approach]:
    """Return approaches from random directions, in the frame of the modes, aimed at the object in its possible poses.

    Each approach is aimed at the object in a mode that is drawn by its probability. Sensors start clear of the object
    in every mode, and press as deep as in the previous touch. A `finger` in the sensor frame is moved sideways until,
    in this mode, the object touches its gel before the rest of the finger, if that is possible.
    """
    start_m = CLEAR_M + _measure_spread_m(modes)
    drawn = [_draw_clear(obj, modes.geometry, count, start_m, rng) for obj, _ in modes.by_object]
    aimed = rng.choice(len(modes.probabilities), count, p=modes.probabilities)
    approaches: dict[int, Approach] = {}
    for (obj, own), some in zip(modes.by_object, drawn, strict=True):
        surface_m = None if finger is None else np.concatenate([obj.mesh.sample(POINTS, rng), obj.mesh.hull_corners_m])
        for n in np.flatnonzero(np.isin(aimed, own)).tolist():
            T = some[n].T_base_sensor
            if finger is not None and surface_m is not None:
                T = _bring_contact_to_gel(T, surface_m, finger, modes, rng)
            approaches[n] = replace(some[n], T_base_sensor=modes.T_base_object[aimed[n]] @ T)
    return [approaches[n] for n in range(count)]


def _measure_spread_m(modes: PoseModes) -> float:
    """Return the radius of spheres about the object's centre in each mode that contain the object in every mode."""
    centres_m = np.empty((len(modes.probabilities), 3))
    for obj, own in modes.by_object:
        T = modes.T_base_object[own]
        centres_m[own] = T[:, :3, :3] @ obj.mesh.centroid_m + T[:, :3, 3]
    apart_m = np.linalg.norm(centres_m[:, None] - centres_m[None], axis=-1).max()
    return float(apart_m) + max(_measure_radius_m(obj) for obj, _ in modes.by_object)


def _bring_contact_to_gel(
    T_object_sensor: Poses, surface_m: Floats, finger: TriangleMesh, modes: PoseModes, rng: np.random.Generator
) -> Poses:
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


def _measure_radius_m(obj: ObjectModel) -> float:
    return float(np.linalg.norm(obj.mesh.corners_m - obj.mesh.centroid_m, axis=1).max())


def _draw_clear(
    obj: ObjectModel, geometry: SensorGeometry, count: int, start_m: float, rng: np.random.Generator
) -> list[Approach]:
    """Return approaches in the object's frame whose gels start `start_m` metres before the plane of its centre."""
    centre = obj.mesh.centroid_m
    found = []
    for k, (R, aim_m) in enumerate(zip(draw_rotations(count, rng), obj.mesh.sample(count, rng), strict=True)):
        z = R[:, 2]
        beside_m = aim_m - centre - z * (z @ (aim_m - centre))
        T = make_transform(R, centre + beside_m - z * (start_m + geometry.surface_m))
        found.append(Approach(T, travel_m=2 * start_m, name=f"approach-{k:03d}"))
    return found
