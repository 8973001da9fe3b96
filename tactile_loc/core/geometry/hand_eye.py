"""Where a sensor sits on a robot's flange, of touches of one part at rest: F_i X S_i = Y.

F_i = T_base_flange is known and S_i = T_sensor_object measured, a touch each; X = T_flange_sensor and Y = T_base_object
are sought. A closed form starts (Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker
product", 2013), weighted Gauss-Newton steps on twists end. A twist, and an error, is x, y, z (m) before a rotation
vector (rad).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import (
    Poses,
    axis_times_sine,
    cross_matrix,
    invert,
    make_transform,
    rotate_covariance,
    rotation_angle,
)

Floats = NDArray[np.float64]

MEDIAN_6 = 5.348  # of a chi-squared variable with six degrees of freedom
TRUSTED = 22.5  # its 99.9 % quantile: a touch that is farther off contradicts the others
STEPS, STILL = 50, 1e-10  # most Gauss-Newton steps; the last is so short, in UNIT
UNIT = np.array([1e-3] * 3 + [1e-2] * 3)  # 1 mm, and the turn that moves what is 100 mm away by it
KNOWN = np.array([3e-3] * 3 + [0.3] * 3)  # m and rad: what a touch knows no better it says nothing of
LEAST_INFORMATION = 1e-8  # of a twist in UNIT: what is not determined is known to 10 m
ALIKE = 1e-9


@dataclass(frozen=True, eq=False)
class HandEyeFit:
    """X and Y (4, 4), metres, that explain N touches, and how far each is off: `chi2` (N,), unitless.

    `information` (6, 6) is that of a twist of X along the sensor's axes at the sensor frame's origin, of the touches'
    covariances as they are told. The residuals have `freedom` degrees of freedom and are `variance` times as large,
    squared, as these covariances say: 1 if they are right.
    """

    T_flange_sensor: Floats
    T_base_object: Floats
    chi2: Floats
    information: Floats
    freedom: int
    variance: float

    @property
    def covariance(self) -> Floats:
        """The covariance (6, 6) of X as the residuals tell: along the flange's axes, at the sensor frame's origin."""
        values, vectors = np.linalg.eigh(self.information * UNIT * UNIT[:, None])
        scaled = (vectors / np.maximum(values, LEAST_INFORMATION)) @ vectors.T
        along_sensor = self.variance * scaled * UNIT * UNIT[:, None]
        return rotate_covariance(along_sensor, self.T_flange_sensor[:3, :3])


def predict(T_base_flange: Poses, T_flange_sensor: Poses, T_base_object: Poses) -> Poses:
    """Return T_sensor_object (..., N, 4, 4), metres, of flanges' poses (N, 4, 4), and X and Y (..., 4, 4)."""
    return invert(T_base_flange @ T_flange_sensor[..., None, :, :]) @ T_base_object[..., None, :, :]


def compute_pose_errors(T: Poses, T_measured: Poses) -> Floats:
    """Return by how much poses T are off measured ones, (..., 6), as `RefinedPose.covariance` is ordered and framed."""
    turned = compute_rotation_vectors(T[..., :3, :3] @ np.swapaxes(T_measured[..., :3, :3], -1, -2))
    return np.concatenate([T[..., :3, 3] - T_measured[..., :3, 3], turned], axis=-1)


def move(T: Poses, errors: Floats) -> Poses:
    """Return the poses (..., 4, 4), metres, off T by `errors` (..., 6): the inverse of `compute_pose_errors`."""
    from scipy.spatial.transform import Rotation

    turned: Any = Rotation.from_rotvec(errors[..., 3:].reshape(-1, 3)).as_matrix()
    R = turned.reshape(*errors.shape[:-1], 3, 3) @ T[..., :3, :3]
    return make_transform(R, T[..., :3, 3] + errors[..., :3])


def compute_rotation_vectors(R: Floats) -> Floats:
    """Return the rotation vectors (..., 3), rad, of rotations (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    vectors: Any = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors, float).reshape(*R.shape[:-2], 3)


def solve_closed_form(T_base_flange: Poses, T_sensor_object: Poses) -> tuple[Poses, Poses]:
    """Return X and Y (..., 4, 4), metres, of at least three touches (..., N, 4, 4): exact without errors.

    The rotations maximise sum_i trace(R_Y^T R_Fi R_X R_Si) over matrices of one length, whose solution is a pair of
    singular vectors, and are projected to rotations; translations solve linear least squares. What the touches do not
    determine comes out arbitrary.
    """
    R_F, R_S = T_base_flange[..., :3, :3], T_sensor_object[..., :3, :3]
    kronecker = np.einsum("...nij,...nlk->...ikjl", R_F, R_S).reshape(*R_F.shape[:-3], 9, 9)  # of F X S, row by row
    _, _, right = np.linalg.svd(kronecker)
    R_X = _find_nearest_rotation(right[..., 0, :].reshape(*right.shape[:-2], 3, 3))
    R_Y = _average_rotations(R_F @ R_X[..., None, :, :] @ R_S)
    t_X, t_Y = _solve_translations(T_base_flange, R_X, T_sensor_object[..., :3, 3])
    return make_transform(R_X, t_X), make_transform(R_Y, t_Y)


def _find_nearest_rotation(M: Floats) -> Floats:
    """The rotations (..., 3, 3) nearest to matrices whose sign is arbitrary."""
    return _average_rotations((M * np.sign(np.linalg.det(M))[..., None, None])[..., None, :, :])


def _average_rotations(R: Floats) -> Floats:
    """The rotations (..., 3, 3) nearest to the mean of (..., N, 3, 3)."""
    u, _, v = np.linalg.svd(R.mean(axis=-3))
    u[..., :, 2] *= np.sign(np.linalg.det(u @ v))[..., None]
    return np.asarray(u @ v)


def _solve_translations(T_base_flange: Poses, R_X: Floats, t_S: Floats) -> tuple[Floats, Floats]:
    """The translations (..., 3) of X and Y: R_F t_X - t_Y = -(t_F + R_F R_X t_S), in least squares."""
    R_F, t_F = T_base_flange[..., :3, :3], T_base_flange[..., :3, 3]
    A = np.concatenate([R_F, np.broadcast_to(-np.eye(3), R_F.shape)], axis=-1)
    b = -(t_F + (R_F @ (R_X[..., None, :, :] @ t_S[..., None]))[..., 0])
    across = np.swapaxes(A, -1, -2)
    normal = (across @ A).sum(axis=-3) + ALIKE * np.eye(6)
    t = np.linalg.solve(normal, (across @ b[..., None]).sum(axis=-3))[..., 0]
    return t[..., :3], t[..., 3:]


def fit_hand_eye(
    T_base_flange: Poses, T_sensor_object: Poses, covariances: Floats, T_flange_sensor: Floats, T_base_object: Floats,
    robust: bool = False,
) -> HandEyeFit:  # fmt: skip
    """Fit X and Y to N touches (N, 4, 4), metres, with `covariances` (N, 6, 6) as RefinedPose's, from a first guess.

    If it is to be `robust`, touches that contradict the others lose their weight, w = 1 / (1 + chi2 / c)^2 (Geman and
    McClure), and `information` is not what these residuals tell.
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
    freedom, variance = _estimate_variance(chi2, covariances, total)
    return HandEyeFit(X, Y, chi2, _reduce_to_mount(total) / UNIT / UNIT[:, None], freedom, variance)


def _build_equations(F: Poses, S: Poses, weighing: Floats, X: Floats, Y: Floats) -> tuple[Floats, Floats, Floats]:
    """The equations H (N, 12, 12), g (N, 12) of twists of X and Y in UNIT, each along its own axes; chi2 (N,)."""
    P = predict(F, X, Y)
    e, J = compute_pose_errors(P, S), np.zeros((len(F), 6, 12))
    J[:, :3, :3] = J[:, 3:, 3:6] = -np.eye(3)
    J[:, :3, 3:6] = cross_matrix(P[:, :3, 3])
    J[:, :3, 6:9] = J[:, 3:, 9:] = P[:, :3, :3]
    J = J * np.tile(UNIT, 2)
    left = np.swapaxes(J, 1, 2) @ weighing
    return left @ J, -(left @ e[..., None])[..., 0], np.einsum("ni,nij,nj->n", e, weighing, e)


def estimate_typical_variance(chi2: Floats) -> float:
    """Return how many times as large as told, squared, most residuals are; 1 at least."""
    return max(1.0, float(np.median(chi2)) / MEDIAN_6)


def _weigh(chi2: Floats) -> Floats:
    return np.asarray((1.0 + chi2 / (TRUSTED * estimate_typical_variance(chi2))) ** -2.0)


def _damp(H: Floats) -> Floats:
    """The information with a little more on its diagonal: what is not determined stays where it is."""
    return H + np.diag(1e-9 * np.diag(H) + LEAST_INFORMATION)


def _reduce_to_mount(H: Floats) -> Floats:
    """The information (6, 6) of X, whatever Y is: the Schur complement."""
    return np.asarray(H[:6, :6] - H[:6, 6:] @ np.linalg.solve(_damp(H[6:, 6:]), H[6:, :6]))


def _estimate_variance(chi2: Floats, covariances: Floats, information: Floats) -> tuple[int, float]:
    """Degrees of freedom and variance factor of the residuals, of what touches say anything of."""
    told = np.linalg.eigvalsh(covariances / KNOWN / KNOWN[:, None]) < 1.0
    found = np.linalg.eigvalsh(information) > np.min(UNIT / KNOWN) ** 2
    freedom = max(1, int(told.sum() - found.sum()))
    return freedom, float(chi2.sum() / freedom)


def measure_turns(T_base_flange: Poses) -> tuple[Floats, Floats]:
    """Return how far flanges (N, 4, 4) are turned against one another, rad, about three axes, the most first.

    They are root mean squares (3,) over all pairs, and the axes (3, 3), a row each, are unit vectors in the flange's
    frame: where the second is next to nothing, all turns are about the first axis.
    """
    R = T_base_flange[:, :3, :3]
    first, second = np.triu_indices(len(R), 1)
    turns = compute_rotation_vectors(np.swapaxes(R[first], 1, 2) @ R[second])
    values, vectors = np.linalg.eigh(turns.T @ turns / max(1, len(turns)))
    return np.sqrt(np.maximum(values[::-1], 0.0)), vectors.T[::-1]


def screws_agree(
    T_first: Poses, T_second: Poses, T_first_other: Poses, T_second_other: Poses, angle_rad: float, slide_m: float
) -> NDArray[np.bool_]:
    """Say (...) whether two motions turn by one angle and slide as far along their axes, as A and B of A X = X B do.

    A = inv(T_second) @ T_first, of flanges, and B = T_second_other @ inv(T_first_other), of objects that sensors see,
    (..., 4, 4); angles may differ by `angle_rad`, slides by `slide_m` metres. Motions of next to no turn have no axis:
    of them the angle alone is compared.
    """
    A, B = invert(T_second) @ T_first, T_second_other @ invert(T_first_other)
    turned = np.abs(rotation_angle(A[..., :3, :3]) - rotation_angle(B[..., :3, :3])) < angle_rad
    slides, sines = zip(*map(_measure_slide, (A, B)), strict=True)
    return np.asarray(turned & (np.abs(slides[0] - slides[1]) < slide_m * np.maximum(sines[0], 0.2)))


def _measure_slide(T: Poses) -> tuple[Floats, Floats]:
    """How far motions (..., 4, 4) slide along their axes, metres, times the sine of their angle; and the sine."""
    axis = axis_times_sine(T[..., :3, :3])
    return (axis * T[..., :3, 3]).sum(axis=-1), np.linalg.norm(axis, axis=-1)
