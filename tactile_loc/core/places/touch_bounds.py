"""The bounds that a touch sets for the surface of a place: what an elastic gel shows of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, make_transform
from tactile_loc.core.places.places import Float32, Places
from tactile_loc.core.runtime.turns import split_into_turns
from tactile_loc.core.sensing.gel_surface import SLACK
from tactile_loc.core.sensing.touch import Touch

MOST_EXCESS = 0.3  # share of the press beyond which a place's distance from the gel's surface counts as equal
COMPARED = 20_000  # rotated places that are compared with a touch in one turn


@dataclass(frozen=True, eq=False)
class TouchBounds:
    """The bounds of a touch for the surface of a place, for each of M yaws by which a place may be rotated.

    `low_m` and `high_m` (M, PATCH_PX, PATCH_PX), metres, and `most_m` are as for `measure_excess`. The yaws are about
    the z axis of the frame at the touch's deepest point, `T_sensor_anchor` (4, 4), metres.
    """

    T_sensor_anchor: Poses
    low_m: Float32
    high_m: Float32
    most_m: float

    def measure_excess(self, places: Places, numbers: NDArray[np.int64], yaws: NDArray[np.int64]) -> Float32:
        """Return how far rotated places leave the bounds (K,), square metres: see `measure_excess`.

        Pair k is the place `numbers[k]` at the yaw number `yaws[k]`.
        """
        from tactile_loc.core.places.rotated_patches import measure_excess

        return np.concatenate([
            measure_excess(places, numbers[some], yaws[some], self.low_m, self.high_m, self.most_m)
            for some in split_into_turns(len(numbers), COMPARED)
        ])  # fmt: skip


def bound_touch(touch: Touch, yaws_rad: NDArray[np.float64]) -> TouchBounds:
    """Return the bounds of what an elastic gel shows, at M yaws.

    Where the gel touches, a place must be at the gel's surface. Elsewhere, it must be beyond the surface.
    """
    from tactile_loc.core.places.rotated_patches import find_anchor, rotate_patches

    anchor_m, R_sensor_gel = find_anchor(touch)
    surface_m, seen = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad)
    contact = touch.geometry.observed_mask & touch.touching_shape.contact
    touching = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad, contact)[1]
    far = np.float32(np.inf)
    beyond_m = surface_m - np.float32(SLACK * touch.indentation_m)
    low_m = np.where(touching, surface_m, np.where(seen, beyond_m, -far))
    high_m = np.where(touching, surface_m, far)
    T_sensor_anchor = make_transform(R_sensor_gel, anchor_m)
    return TouchBounds(T_sensor_anchor, low_m, high_m, MOST_EXCESS * touch.indentation_m)
