"""Dense matching of pixels: the touches' contact shapes against drawn shapes of many poses, without registration."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, Float32, ObjectModel, Poses, Scene, SensorGeometry, Touch, registry
from tactile_loc.plugin.helpers import (
    PATCH_PX,
    PITCH_M,
    align_to_z,
    find_anchor,
    invert,
    make_transform,
    rotate_patches,
    rotation_about,
)

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses
from tactile_loc_benchmark.methods.surface_fit import list_best
from tactile_loc_benchmark.methods.touched_points import find_sensor_pose, view_touches

RENDERER = "heightmap"
CAMERA = SensorGeometry(
    "orthographic", PATCH_PX, PATCH_PX, 1 / PITCH_M, 1 / PITCH_M, PATCH_PX / 2, PATCH_PX / 2, 0.1, 3e-3
)  # the camera of the patches of `rotate_patches`, for presses of up to 3 mm
GOLDEN_RAD = np.pi * (3 - np.sqrt(5))  # the turn from one point of a spiral on the sphere to the next


class PixelMatching(Method):
    """Compares the pixels of contact shapes, the baseline of Bauza et al. (CoRL 2020), without registration.

    The poses are all rotations of a grid: evenly spread directions, and yaws about the sensor's axis. The foremost
    point lies at the touch's deepest point, which replaces a grid of positions. The poses with the least squared
    difference of depths are then compared with all touches, by the mean intersection over union of imprints. This
    second comparison is our addition, as the paper's baseline has one touch only.
    """

    paper: ClassVar[str] = "Bauza et al., CoRL 2020 (baseline)"

    class Options(ComponentOptions):
        """The density of the grid."""

        directions: int = Field(default=4000, ge=10, description="number of directions over the whole sphere")
        yaws: int = Field(default=72, ge=4, description="number of yaws about each direction")
        candidates: int = Field(default=1000, ge=1, description="number of poses that are compared with all touches")
        image_px: int = Field(default=40, ge=8, description="pixels of the longer side of the compared shapes")

    def prepare(self, problem: LocatingProblem) -> None:
        """Draw the object from all directions."""
        self._renderer = registry().create("renderer", RENDERER, {})
        self._T_place_object = stand_on_points(problem.object, self.options.directions)
        self._depths_m = Scene(problem.object, CAMERA, self._renderer).render_contact_depths(
            make_transform(np.eye(3), [0.0, 0.0, CAMERA.standoff_m]) @ self._T_place_object
        )

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the poses of the grid that are most similar to all touches."""
        T_base_first = find_sensor_pose(touches[0])
        most = -(-self.options.candidates // len(touches))
        T = np.concatenate([find_sensor_pose(touch) @ self._match(touch, most) for touch in touches])
        views = view_touches(touches, problem.object, self._renderer)
        T_first_object = invert(T_base_first) @ T
        ious = [view.imprint_ious(T_first_object, self.options.image_px) for view in views]
        return list_best(T, np.mean(ious, axis=0), problem.object)

    def _match(self, touch: Touch, most: int) -> Poses:
        """Return the poses T_sensor_object (most, 4, 4), metres, with the least squared difference of depths."""
        anchor_m, R_sensor_gel = find_anchor(touch)
        yaws_rad = 2 * np.pi * np.arange(self.options.yaws) / self.options.yaws
        seen_m, observed = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad)
        bank = np.minimum(self._depths_m, np.float32(touch.press_depth_m))
        number, yaw = np.unravel_index(
            np.argsort(measure_differences(seen_m, observed, bank), axis=None, kind="stable")[:most],
            (len(bank), len(yaws_rad)),
        )
        turned = make_transform(rotation_about([0, 0, 1], yaws_rad[yaw]), np.zeros(3))
        return np.asarray(make_transform(R_sensor_gel, anchor_m) @ turned @ self._T_place_object[number])


def stand_on_points(obj: ObjectModel, count: int) -> Poses:
    """Return poses T_place_object (count, 4, 4), metres, with the object's lowest point at the origin.

    The directions that point down are a spiral over the sphere, so they are evenly spread.
    """
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    azimuth_rad = GOLDEN_RAD * np.arange(count)
    level = np.sqrt(1 - z**2)
    R = np.stack(
        [align_to_z(d) for d in np.column_stack([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), z])]
    )
    corners = obj.mesh.hull_corners_m @ np.swapaxes(R, -1, -2)
    return make_transform(R, -corners[np.arange(count), corners[..., 2].argmin(axis=1)])


def measure_differences(seen_m: Float32, observed: NDArray[np.bool_], drawn_m: Float32) -> Float32:
    """Return the sums (N, M) of squared differences of M seen patches from N drawn ones, over the observed pixels.

    All patches are (H, W), metres.
    """
    mask = observed.reshape(len(observed), -1).astype(np.float32)
    drawn, seen = (1e3 * np.asarray(a, np.float32).reshape(len(a), -1) for a in (drawn_m, seen_m))
    seen = seen * mask
    return np.asarray(np.square(drawn) @ mask.T - 2 * drawn @ seen.T + np.square(seen).sum(axis=1))
