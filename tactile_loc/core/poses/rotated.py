"""Poses that may be rotated by any yaw about the sensor's z axis, and the search for the nearest of these poses.

Write phi(T) of the pose metric as a matrix P (3, k), with one column for each axis of the object's spread and one for
its centroid. A rotation by a yaw gives Rz P. The least |A - Rz B|^2 over yaws follows from the largest trace of
Rz^T A B^T. Write rows 0 and 1 of A as complex numbers a, those of B as b, and let z = sum a conj(b). The largest trace
is |z| + A_2 . B_2, at the yaw arg z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.metric import PoseMetric

Float = NDArray[np.float64]

AT_ONCE = 4_000_000  # largest number of pairs of poses compared together


class RotatedPoses:
    """N poses `T_sensor_object` (N, 4, 4), metres, each of which may be rotated by any yaw about the sensor's z."""

    def __init__(self, T_sensor_object: Poses, metric: PoseMetric) -> None:
        self.metric = metric
        self._across, self._along = _rows(metric.embed_orbits(T_sensor_object)[0])
        self._squared = _squared(self._across, self._along)

    def __len__(self) -> int:
        return len(self._squared)

    def nearest(self, T_sensor_object: Poses) -> tuple[Float, NDArray[np.int64], Float]:
        """Return the index (M,) and the yaw (M,), rad, of the rotated pose nearest to each pose (M, 4, 4), metres.

        The first return value is the distance (M,), metres, up to the object's symmetry.
        """
        count = len(T_sensor_object)
        found = np.empty(count), np.empty(count, np.int64), np.empty(count)
        step = max(1, AT_ONCE // len(self))
        for start in range(0, count, step):
            for whole, part in zip(found, self._nearest(T_sensor_object[start : start + step]), strict=True):
                whole[start : start + step] = part
        return found

    def _nearest(self, T_sensor_object: Poses) -> tuple[Float, NDArray[np.int64], Float]:
        rows = np.arange(len(T_sensor_object))
        least, index, yaw_rad = np.full(len(rows), np.inf), np.zeros(len(rows), np.int64), np.zeros(len(rows))
        for phi in self.metric.embed_orbits(T_sensor_object):
            across, along = _rows(phi)
            rotated = across @ self._across.conj().T
            gained = self._squared - 2 * (np.abs(rotated) + along @ self._along.T)
            best = gained.argmin(axis=1)
            squared = gained[rows, best] + _squared(across, along)
            better = squared < least
            least, index = np.where(better, squared, least), np.where(better, best, index)
            yaw_rad = np.where(better, np.angle(rotated[rows, best]), yaw_rad)
        return np.sqrt(np.maximum(least, 0.0)), index, yaw_rad

    def distances(self, T_sensor_object: Poses, numbers: NDArray[np.int64], yaw_rad: Float) -> Float:
        """Return the distances (M, V), metres, of poses (M, 4, 4) from the poses `numbers` (M,) at yaws (M, V), rad.

        Distances are up to the object's symmetry.
        """
        least = np.full(yaw_rad.shape, np.inf)
        ours, heights = self._across[numbers], self._along[numbers]
        for phi in self.metric.embed_orbits(T_sensor_object):
            across, along = _rows(phi)
            rotated = np.einsum("mk,mk->m", across, ours.conj())[:, None]
            trace = (rotated * np.exp(-1j * yaw_rad)).real + np.einsum("mk,mk->m", along, heights)[:, None]
            least = np.minimum(least, (self._squared[numbers] + _squared(across, along))[:, None] - 2 * trace)
        return np.asarray(np.sqrt(np.maximum(least, 0.0)))


def _rows(phi: Float) -> tuple[NDArray[np.complex128], Float]:
    """Split points (N, 3 k) of the metric's space into rows 0 and 1, as complex numbers (N, k), and row 2 (N, k).

    The last three numbers of a point are the centroid. The numbers before are a matrix (3, k - 1), row by row.
    """
    matrix = phi[:, :-3].reshape(len(phi), 3, -1)
    columns = np.concatenate([matrix, phi[:, -3:, None]], axis=2)
    return columns[:, 0] + 1j * columns[:, 1], columns[:, 2]


def _squared(across: NDArray[np.complex128], along: Float) -> Float:
    return np.asarray((np.abs(across) ** 2).sum(axis=1) + (along**2).sum(axis=1))
