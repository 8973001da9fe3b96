"""Rough distances between the points of touches and the object's surface, to compare many poses quickly."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.runtime.turns import pause_before
from tactile_loc.core.sensing.clouds import make_contact_cloud, make_outline_cloud
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch

GAP_POINTS, GAP_PX = 30, 60  # points per touch, and long side of their image, pixels
A_TURN = 30_000  # poses that are compared with a touch in one turn


def estimate_gaps(views: Sequence[View], poses: Poses, cell_m: float | None = None) -> NDArray[np.float64]:
    """Return the summed distances (K,), metres, from the touches' points to the object's surface at poses (K, 4, 4).

    `cell_m`, metres, is the size of the cells of the surface's field: see `build_surface_field`.
    """
    from tactile_loc.core.objects.surface_field import build_surface_field  # numba takes a while to import

    field, seen_from = build_surface_field(views[0].scene.object.mesh, cell_m), invert(poses)
    gaps = np.zeros(len(poses))
    for view in views:
        pause_before(len(poses) / A_TURN)
        points_m = _list_gap_points(view.touch)
        gaps += field.estimate_gaps(points_m, seen_from @ invert(view.T_sensor_first))
    return gaps


@lru_cache(maxsize=32)
def _list_gap_points(touch: Touch) -> NDArray[np.float64]:
    """Return about GAP_POINTS points (P, 3), metres, of the surface in contact or, without depths, of its outline."""
    geometry, shape = touch.thin(GAP_PX)
    points_m = (make_contact_cloud if shape.depths_known else make_outline_cloud)(shape, geometry)[0]
    return points_m[:: max(1, len(points_m) // GAP_POINTS)]
