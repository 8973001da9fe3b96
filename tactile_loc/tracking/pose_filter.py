"""A Kalman filter of one object's pose, from touches whose errors are correlated from frame to frame.

The error (6,) of a pose has two parts: x, y, z of the object frame's origin (m), then a rotation vector (rad). Both are
along the axes of the frame in which the pose is given, as in `lie.compute_pose_errors` and
`RefinedPose.covariance`.

Frames of one contact have similar errors. If these errors counted as independent, a thousand frames would seem thirty
times as exact as one. So the filter's unknowns are the pose, the touches' common error and the error of the sensor's
reported pose. Both errors change as the sensor moves, as first-order autoregressive processes (coloured noise: Bryson
and Johansen, 1965). Where a touch does not determine the pose, the filter keeps its prediction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.hand_eye import UNIT
from tactile_loc.core.geometry.lie import compute_pose_errors, move, move_covariance
from tactile_loc.core.geometry.rigid import Floats, cross_matrix, invert

FREEDOM = 4.0  # degrees of freedom of Student's t
POSE, TOUCH, SENSOR = slice(0, 6), slice(6, 12), slice(12, 18)


@dataclass(frozen=True, eq=False)
class SeenPose:
    """The pose (4, 4), metres, that one touch gives, with the sensor's reported pose `T_base_sensor` (4, 4), metres.

    The touch's error is the sum of two errors. One has the covariance `common` (6, 6), and persists from touch to touch
    of one contact. The other has the covariance `own` (6, 6). The error of the sensor's pose has the covariance
    `sensor` (6, 6). It is along the sensor's axes, and about the point `at_m` (3,), metres, in the sensor's frame.
    """

    T_base_sensor: Floats
    T_sensor_object: Floats
    common: Floats
    own: Floats
    sensor: Floats
    at_m: Floats


@dataclass(frozen=True, eq=False)
class PoseFilter:
    """The estimated pose of an object, T_base_object (4, 4), metres, and three errors of six components each.

    The errors are those of the pose, of the touches (the common part, along the sensor's axes), and of the sensor's
    pose. `errors` (12,) is the mean of the last two, and `covariance` (18, 18) the covariance of all three. Both are in
    units of `hand_eye.UNIT`. `surprise` is that of the last touch: see `measure_surprise`.
    """

    T_base_object: Floats
    errors: Floats
    covariance: Floats
    surprise: float = 0.0

    @classmethod
    def known(cls, T_base_object: Floats, covariance: Floats) -> PoseFilter:
        """Start from a pose (4, 4), metres, with a covariance (6, 6)."""
        P = np.zeros((18, 18))
        P[POSE, POSE] = _to_unit(covariance)
        return cls(T_base_object, np.zeros(12), P)

    def predict(self, creep: Floats) -> PoseFilter:
        """Return the filter after the object may have moved.

        `creep` (6, 6) is the covariance of this motion, along the base's axes.
        """
        P = self.covariance.copy()
        P[POSE, POSE] += _to_unit(creep)
        return replace(self, covariance=P)

    def view_from(self, T_base_sensor: Floats, at_m: Floats) -> tuple[Floats, Floats]:
        """Return T_sensor_object (4, 4), metres, and its covariance (6, 6).

        The sensor is reported at T_base_sensor (4, 4), metres, with errors about the point `at_m` (3,), metres, in its
        frame.
        """
        T = invert(T_base_sensor) @ self.T_base_object
        G = _propagate_errors(T_base_sensor, T, at_m)
        G[:, TOUCH] = 0.0
        return move(T, UNIT * (G[:, 6:] @ self.errors)), _from_unit(G @ self.covariance @ G.T)

    @property
    def base_covariance(self) -> Floats:
        """The covariance (6, 6) of T_base_object, along the base's axes."""
        return _from_unit(self.covariance[POSE, POSE])

    def update(self, seen: SeenPose, share: float) -> PoseFilter:
        """Return the filter after a touch.

        `share`, 0 to 1, is the share of the common errors of touches and sensor poses that is new since the previous
        touch.
        """
        expected = self._expect(seen, share)
        P, H, e, fresh = expected.covariance, expected.H, expected.error, 1 - (1 - share) ** 2
        # Student's t has heavy tails, which allow for registrations that end in a wrong local minimum
        doubt = max(1.0, (FREEDOM + expected.surprise) / (FREEDOM + 6))
        P[TOUCH, TOUCH] += doubt * fresh * _to_unit(seen.common)
        own = doubt * _to_unit(seen.own)
        S = H @ P @ H.T + own
        K = np.linalg.solve(S, H @ P).T
        kept_back = np.eye(18) - K @ H
        P = kept_back @ P @ kept_back.T + K @ own @ K.T  # Joseph's form keeps the covariance positive definite
        errors = (1 - share) * self.errors + K[6:] @ e
        T = move(self.T_base_object, UNIT * (K[POSE] @ e))
        return PoseFilter(T, errors, (P + P.T) / 2, expected.surprise)

    def measure_surprise(self, seen: SeenPose, share: float) -> float:
        """Return the squared error of the predicted pose of a touch, in standard deviations; 6 on average.

        `share` is as for `update`.
        """
        return self._expect(seen, share).surprise

    def _expect(self, seen: SeenPose, share: float) -> _Expected:
        kept = np.concatenate([np.ones(6), np.full(12, 1 - share)])
        P = kept[:, None] * self.covariance * kept
        fresh = 1 - (1 - share) ** 2
        P[SENSOR, SENSOR] += fresh * _to_unit(seen.sensor)
        T = invert(seen.T_base_sensor) @ self.T_base_object
        H = _propagate_errors(seen.T_base_sensor, T, seen.at_m)
        e = compute_pose_errors(seen.T_sensor_object, T) / UNIT - (1 - share) * (H[:, 6:] @ self.errors)
        S = H @ P @ H.T + fresh * _to_unit(seen.common) + _to_unit(seen.own)
        return _Expected(P, H, e, float(e @ np.linalg.solve(S, e)))


class _Expected(NamedTuple):
    """What a filter expects of a touch.

    H (6, 18) is the matrix from the filter's errors, with their `covariance` (18, 18), to the touch's pose. `error`
    (6,) is the difference of the touch's pose from the predicted pose. `surprise` is its square, in standard
    deviations.
    """

    covariance: Floats
    H: Floats
    error: Floats
    surprise: float


def _propagate_errors(T_base_sensor: Floats, T_sensor_object: Floats, at_m: Floats) -> Floats:
    """Return the matrix (6, 18) from errors of pose, touch and sensor to the error of T_sensor_object.

    All errors are in units of `hand_eye.UNIT`.
    """
    H = np.zeros((6, 18))
    H[:3, :3] = H[3:, 3:6] = T_base_sensor[:3, :3].T
    H[:, TOUCH] = H[:, SENSOR] = np.eye(6)
    H[:3, 15:] = -cross_matrix(T_sensor_object[:3, 3] - at_m)
    H[:3, 15:] *= UNIT[3] / UNIT[0]
    return H


def _to_unit(covariance: Floats) -> Floats:
    return covariance / UNIT / UNIT[:, None]


def _from_unit(covariance: Floats) -> Floats:
    return covariance * UNIT * UNIT[:, None]


def estimate_motion_errors(covariance: Floats, T_base_sensor: Floats, T_base_object: Floats) -> Floats:
    """Return the covariance (6, 6) of T_base_object (4, 4) that comes from errors of the sensor's motion.

    The sensor has moved to T_base_sensor (4, 4), metres. `covariance` (6, 6) is that of the motion, about the sensor
    frame's origin. Both covariances are along the base's axes.
    """
    return move_covariance(covariance, T_base_object[:3, 3] - T_base_sensor[:3, 3])
