"""Registration of many poses, each to all touches at once, by robust Gauss-Newton steps.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). A touch's twist is about the
touch's centre, in the frame of its sensor. The object's twist is about the object's centre, in the frame of the first
sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.objects.blocks import Blocks, NearestTriangles
from tactile_loc.core.registration.observations import Observed
from tactile_loc.core.registration.twists import adjoint, exponential, logarithm

SETTLED_MM = 1e-3  # a pose has converged if its last step was shorter
COARSELY = 3  # the first steps use one point out of this many
FARTHEST_RAD, FARTHEST_MM = 0.2, 3.0  # largest rotation and translation of a step
DAMPING = 1e-4
LEVER_MM = 10.0  # a rotation counts as the motion of a point at this distance from its axis
Floats = NDArray[np.float64]


class Registered(NamedTuple):
    """The registered poses of an object.

    `T` (K, 4, 4) are its poses in the first sensor's frame. `T_each` (K, N, 4, 4) are its poses in the frame of each
    touch's sensor, as this touch shows them. `T_reported` (K, 4, 4) are its poses relative to the reported pose of the
    first sensor, which has an error. `information` and `reported_information` (K, 6, 6) are the information about
    twists of T and T_reported, from before the last step. `moved` (K,) is the length of the last step, mm.
    """

    T: Floats
    T_each: Floats
    T_reported: Floats
    information: Floats
    reported_information: Floats
    moved: Floats


@dataclass(frozen=True, eq=False)
class Registration:
    """A registration problem: `observed`, the observations of N touches, and the touched object.

    The object has `triangles`, `samples` of its surface and a centre `middle` (3,). `T_sensor_first` (N, 4, 4) converts
    from the first sensor's frame to each sensor's frame. Each of these transforms has an unknown error, a twist about
    the touch's centre. The variances of this twist are the sum of `sensor` (N, 6), from the sensor's pose, and `press`
    (N, 6), from the press depth. `noise` is the least standard deviation of a point. The weights in `observed` assume
    this noise.
    """

    observed: Observed
    T_sensor_first: Floats
    sensor: Floats
    press: Floats
    noise: float
    triangles: NearestTriangles
    samples: Blocks
    middle: Floats

    def register(self, T: Floats, scales: Floats, finely: int) -> Registered:
        """Move poses T (K, 4, 4), in the first sensor's frame, so that they explain all touches.

        `scales` (I,) are the scales of the robust weights, one for each step. The last `finely` steps use all points.
        The other steps use one point out of COARSELY.
        """
        T, count = T.copy(), len(T)
        T_each = self.T_sensor_first @ T[:, None]
        parts, moved = np.zeros((count, 2, 6, 6)), np.full(count, np.inf)
        every, going = np.full(count, COARSELY), np.arange(count)
        for number, scale in enumerate(scales):
            if number + finely >= len(scales):
                every[:] = 1
            stepped = self._step(T[going], T_each[going], float(scale), every[going])
            T[going], T_each[going], parts[going], moved[going] = stepped
            if scale == scales[-1]:
                settled = moved[going] < SETTLED_MM
                done = settled & ((every[going] == 1) | (finely == 0))
                every[going[settled]] = 1
                going = going[~done]
                if not len(going):
                    break
        press, sensor = self.press[0], self.sensor[0]
        information = self._marginalise_first(parts, T, press, sensor)
        reported = self._marginalise_first(parts, T, press + sensor, np.zeros(6))
        return Registered(self._view_from_first(T, T_each[:, 0]), T_each, T, information, reported, moved)

    def _step(self, T: Floats, T_each: Floats, scale: float, every: NDArray[np.int64]) -> tuple[Floats, ...]:
        """Take one Gauss-Newton step of the object's poses T (K, 4, 4) and of its poses T_each in each touch.

        Return the new T, the new T_each, the information (K, 2, 6, 6) and the length (K,) of the step, mm. The first
        part of the information is from the first touch, the second from all other touches.

        Touch i gives the equations A u = b for a twist u of its pose in T_each. Its present error is e. Its new error s
        has the covariance S, and the object's twist is x. Then u = Ad x - e + s. Eliminating s gives the equations for
        Ad x: the matrix (1 + A S)^-1 A and the right side (1 + A S)^-1 (b + A e).
        """
        A, b = self._equations(T_each, scale, every)
        if len(self.press) == 1:
            return self._step_of_one(T, A[:, 0], b[:, 0])
        centres, R_each = self.observed.centres, self.T_sensor_first[:, :3, :3]
        nominal = self.T_sensor_first @ T[:, None]
        errors = logarithm(T_each @ invert(nominal), centres)
        Ad = adjoint(R_each, centres - nominal[..., :3, :3] @ self.middle - nominal[..., :3, 3])
        S = self.sensor + self.press
        right = np.concatenate([A, (b + (A @ errors[..., None])[..., 0])[..., None]], axis=-1)
        left = np.linalg.solve(np.eye(6) + A * S[:, None, :], right)
        each = Ad.swapaxes(-1, -2) @ left
        H_each = each[..., :6] @ Ad
        H, g = H_each.sum(axis=1), each[..., 6].sum(axis=1)
        first = Ad[:, 0].swapaxes(-1, -2) @ A[:, 0] @ Ad[:, 0]
        parts = np.stack([first, H - H_each[:, 0]], axis=1)
        x, moved = _solve_step(H, g)
        T = exponential(x, T[:, :3, :3] @ self.middle + T[:, :3, 3]) @ T
        # each touch's new error s, given the object's twist: S (1 + A S)^-1 (b + A e - A Ad x)
        own = left[..., 6] - (left[..., :6] @ (Ad @ x[:, None, :, None]))[..., 0]
        T_each = exponential(S * own, centres) @ (self.T_sensor_first @ T[:, None])
        return T, T_each, parts, moved

    def _step_of_one(self, T: Floats, A: Floats, b: Floats) -> tuple[Floats, ...]:
        """Take the step of `_step` for one touch with equations A (K, 6, 6) and b (K, 6).

        One touch cannot separate its own error from the object's pose, so only the pose moves.
        """
        seen, R = self.T_sensor_first @ T, self.T_sensor_first[:, :3, :3]
        lever = self.observed.centres - seen[:, :3, :3] @ self.middle - seen[:, :3, 3]
        Ad = adjoint(R, lever)
        across = Ad.swapaxes(-1, -2)
        H = across @ A @ Ad
        x, moved = _solve_step(H, (across @ b[..., None])[..., 0])
        T = exponential(x, T[:, :3, :3] @ self.middle + T[:, :3, 3]) @ T
        return T, (self.T_sensor_first @ T)[:, None], np.stack([H, np.zeros_like(H)], axis=1), moved

    def _equations(self, T_each: Floats, scale: float, every: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Build the equations A (K, N, 6, 6), b (K, N, 6) for twists that make T_each explain the touches better.

        If the points of all touches have a larger misfit than `noise`, their weights are reduced accordingly.
        """
        from tactile_loc.core.compiled import run_in_threads  # numba takes a while to import
        from tactile_loc.core.registration.kernels import build_equations

        A, b = np.zeros((*T_each.shape[:2], 6, 6)), np.zeros((*T_each.shape[:2], 6))
        misfit = np.zeros((len(T_each), 2))
        run_in_threads(
            build_equations, len(T_each), T_each, every, self.observed, self.triangles, self.samples, scale, A, b,
            misfit,
        )  # fmt: skip
        surer = np.minimum(1.0, self.noise**2 * misfit[:, 1] / np.maximum(misfit[:, 0], 1e-30))[:, None, None]
        return A * surer[..., None], b * surer

    def _marginalise_first(self, parts: Floats, T: Floats, own: Floats, others: Floats) -> Floats:
        """Return the information (K, 6, 6) about a twist of the object, along the axes of the first sensor.

        `parts` (K, 2, 6, 6) is the information from the first touch and from all other touches. They are reduced by
        errors with the variances `own` (6,) and `others` (6,), which are twists about the first touch's centre.

        The object's pose in the first sensor's frame is seen by the first touch with the error of its press depth, and
        by the others with the error of the first sensor's pose. The object's pose relative to the reported pose of the
        first sensor is seen by the first touch with both errors, and by the others with none of them.
        """
        to_centre = adjoint(np.eye(3), T[:, :3, :3] @ self.middle + T[:, :3, 3] - self.observed.centres[0])[:, None]
        allowed = np.stack([own, others])[:, None, :] * to_centre @ to_centre.swapaxes(-1, -2)
        total = np.linalg.solve(np.eye(6) + parts @ allowed, parts).sum(axis=1)
        return np.asarray((total + total.swapaxes(1, 2)) / 2)

    def _view_from_first(self, T: Floats, seen: Floats) -> Floats:
        """Correct poses T (K, 4, 4) by the error of the first sensor's pose, but not by the error of its press depth.

        T is relative to the reported pose of the first sensor. `seen` (K, 4, 4) are the poses that its touch shows. The
        difference is the sum of both errors, and is divided between them in proportion to their variances.
        """
        allowed = self.sensor[0] + self.press[0]
        share = np.divide(self.sensor[0], allowed, out=np.zeros(6), where=allowed > 0)
        centre = self.observed.centres[0]
        return exponential(share * logarithm(seen @ invert(T), centre), centre) @ T


def _solve_step(H: Floats, g: Floats) -> tuple[Floats, Floats]:
    """Solve H x = g, slightly damped, for twists x (K, 6) of limited size. Also return the lengths (K,) of x, mm."""
    diagonal = np.einsum("kii->ki", H).reshape(-1, 2, 3)  # rotation, then translation
    damping = DAMPING * diagonal.mean(axis=2, keepdims=True) + np.full((1, 1, 3), 1e-9)
    damped = H.copy()
    np.einsum("kii->ki", damped)[:] += damping.reshape(-1, 6)
    x = np.linalg.solve(damped, g[..., None])[..., 0]
    x *= diagonal[:, 1].sum(axis=1, keepdims=True) > 0.0
    angle, far = np.sqrt((x.reshape(-1, 2, 3) ** 2).sum(axis=2)).T
    shorter = np.minimum(1.0, np.minimum(FARTHEST_RAD / (angle + 1e-12), FARTHEST_MM / (far + 1e-12)))
    return x * shorter[:, None], (far + LEVER_MM * angle) * shorter
