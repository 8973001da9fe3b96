"""Estimates of poses from single touches, and their combination.

The combined pose has the least sum of squared errors on SE(3), each weighted by its information. The method is that of
Barfoot and Furgale, "Associating Uncertainty With Three-Dimensional Poses for Use in Estimation Problems" (IEEE
Transactions on Robotics 30(3), 2014), for the fusion of poses. Here, the error of a sensor's pose adds to its touch's
covariance, and a prior adds a term.

Lengths are in mm inside this module. A twist (6,) is a rotation vector (rad), then a translation (mm). Twists of touch
i are about the middle of its gel, in the frame of its sensor. Twists of the object are about its centroid, in the frame
of the first sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.lie import adjoint, exponential, logarithm, move_covariance
from tactile_loc.core.geometry.rigid import Floats, Poses, cross_matrix, invert
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.joint_registration import (
    Covariances,
    JointRegistration,
    convert_to_covariances,
    scale,
    scale_factors,
)
from tactile_loc.core.registration.observations import MILLI
from tactile_loc.core.registration.prior_factors import fit_prior_factors
from tactile_loc.core.sensing.scene import View

STEPS, SETTLED_MM = 20, 1e-7  # most Gauss-Newton steps, and the length of a step at convergence
LEVER_MM = 10.0  # a rotation counts as the motion of a point at this distance from its axis
LEAST = 1e-6  # information, 1/mm^2 or 1/rad^2, that holds a pose where no touch and no prior determines it
Order = [3, 4, 5, 0, 1, 2]


class Estimates(NamedTuple):
    """What each of N touches alone says of K poses.

    `T` (K, N, 4, 4), mm, are the poses in the frame of each touch's sensor, and `information` (K, N, 6, 6) is about the
    twists from them. A touch without information has no effect.
    """

    T: Floats
    information: Floats

    @classmethod
    def of(cls, views: Sequence[View], alone: Sequence[Sequence[RefinedPose]]) -> Estimates:
        """Return the estimates from `alone`: K poses for each of N views, metres, in the frame of its own sensor.

        The information of a pose is that of its covariance. If the refiner gave none, the information is that of the
        touch at the pose, by the equations of the joint registration.
        """
        poses, information = [], []
        for view, found in zip(views, alone, strict=True):
            T = np.stack([pose.T_sensor_object for pose in found])
            own = JointRegistration().measure_information(view, T, view.touch.geometry.gel_middle_m)
            for k, pose in enumerate(found):
                if pose.covariance is not None:
                    own[k] = _invert_covariance(pose.covariance, view.touch.geometry.gel_middle_m - T[k, :3, 3])
            poses.append(scale(T))
            information.append(own)
        return cls(np.stack(poses, axis=1), np.stack(information, axis=1))


@dataclass(frozen=True, eq=False)
class PoseFusion:
    """The problem of combining estimates: poses of the object with the least weighted errors.

    `T_sensor_first` (N, 4, 4) and `centres` (N, 3), the middles of the gels, are in mm. `sensor` (N, 6) are the
    variances of the errors of the sensors' poses. `middle` (3,), mm, is the object's centroid.
    """

    estimates: Estimates
    T_sensor_first: Floats
    centres: Floats
    sensor: Floats
    middle: Floats

    @classmethod
    def of(cls, views: Sequence[View], estimates: Estimates) -> PoseFusion:
        """Return the problem of combining estimates from views of one object."""
        std = [[view.sensor_std_rad] * 3 + [view.sensor_std_m * MILLI] * 3 for view in views]
        return cls(
            estimates,
            scale(np.stack([view.T_sensor_first for view in views])),
            np.stack([view.touch.geometry.gel_middle_m * MILLI for view in views]),
            np.square(std),
            views[0].scene.object.mesh.centroid_m * MILLI,
        )

    @property
    def weights(self) -> Floats:
        """The information (K, N, 6, 6) of each touch, reduced by the error of its sensor's pose: (1 + A S)^-1 A."""
        A = self.estimates.information
        return np.asarray(np.linalg.solve(np.eye(6) + A * self.sensor[:, None, :], A))

    def solve(self, T_first_object: Poses, prior: Prior | None = None) -> Floats:
        """Move poses (K, 4, 4), metres, in the first sensor's frame until their errors are least; return them in mm.

        A `prior` over these poses decides where the estimates leave a pose open.
        """
        weights, T = self.weights, scale(T_first_object)
        factors = None
        if prior is not None:
            factors = scale_factors(fit_prior_factors(prior, T_first_object, self.middle / MILLI))
        for _ in range(STEPS):
            r, J = self._linearise(T)
            JW = J.swapaxes(-1, -2) @ weights
            H, g = (JW @ J).sum(axis=1), -(JW @ r[..., None]).sum(axis=1)
            centres = self._find_centres(T)
            if factors is not None:
                H += factors.information
                g += factors.information @ logarithm(factors.T @ invert(T), centres)[..., None]
            x = np.linalg.solve(H + LEAST * np.eye(6), g)[..., 0]
            T = exponential(x, centres) @ T
            if (np.abs(x) * ([LEVER_MM] * 3 + [1.0] * 3)).max(initial=0.0) < SETTLED_MM:
                break
        return T

    def see(self, T: Floats) -> tuple[Floats, Floats]:
        """Return poses (K, N, 4, 4) of the object as each sensor sees it, given the poses T (K, 4, 4) of `solve`.

        The difference of a touch's estimate from T is divided between the estimate's error and that of the sensor's
        pose, in proportion to their covariances. Also return the costs (K, N), nats, of the errors of the sensors.
        """
        seen = self.T_sensor_first @ T[:, None]
        differences = logarithm(self.estimates.T @ invert(seen), self.centres)
        pulls = (self.weights @ differences[..., None])[..., 0]
        errors = self.sensor * pulls
        return np.asarray(exponential(errors, self.centres) @ seen), (errors * pulls).sum(axis=-1) / 2

    def describe(self, T: Floats) -> list[RefinedPose]:
        """Return poses T (K, 4, 4) of `solve` as refined poses, with the poses that each sensor sees and covariances.

        The first touch sees the object in its sensor's frame without the error of the sensor's pose, and the others see
        it with this error. A prior does not count.
        """
        Ad, seen = self._change(T), self.see(T)[0]
        parts = Ad.swapaxes(-1, -2) @ self.weights @ Ad
        others, back = parts[:, 1:].sum(axis=1), np.linalg.inv(Ad[:, 0])
        error = back * self.sensor[0] @ back.swapaxes(-1, -2)
        first = Ad[:, 0].swapaxes(-1, -2) @ self.estimates.information[:, 0] @ Ad[:, 0]
        own = self._cover(first + np.linalg.solve(np.eye(6) + others @ error, others), T)
        reported = self._cover(parts.sum(axis=1), T)
        here = scale(invert(self.T_sensor_first[0]) @ seen[:, 0], 1 / MILLI)
        return [
            RefinedPose(here[k], 0.0, True, 0, own[k], each, T_reported, reported[k])
            for k, (each, T_reported) in enumerate(zip(scale(seen, 1 / MILLI), scale(T, 1 / MILLI), strict=True))
        ]

    def _cover(self, information: Floats, T: Floats) -> Covariances:
        """Return the covariances of poses T (K, 4, 4) with this information (K, 6, 6) about twists of the object."""
        return convert_to_covariances(_symmetric(information), T[:, :3, :3] @ (self.middle / MILLI))

    def _linearise(self, T: Floats) -> tuple[Floats, Floats]:
        """Return the twists (K, N, 6) from the estimates to T (K, 4, 4), and their derivatives (K, N, 6, 6) by x.

        x is a twist of T. For a rotation vector a, the derivative is the inverse of the left Jacobian of SO(3).
        """
        r = logarithm(self.T_sensor_first @ T[:, None] @ invert(self.estimates.T), self.centres)
        G = np.broadcast_to(np.eye(6), (*r.shape, 6)).copy()
        G[..., :3, :3], G[..., 3:, :3] = _invert_left_jacobian(r[..., :3]), -cross_matrix(r[..., 3:])
        return r, G @ self._change(T)

    def _change(self, T: Floats) -> Floats:
        """Return matrices (K, N, 6, 6) from twists of the object at T (K, 4, 4) to twists of each touch."""
        seen = self.T_sensor_first @ T[:, None]
        return adjoint(self.T_sensor_first[:, :3, :3], self.centres - self._find_centres(seen))

    def _find_centres(self, T: Floats) -> Floats:
        return np.asarray(T[..., :3, :3] @ self.middle + T[..., :3, 3])


def _invert_covariance(covariance: Floats, to_centre_m: Floats) -> Floats:
    """Return the information (6, 6) about twists about a centre, which is `to_centre_m` (3,) from the object's origin.

    The covariance (6, 6) is that of a `RefinedPose`.
    """
    unit = np.array([MILLI] * 3 + [1.0] * 3)
    moved = move_covariance(covariance, to_centre_m) * unit * unit[:, None]
    return _symmetric(np.linalg.pinv(moved, hermitian=True)[Order][:, Order])


def _invert_left_jacobian(a: Floats) -> Floats:
    """Return the inverses (..., 3, 3) of the left Jacobians of SO(3) at rotation vectors a (..., 3)."""
    angle = np.maximum(np.linalg.norm(a, axis=-1), 1e-6)[..., None, None]
    K = cross_matrix(a)
    return np.asarray(np.eye(3) - 0.5 * K + (1 / angle**2 - 0.5 / (angle * np.tan(angle / 2))) * (K @ K))


def _symmetric(A: Floats) -> Floats:
    return np.asarray((A + A.swapaxes(-1, -2)) / 2)
