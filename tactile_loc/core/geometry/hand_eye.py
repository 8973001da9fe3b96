"""Hand-eye calibration of a sensor on a robot's flange, from touches of one part at rest: F_i X S_i = Y.

F_i = T_base_flange is known, and each touch measures S_i = T_sensor_object. X = T_flange_sensor and Y = T_base_object
are unknown. A closed form gives the first estimate (Shah, "Solving the robot-world/hand-eye calibration problem using
the Kronecker product", 2013). Weighted Gauss-Newton steps on twists refine this estimate. A twist or an error is x, y,
z (m), then a rotation vector (rad).
"""

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.lie import compute_pose_errors, move, rotate_covariance
from tactile_loc.core.geometry.rigid import (
    Bools,
    Floats,
    Poses,
    axis_times_sine,
    cross_matrix,
    invert,
    make_transform,
    rotation_angle,
    rotation_to_vector,
)

MEDIAN_6 = 5.348  # median of a chi-squared variable with six degrees of freedom
TRUSTED = 22.5  # 99.9 % quantile of the same variable; a touch with a larger value contradicts the others
STEPS, STILL = 50, 1e-10  # largest number of Gauss-Newton steps; a shorter step, in UNIT, is the last one
UNIT = np.array([1e-3] * 3 + [1e-2] * 3)  # 1 mm, and the rotation (rad) that moves a point at 100 mm by 1 mm
LEAST_INFORMATION = 1e-8  # least information about a twist in UNIT; it corresponds to 10 m
ALIKE = 1e-9


@dataclass(frozen=True, eq=False)
class HandEyeFit:
    """The X and Y (4, 4), metres, that explain N touches best. `chi2` (N,), unitless, are the touches' squared errors.

    `information` (6, 6) is the information about a twist of X, along the sensor's axes at the origin of its frame. It
    comes from the touches' covariances.
    """

    T_flange_sensor: Floats
    T_base_object: Floats
    chi2: Floats
    information: Floats

    @property
    def variance(self) -> float:
        """The typical ratio of the squared residuals to the size that the touches' covariances predict."""
        return estimate_typical_variance(self.chi2)

    @property
    def covariance(self) -> Floats:
        """The covariance (6, 6) of X, scaled by the residuals, along the flange's axes at the sensor frame's origin."""
        values, vectors = np.linalg.eigh(self.information * UNIT * UNIT[:, None])
        scaled = (vectors / np.maximum(values, LEAST_INFORMATION)) @ vectors.T
        along_sensor = self.variance * scaled * UNIT * UNIT[:, None]
        return rotate_covariance(along_sensor, self.T_flange_sensor[:3, :3])


def predict(T_base_flange: Poses, T_flange_sensor: Poses, T_base_object: Poses) -> Poses:
    """Return T_sensor_object (..., N, 4, 4), metres, from flange poses (N, 4, 4), X and Y (..., 4, 4)."""
    return invert(T_base_flange @ T_flange_sensor[..., None, :, :]) @ T_base_object[..., None, :, :]


def solve_closed_form(T_base_flange: Poses, T_sensor_object: Poses) -> tuple[Poses, Poses]:
    """Return X and Y (..., 4, 4), metres, from at least three touches (..., N, 4, 4). Without errors, they are exact.

    The rotations maximise sum_i trace(R_Y^T R_Fi R_X R_Si) over matrices of one norm. The solution is a pair of
    singular vectors, which are projected to rotations. The translations solve a linear least-squares problem. In
    directions that the touches do not determine, X and Y are arbitrary.
    """
    R_F, R_S = T_base_flange[..., :3, :3], T_sensor_object[..., :3, :3]
    kronecker = np.einsum("...nij,...nlk->...ikjl", R_F, R_S).reshape(*R_F.shape[:-3], 9, 9)  # of F X S, row by row
    _, _, right = np.linalg.svd(kronecker)
    M = right[..., 0, :].reshape(*right.shape[:-2], 3, 3)  # the sign of M is arbitrary
    R_X = _average_rotations((M * np.sign(np.linalg.det(M))[..., None, None])[..., None, :, :])
    R_Y = _average_rotations(R_F @ R_X[..., None, :, :] @ R_S)
    t_X, t_Y = _solve_translations(T_base_flange, R_X, T_sensor_object[..., :3, 3])
    return make_transform(R_X, t_X), make_transform(R_Y, t_Y)


def _average_rotations(R: Floats) -> Floats:
    """Return the rotations (..., 3, 3) nearest to the mean of (..., N, 3, 3)."""
    u, _, v = np.linalg.svd(R.mean(axis=-3))
    u[..., :, 2] *= np.sign(np.linalg.det(u @ v))[..., None]
    return np.asarray(u @ v)


def _solve_translations(T_base_flange: Poses, R_X: Floats, t_S: Floats) -> tuple[Floats, Floats]:
    """Solve R_F t_X - t_Y = -(t_F + R_F R_X t_S) for the translations (..., 3) of X and Y, by least squares."""
    R_F, t_F = T_base_flange[..., :3, :3], T_base_flange[..., :3, 3]
    A = np.concatenate([R_F, np.broadcast_to(-np.eye(3), R_F.shape)], axis=-1)
    b = -(t_F + (R_F @ (R_X[..., None, :, :] @ t_S[..., None]))[..., 0])
    across = np.swapaxes(A, -1, -2)
    normal = (across @ A).sum(axis=-3) + ALIKE * np.eye(6)
    t = np.linalg.solve(normal, (across @ b[..., None]).sum(axis=-3))[..., 0]
    return t[..., :3], t[..., 3:]


def fit_hand_eye(
    T_base_flange: Poses,
    T_sensor_object: Poses,
    covariances: Floats,
    T_flange_sensor: Floats,
    T_base_object: Floats,
    robust: bool = False,
) -> HandEyeFit:
    """Fit X and Y to N touches, starting from first estimates (4, 4), metres.

    The poses of the touches (N, 4, 4) are in metres, with `covariances` (N, 6, 6) as in RefinedPose. If `robust` is
    True, touches that contradict the others get lower weights, w = 1 / (1 + chi2 / c)^2 (Geman and McClure). Then
    `information` includes these weights.
    """
    weights_of = _weigh if robust else np.ones_like
    X, Y = T_flange_sensor, T_base_object
    weighing = np.asarray(np.linalg.inv(covariances), np.float64)
    for _ in range(STEPS):
        H, g, chi2 = _build_equations(T_base_flange, T_sensor_object, weighing, X, Y)
        weights = weights_of(chi2)[:, None, None]
        step = np.linalg.solve(_damp((weights * H).sum(axis=0)), (weights[:, 0] * g).sum(axis=0))
        X, Y = X @ move(np.eye(4), step[:6] * UNIT), Y @ move(np.eye(4), step[6:] * UNIT)
        if np.abs(step).max() < STILL:
            break
    H, _, chi2 = _build_equations(T_base_flange, T_sensor_object, weighing, X, Y)
    total = (weights_of(chi2)[:, None, None] * H).sum(axis=0)
    # the Schur complement is the information of X for any Y
    mount = np.asarray(total[:6, :6] - total[:6, 6:] @ np.linalg.solve(_damp(total[6:, 6:]), total[6:, :6]))
    return HandEyeFit(X, Y, chi2, mount / UNIT / UNIT[:, None])


def _build_equations(F: Poses, S: Poses, weighing: Floats, X: Floats, Y: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the equations H (N, 12, 12), g (N, 12) for twists of X and Y, in UNIT, along their axes; and chi2 (N,)."""
    P = predict(F, X, Y)
    e, J = compute_pose_errors(P, S), np.zeros((len(F), 6, 12))
    J[:, :3, :3] = J[:, 3:, 3:6] = -np.eye(3)
    J[:, :3, 3:6] = cross_matrix(P[:, :3, 3])
    J[:, :3, 6:9] = J[:, 3:, 9:] = P[:, :3, :3]
    J = J * np.tile(UNIT, 2)
    left = np.swapaxes(J, 1, 2) @ weighing
    return left @ J, -(left @ e[..., None])[..., 0], np.einsum("ni,nij,nj->n", e, weighing, e)


def estimate_typical_variance(chi2: Floats) -> float:
    """Return the typical squared ratio of residuals to their expected size, but at least 1."""
    return max(1.0, float(np.median(chi2)) / MEDIAN_6)


def _weigh(chi2: Floats) -> Floats:
    return np.asarray((1.0 + chi2 / (TRUSTED * estimate_typical_variance(chi2))) ** -2.0)


def _damp(H: Floats) -> Floats:
    """Add a little to the information's diagonal, so that undetermined directions stay unchanged."""
    return H + np.diag(1e-9 * np.diag(H) + LEAST_INFORMATION)


def measure_turns(T_base_flange: Poses) -> tuple[Floats, Floats]:
    """Return how far flange poses (N, 4, 4) are rotated about three axes: angles (3,), rad, and the axes (3, 3).

    An angle is the root mean square over all pairs of poses; the greatest angle is first. The axes, one per row, are
    unit vectors in the flange frame. If the second angle is near zero, all rotations are about the first axis.
    """
    R = T_base_flange[:, :3, :3]
    first, second = np.triu_indices(len(R), 1)
    turns = rotation_to_vector(np.swapaxes(R[first], 1, 2) @ R[second])
    values, vectors = np.linalg.eigh(turns.T @ turns / max(1, len(turns)))
    return np.sqrt(np.maximum(values[::-1], 0.0)), vectors.T[::-1]


def screws_agree(
    T_first: Poses, T_second: Poses, T_first_other: Poses, T_second_other: Poses, angle_rad: float, slide_m: float
) -> Bools:
    """Return whether (...) two motions have the same angle and slide along their axes, as A and B of A X = X B do.

    A = inv(T_second) @ T_first (..., 4, 4) are motions of flanges. B = T_second_other @ inv(T_first_other) (..., 4, 4)
    are motions of objects in sensor frames. Angles may differ by `angle_rad`, slides by `slide_m` metres. A motion
    almost without rotation has no axis, so only the angles of such motions are compared.
    """
    A, B = invert(T_second) @ T_first, T_second_other @ invert(T_first_other)
    alike = np.abs(rotation_angle(A[..., :3, :3]) - rotation_angle(B[..., :3, :3])) < angle_rad
    slides, sines = zip(*map(_measure_slide, (A, B)), strict=True)
    return np.asarray(alike & (np.abs(slides[0] - slides[1]) < slide_m * np.maximum(sines[0], 0.2)))


def _measure_slide(T: Poses) -> tuple[Floats, Floats]:
    """Return the slides (...), metres, of motions (..., 4, 4) along their axes, times the sines of their angles.

    Also return these sines (...).
    """
    axis = axis_times_sine(T[..., :3, :3])
    return (axis * T[..., :3, 3]).sum(axis=-1), np.linalg.norm(axis, axis=-1)
