"""Registration of poses to all touches at once: robust Gauss-Newton steps for many poses side by side.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). It is about a touch's own centre in
its sensor's frame, or about the object's centre in the first sensor's frame.
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

SETTLED_MM = 1e-3  # a pose that moves less has converged
COARSELY = 3  # the first steps use one of this many points
FARTHEST_RAD, FARTHEST_MM = 0.2, 3.0  # largest step
DAMPING = 1e-4
LEVER_MM = 10.0  # distance at which a rotation counts as motion
Floats = NDArray[np.float64]


class Registered(NamedTuple):
    """Registered poses: `T` (K, 4, 4) in the first sensor's frame, and `T_each` (K, N, 4, 4) as each touch shows it.

    `information` (K, 6, 6) is that of a twist of T about the object's centre before the last step. `moved` (K,) is the
    length of that step, mm.
    """

    T: Floats
    T_each: Floats
    information: Floats
    moved: Floats


@dataclass(frozen=True, eq=False)
class Registration:
    """The observations of N touches, and the object: its triangles, `samples` of its surface and its centre `middle`.

    `T_sensor_first` (N, 4, 4) are the sensor poses up to a twist about each touch's centre. Its variances are
    `sensor` (N, 6), of the sensor's pose, and `press` (N, 6), of its press. `noise` is the least standard deviation of
    a point, which the observed weights assume.
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
        """Move poses T (K, 4, 4), in the first sensor's frame, to where they explain all touches.

        `scales` (I,) are the scales of the robust weights, step by step. The last `finely` steps use all points, the
        others one of COARSELY.
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
        information = self._marginalise_first(parts, T)
        return Registered(self._view_from_first(T, T_each[:, 0]), T_each, information, moved)

    def _step(self, T: Floats, T_each: Floats, scale: float, every: NDArray[np.int64]) -> tuple[Floats, ...]:
        """Take one Gauss-Newton step of poses (K, 4, 4) and of each sensor's error.

        Return both, moved; the parts (K, 2, 6, 6) of the information, the first touch's and the others'; and the
        lengths (K,) of the step, mm.

        Touch i gives equations A u = b for a twist u of its own pose. Its error e has the covariance S. Then
        (1 + A S)^-1 (A, b + A e) are the equations for the object's twist x, u = Ad x - e + (what S allows). The points
        of all touches are taken to be as noisy as their common misfit.
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
        # each sensor's own error, given the object's pose: S (1 + A S)^-1 (b + A e - A Ad x)
        own = left[..., 6] - (left[..., :6] @ (Ad @ x[:, None, :, None]))[..., 0]
        T_each = exponential(S * own, centres) @ (self.T_sensor_first @ T[:, None])
        return T, T_each, parts, moved

    def _step_of_one(self, T: Floats, A: Floats, b: Floats) -> tuple[Floats, ...]:
        """Take the same step with one touch, with equations A (K, 6, 6) and b (K, 6): the pose takes up all errors."""
        seen, R = self.T_sensor_first @ T, self.T_sensor_first[:, :3, :3]
        lever = self.observed.centres - seen[:, :3, :3] @ self.middle - seen[:, :3, 3]
        Ad = adjoint(R, lever)
        across = Ad.swapaxes(-1, -2)
        H = across @ A @ Ad
        x, moved = _solve_step(H, (across @ b[..., None])[..., 0])
        T = exponential(x, T[:, :3, :3] @ self.middle + T[:, :3, 3]) @ T
        return T, (self.T_sensor_first @ T)[:, None], np.stack([H, np.zeros_like(H)], axis=1), moved

    def _equations(self, T_each: Floats, scale: float, every: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Build the equations A (K, N, 6, 6), b (K, N, 6) of twists that improve how T_each explain each touch."""
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

    def _marginalise_first(self, parts: Floats, T: Floats) -> Floats:
        """Return the information (K, 6, 6) of twists of the first sensor's pose of the object, about its centre.

        Of `parts` (K, 2, 6, 6), the first touch's is direct, except for its press. The others' is reduced by the error
        of the first sensor's pose.
        """
        to_centre = adjoint(np.eye(3), T[:, :3, :3] @ self.middle + T[:, :3, 3] - self.observed.centres[0])[:, None]
        allowed = np.stack([self.press[0], self.sensor[0]])[:, None, :] * to_centre @ to_centre.swapaxes(-1, -2)
        total = np.linalg.solve(np.eye(6) + parts @ allowed, parts).sum(axis=1)
        return np.asarray((total + total.swapaxes(1, 2)) / 2)

    def _view_from_first(self, T: Floats, seen: Floats) -> Floats:
        """Return the object's poses (K, 4, 4) in the first sensor's frame, corrected by its error but not by its press.

        `T` (K, 4, 4) are the poses for the reported sensor pose, `seen` those that the sensor's touch shows.
        """
        allowed = self.sensor[0] + self.press[0]
        share = np.divide(self.sensor[0], allowed, out=np.zeros(6), where=allowed > 0)
        centre = self.observed.centres[0]
        return exponential(share * logarithm(seen @ invert(T), centre), centre) @ T


def _solve_step(H: Floats, g: Floats) -> tuple[Floats, Floats]:
    """Return twists x (K, 6) that solve H x = g, slightly damped and limited; and how far they move poses (K,), mm."""
    diagonal = np.einsum("kii->ki", H).reshape(-1, 2, 3)  # rotation, then translation
    damping = DAMPING * diagonal.mean(axis=2, keepdims=True) + np.full((1, 1, 3), 1e-9)
    damped = H.copy()
    np.einsum("kii->ki", damped)[:] += damping.reshape(-1, 6)
    x = np.linalg.solve(damped, g[..., None])[..., 0]
    x *= diagonal[:, 1].sum(axis=1, keepdims=True) > 0.0
    angle, far = np.sqrt((x.reshape(-1, 2, 3) ** 2).sum(axis=2)).T
    shorter = np.minimum(1.0, np.minimum(FARTHEST_RAD / (angle + 1e-12), FARTHEST_MM / (far + 1e-12)))
    return x * shorter[:, None], (far + LEVER_MM * angle) * shorter
