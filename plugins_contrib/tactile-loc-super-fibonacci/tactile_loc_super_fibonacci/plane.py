"""Where in the plane a turned object can touch the sensor, and the lattice of places there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tactile_loc.core.geometry import make_transform
from tactile_loc.core.objects import ObjectModel, TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

Float = NDArray[np.float64]

_CORNERS = 1_000_000  # corners turned at once: 24 MB


def reachable(obj: ObjectModel, R: Float, geometry: SensorGeometry) -> tuple[Float, Float]:
    """Return the least and greatest x, y (N, 2), metres, sensor frame, of the centroid at rotations R (N, 3, 3).

    Between them the turned object's bounding box overlaps the sensing rectangle; beyond, nothing can touch.
    """
    x0, x1, y0, y1 = geometry.rectangle
    corners = _outermost(obj.mesh) - obj.mesh.centroid_m
    low, high = np.empty((len(R), 2)), np.empty((len(R), 2))
    for start in range(0, len(R), step := max(1, _CORNERS // len(corners))):
        some = slice(start, start + step)
        turned = corners @ np.swapaxes(R[some, :2], -1, -2)
        low[some] = np.array([x0, y0]) - turned.max(axis=1)
        high[some] = np.array([x1, y1]) - turned.min(axis=1)
    return low, high


def lattice_counts(low_m: Float, high_m: Float, pitch_m: float) -> NDArray[np.int64]:
    """Return how many columns and rows (..., 2) of squares of `pitch_m` cover from low to high (..., 2), metres.

    A range that is a whole number of pitches, up to rounding, gets no more than that; an empty one gets one square.
    """
    return np.maximum(np.ceil((high_m - low_m) / pitch_m - 1e-9), 1).astype(np.int64)


def lattice(low_m: Float, high_m: Float, pitch_m: float) -> Float:
    """Return the points (K, 2), metres, of a square lattice of a pitch, centred between low (2,) and high (2,)."""
    x, y = (
        middle + pitch_m * (np.arange(n) - (n - 1) / 2)
        for middle, n in zip((low_m + high_m) / 2, lattice_counts(low_m, high_m, pitch_m), strict=True)
    )
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def with_centroid_at(obj: ObjectModel, R: Float, xy_m: Float) -> Poses:
    """Return poses (N, 4, 4) of rotations (N, 3, 3), the surface's centroid at (x, y, 0), `xy_m` (N, 2) in metres."""
    centroid_m = np.column_stack([xy_m, np.zeros(len(xy_m))])
    return make_transform(R, centroid_m - R @ obj.mesh.centroid_m)


def _outermost(mesh: TriangleMesh) -> Float:
    """The vertices (V, 3), metres, that bound the surface from every side: those of its convex hull."""
    from scipy.spatial import ConvexHull, QhullError

    used: Float = mesh.vertices_m[np.unique(mesh.faces)]
    try:
        return np.asarray(used[ConvexHull(used).vertices])
    except QhullError:  # a flat surface has no hull
        return used
