"""SE(3) in batches: rotations (..., 3, 3), transforms (..., 4, 4), all float64, angles in radians, lengths in metres.

A transform is named ``T_target_source``: ``p_target = T_target_source @ p_source``.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.runtime.errors import ConfigError, TactileLocError

# the types of arrays have one name in the whole project
Floats = NDArray[np.float64]
Poses = NDArray[np.float64]
Float32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
ROUNDED = 1e-3  # largest difference from a rotation that rounding to three decimals explains
FARTHEST_M = 20.0  # from a robot's base or a camera; a number in a file that is larger has another unit
LEAST_RAD = 1e-15  # a smaller angle counts as this one, so that a division by it is possible
UNIT_TOLERANCE = 0.005  # largest difference of a unit vector's length from 1, as in tf2


def make_transform(R: ArrayLike, t_m: ArrayLike) -> Floats:
    """Stack rotations (..., 3, 3) and translations (..., 3) in metres to transforms (..., 4, 4)."""
    R, t = np.asarray(R, float), np.asarray(t_m, float)
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = np.zeros((*batch, 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def make_translation(t_m: ArrayLike) -> Floats:
    """Return pure translations (..., 4, 4) by `t_m` (..., 3) in metres."""
    return make_transform(np.eye(3), t_m)


def invert(T: Floats) -> Floats:
    """Invert rigid transforms (..., 4, 4): the result maps the target frame back to the source (metres)."""
    R_inverse = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_transform(R_inverse, -(R_inverse @ T[..., :3, 3:])[..., 0])


def transform_points(T: Floats, points_m: ArrayLike) -> Floats:
    """Map points (P, 3), metres, from source to target frames by transforms (..., 4, 4): (..., P, 3)."""
    return np.asarray(points_m, float) @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def rotation_about(axis: ArrayLike, angle_rad: ArrayLike) -> Floats:
    """Return rotations (..., 3, 3) by `angle_rad` (...) radians about one unitless axis (3,) (Rodrigues' formula)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle_rad, float)[..., None, None]
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def axis_times_sine(R: Floats) -> Floats:
    """Return the unit axes (..., 3) of rotations (..., 3, 3) times the sines of their angles, unitless."""
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    return np.asarray(0.5 * skew)


def rotation_angle(R: Floats) -> Floats:
    """Return the angles of rotations (..., 3, 3) in radians, 0 to pi, accurate at both ends."""
    sine = np.linalg.norm(axis_times_sine(R), axis=-1)
    return np.arctan2(2.0 * sine, np.trace(R, axis1=-2, axis2=-1) - 1.0)


def cross_matrix(v: Floats) -> Floats:
    """Return the matrices (..., 3, 3) that map w to v x w, for vectors v (..., 3) in any unit."""
    K = np.zeros((*v.shape, 3))
    K[..., 2, 1] = v[..., 0]
    K[..., 0, 2] = v[..., 1]
    K[..., 1, 0] = v[..., 2]
    return np.asarray(K - K.swapaxes(-1, -2))


def align_to_z(directions: ArrayLike) -> Floats:
    """Return the smallest rotations (..., 3, 3) that map unitless directions (..., 3) to +z.

    R = I + [v]x + [v]x^2 / (1 + z) for v = d x z, with the unit direction d and its last component z.
    """
    d = np.asarray(directions, float)
    x, y, z = np.moveaxis(d / np.linalg.norm(d, axis=-1, keepdims=True), -1, 0)
    across = x * x + y * y
    down = (across < 1e-24) & (z < 0)  # the smallest rotation is a half turn about any horizontal axis
    near = z < -0.9  # 1 + z would lose digits
    k = np.where(near, 1 - z, 1.0) / np.where(down, 1.0, np.where(near, across, 1 + z))
    rows = [[1 - x * x * k, -x * y * k, -x], [-x * y * k, 1 - y * y * k, -y], [x, y, z]]
    R = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    R[down] = np.diag([1.0, -1.0, -1.0])
    return R


def quaternion_to_rotation(q: ArrayLike) -> Floats:
    """Convert unit quaternions (..., 4), scalar first, unitless, to rotations (..., 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def vector_to_rotation(vectors: ArrayLike) -> Floats:
    """Convert rotation vectors (..., 3), rad, to rotations (..., 3, 3) (Rodrigues' formula with half angles)."""
    turn = np.asarray(vectors, float)
    half = 0.5 * np.maximum(np.linalg.norm(turn, axis=-1), LEAST_RAD)[..., None, None]
    K = cross_matrix(turn)
    sinc = np.sin(half) / half
    return np.asarray(np.eye(3) + sinc * np.cos(half) * K + 0.5 * sinc * sinc * (K @ K))


def rotation_to_vector(R: Floats) -> Floats:
    """Convert rotations (..., 3, 3) to rotation vectors (..., 3), rad."""
    q = rotation_to_quaternion(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)  # of half of the angle
    half = np.arctan2(sine, q[..., :1])
    return np.asarray(q[..., 1:] * np.where(half > LEAST_RAD, 2 * half / np.maximum(sine, LEAST_RAD), 2.0))


def axis_angle(R: Floats) -> tuple[float, Floats]:
    """Return the angle, degrees, 0 to 180, and the unit axis (3,) of a rotation (3, 3). No rotation has the axis z."""
    vector = rotation_to_vector(R)
    angle = float(np.linalg.norm(vector))
    return float(np.degrees(angle)), vector / angle + 0.0 if angle > 1e-9 else np.array([0.0, 0.0, 1.0])


def format_pose(T: Floats) -> list[str]:
    """Return texts for a pose (4, 4), metres: x, y, z in mm, the rotation angle in degrees, and its axis."""
    angle_deg, axis = axis_angle(T[:3, :3])
    return [*(f"{1e3 * v:z.2f}" for v in T[:3, 3]), f"{angle_deg:z.1f}", "({:z.3f}, {:z.3f}, {:z.3f})".format(*axis)]


def rotation_to_quaternion(R: Floats) -> Floats:
    """Convert rotations (..., 3, 3) to unit quaternions (..., 4), scalar first and non-negative, unitless."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(np.asarray(R, float), (-2, -1), (0, 1))
    rows = [  # 4 q q^T; the row of the largest component is the most exact one
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ]
    products = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)[..., None, None]
    q = np.take_along_axis(products, largest, axis=-2)[..., 0, :]
    first = np.take_along_axis(q, (q != 0).argmax(axis=-1)[..., None], axis=-1)
    return np.asarray(q * np.sign(first) / np.linalg.norm(q, axis=-1, keepdims=True))


def rotation_to_quaternion_xyzw(R: Floats) -> Floats:
    """Convert rotations (..., 3, 3) to unit quaternions (..., 4), scalar last as in ROS and non-negative, unitless."""
    return np.roll(rotation_to_quaternion(R), -1, axis=-1)


def draw_rotations(count: int, rng: np.random.Generator) -> Floats:
    """Draw rotations (count, 3, 3) uniformly over SO(3): normalised Gaussian quaternions."""
    q = rng.normal(size=(count, 4))
    return quaternion_to_rotation(q / np.linalg.norm(q, axis=1, keepdims=True))


def is_rigid(T: Floats, tolerance: float = 1e-6) -> bool:
    """Return whether all T (..., 4, 4) have a proper rotation, a finite translation and the last row 0 0 0 1."""
    R = T[..., :3, :3]
    if not np.isfinite(T).all():
        return False
    orthogonal = _are_near(R @ np.swapaxes(R, -1, -2), np.eye(3), tolerance)
    return orthogonal and _are_near(T[..., 3, :], LAST_ROW, tolerance) and bool((np.linalg.det(R) > 0).all())


def _are_near(values: Floats, wanted: Floats, tolerance: float) -> bool:
    """Return what `np.allclose` returns for finite values, several times as fast."""
    return bool((np.abs(values - wanted) <= tolerance + 1e-5 * np.abs(wanted)).all())


def require_rigid(T: ArrayLike, what: str, error: type[TactileLocError] = ConfigError) -> Floats:
    """Return a rigid transform (4, 4), metres, as float64. A rotation that was rounded becomes orthogonal.

    Raises `error`, with `what` as its name, if the transform is not rigid.
    """
    found = _convert_numbers(T)
    if found is None or found.shape != (4, 4) or not np.isfinite(found).all():
        raise error(
            f"{what} is not a rigid transform; give (4, 4) finite numbers: a rotation, a translation in metres, and "
            "the last row 0 0 0 1"
        )
    if is_rigid(found):
        return found
    U, stretches, V = np.linalg.svd(found[:3, :3])
    nearest = U @ V  # the orthogonal matrix with the least sum of squared differences
    fault = _find_fault(found, nearest, stretches)
    if fault:
        raise error(f"{what} is not a rigid transform: {fault}")
    return make_transform(nearest, found[:3, 3])


def require_near(T: Floats, what: str, error: type[TactileLocError] = ConfigError) -> Floats:
    """Return a transform (4, 4), metres. Raises `error`, with `what` as its name, if its unit is probably another."""
    length_m = float(np.linalg.norm(T[:3, 3]))
    if length_m > FARTHEST_M:
        raise error(f"{what} is {length_m:,.0f} m long, so its unit is probably wrong (a matrix is in metres)")
    return T


def _find_fault(T: Floats, nearest: Floats, stretches: Floats) -> str:
    """Return in words why a transform (4, 4) is not rigid, or an empty text if its rotation was only rounded.

    `nearest` (3, 3) is the nearest orthogonal matrix, and `stretches` (3,) are the singular values of its rotation.
    """
    if not _are_near(T[3], LAST_ROW, 1e-6):  # rounding does not change it
        if _are_near(T[:, 3], LAST_ROW, 1e-6):
            return "its translation is in its last row, so transpose it"
        return f"its last row is {' '.join(f'{v:g}' for v in T[3])}, but must be 0 0 0 1"
    scale = float(stretches.mean())
    if scale > 0 and np.ptp(stretches) <= 2 * ROUNDED * scale:
        if np.linalg.det(nearest) < 0:
            return "it is a reflection, because its determinant is negative; correct the sign of one axis"
        if abs(scale - 1) > ROUNDED:
            return f"its rotation is scaled by {scale:.4g}, but a rotation has no unit; divide it by this number"
    apart = float(np.abs(T[:3, :3] - nearest).max())
    if apart > ROUNDED or np.linalg.det(nearest) < 0:
        return (
            f"its rotation is up to {apart:.2g} from the nearest orthogonal matrix; if its numbers are rounded, give "
            "at least three decimals"
        )
    return ""


def require_unit(v: ArrayLike, what: str, error: type[TactileLocError] = ConfigError) -> Floats:
    """Return a vector or a quaternion (N,) with the length 1 exactly.

    Raises `error`, with `what` as its name, if its length differs from 1 by more than rounded numbers explain.
    """
    found = np.asarray(v, float)
    length = float(np.linalg.norm(found))
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise error(
            f"{what} has the length {length:.4g}; it must have the length 1, so if its numbers are rounded, give at "
            "least three decimals"
        )
    return found / length


def require_covariance(values: ArrayLike, what: str, error: type[TactileLocError] = ConfigError) -> Floats:
    """Return the covariance (6, 6) of a pose's error as float64.

    Raises `error`, with `what` as its name, if the values are not a covariance.
    """
    found = _convert_numbers(values)
    if found is None or found.shape != (6, 6) or not _is_covariance(found):
        raise error(
            f"{what} is not a covariance; give (6, 6), symmetric and without negative variance, first x, y, z in m, "
            "then a rotation vector in rad"
        )
    return found


def _is_covariance(values: Floats) -> bool:
    if not np.isfinite(values).all():
        return False
    allowed = 1e-6 * max(1e-12, float(np.abs(values).max()))
    return bool(np.abs(values - values.T).max() <= allowed and np.linalg.eigvalsh(values).min() >= -allowed)


def _convert_numbers(values: ArrayLike) -> Floats | None:
    """Convert values to float64; return None if they are not numbers."""
    try:
        found = np.asarray(values)
    except ValueError:  # rows of different lengths
        return None
    return found.astype(np.float64) if found.dtype.kind in "fiu" else None
