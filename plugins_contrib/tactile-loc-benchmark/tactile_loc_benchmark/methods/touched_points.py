"""The points that several touches of one object show, in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import ObjectModel, Poses, Renderer, Scene, Touch, TouchError, View
from tactile_loc.plugin.helpers import invert, make_contact_cloud, transform_points

IMAGE_PX = 80  # touches are thinned to about this many pixels on the longer side before points are taken
DEEPEST_SHARE = 0.05  # pixels within this share of the press depth of the deepest pixel count as deepest

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TouchedPoints:
    """Points of touches in the frame of the first touch's sensor.

    `points_m` (P, 3), metres, lie on the object's surface, and `normals` (P, 3) point out of the object. `touch` (P,)
    has the number of each point's touch. `T_base_first` (4, 4), metres, is the pose of the first touch's sensor.
    Methods search in the frame of the first sensor, so that the choice of the base frame does not matter.
    """

    points_m: Floats
    normals: Floats
    touch: NDArray[np.int64]
    T_base_first: Poses

    @classmethod
    def of(cls, touches: Sequence[Touch], most: int) -> TouchedPoints:
        """Return at most `most` points, about equally many of each touch.

        Raises TouchError if a touch has no depths or no `T_base_sensor`.
        """
        T_base_first = find_sensor_pose(touches[0])
        points, normals, numbers = [], [], []
        for k, touch in enumerate(touches):
            T = invert(T_base_first) @ find_sensor_pose(touch)
            geometry, shape = touch.thin(IMAGE_PX)
            if not (shape.contact & geometry.observed_mask).any():  # a contact of a few pixels between the thin ones
                geometry, shape = touch.geometry, touch.touching_shape
            own_m, own_normals = make_contact_cloud(shape, geometry, walls=False)
            some = spread_indices(len(own_m), max(1, most // len(touches)))
            points.append(transform_points(T, own_m[some]))
            normals.append(own_normals[some] @ T[:3, :3].T)
            numbers.append(np.full(len(some), k))
        return cls(np.concatenate(points), np.concatenate(normals), np.concatenate(numbers), T_base_first)

    def thin(self, most: int) -> TouchedPoints:
        """Return at most `most` of the points, evenly spread over the touches."""
        some = spread_indices(len(self.points_m), most)
        return TouchedPoints(self.points_m[some], self.normals[some], self.touch[some], self.T_base_first)

    @property
    def weights(self) -> Floats:
        """Weights (P,) of the points, with the sum 1. All touches have the same weight."""
        _, of, count = np.unique(self.touch, return_inverse=True, return_counts=True)
        return 1.0 / (count[of] * len(count))


def find_sensor_pose(touch: Touch) -> Poses:
    """Return the `T_base_sensor` (4, 4), metres, of a touch with depths. Raises TouchError if either is missing."""
    if touch.T_base_sensor is None:
        raise TouchError(f"{touch.name} has no sensor pose; give its T_base_sensor")
    if not touch.has_depths:
        raise TouchError(f"{touch.name} is a contact mask, but this method needs depths; give a depth map")
    return touch.T_base_sensor


def view_touches(touches: Sequence[Touch], obj: ObjectModel, renderer: Renderer) -> list[View]:
    """Return the views of touches of an object from the first sensor. Raises TouchError as `find_sensor_pose` does."""
    T_base_first = find_sensor_pose(touches[0])
    views = [View(touches[0], Scene(obj, touches[0].geometry, renderer))]
    for touch in touches[1:]:
        T = invert(find_sensor_pose(touch)) @ T_base_first
        views.append(View(touch, Scene(obj, touch.geometry, renderer), T))
    return views


def find_deepest_point(touch: Touch) -> Floats:
    """Return the touch's deepest point (3,), metres, in its sensor's frame: the middle of its deepest pixels."""
    geometry, shape = touch.geometry, touch.touching_shape
    contact = shape.contact & geometry.observed_mask
    least_m = shape.depth_m[contact].min()
    deepest = contact & (shape.depth_m <= least_m + np.float32(DEEPEST_SHARE * shape.press_depth_m))
    return np.asarray(geometry.backproject(shape.depth_m + geometry.full_penetration_m)[deepest].mean(axis=0))


def spread_indices(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` indices below `count`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
