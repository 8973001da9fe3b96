import numpy as np
import pytest
from message_helpers import naming
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.lie import move_covariance, rotate_covariance
from tactile_loc.core.geometry.pose_words import format_pose_words, name_direction, name_line
from tactile_loc.core.geometry.rigid import (
    align_to_z,
    axis_angle,
    axis_times_sine,
    cross_matrix,
    draw_rotations,
    format_pose,
    invert,
    is_rigid,
    make_transform,
    make_translation,
    require_covariance,
    require_rigid,
    require_unit,
    rotation_about,
    rotation_angle,
    rotation_to_quaternion,
    rotation_to_vector,
    transform_points,
    vector_to_rotation,
)
from tactile_loc.core.runtime.errors import ConfigError, TouchError


@pytest.fixture
def transforms() -> np.ndarray:
    rng = np.random.default_rng(0)
    return make_transform(draw_rotations(6, rng).reshape(2, 3, 3, 3), rng.normal(size=(2, 3, 3)))


def test_a_transform_rotates_and_then_translates():
    R, t = rotation_about([0, 0, 1], np.pi / 2), [1.0, 2.0, 3.0]
    np.testing.assert_allclose(make_transform(R, t) @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-15)
    np.testing.assert_allclose(make_translation(t) @ [1, 0, 0, 1], [2, 2, 3, 1])


def test_invert_gives_the_matrix_inverse(transforms):
    np.testing.assert_allclose(invert(transforms) @ transforms, np.broadcast_to(np.eye(4), (2, 3, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(invert(transforms), np.linalg.inv(transforms), atol=1e-12)
    np.testing.assert_allclose(invert(transforms[0]), np.linalg.inv(transforms[0]), atol=1e-12)
    np.testing.assert_allclose(invert(transforms[0, 0]), np.linalg.inv(transforms[0, 0]), atol=1e-12)


def test_transform_points_equals_the_homogeneous_product(transforms):
    points = np.random.default_rng(1).normal(size=(7, 3))
    homogeneous = np.column_stack([points, np.ones(7)])
    expected = np.einsum("abij,pj->abpi", transforms, homogeneous)[..., :3]
    np.testing.assert_allclose(transform_points(transforms, points), expected, atol=1e-12)
    assert transform_points(transforms[0, 0], points).shape == (7, 3)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-7, np.pi])
def test_rotation_angle_is_accurate_near_zero_and_pi(angle_rad):
    assert rotation_angle(rotation_about([1.0, 2.0, -1.0], angle_rad)) == pytest.approx(angle_rad, rel=1e-6, abs=1e-15)


def test_the_axis_has_the_length_of_the_sine():
    axis = np.array([2.0, -3.0, 6.0]) / 7
    angles = np.array([[-1.0, 0.0, 0.3], [2.0, 0.5, np.pi]])
    np.testing.assert_allclose(
        axis_times_sine(rotation_about(axis, angles)), np.sin(angles)[..., None] * axis, atol=1e-15
    )


def test_cross_matrices_multiply_like_the_cross_product():
    v, w = np.random.default_rng(7).normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose((cross_matrix(v) @ w[..., None])[..., 0], np.cross(v, w), atol=1e-15)
    np.testing.assert_allclose(cross_matrix(v[0, 0]) @ w[0, 0], np.cross(v[0, 0], w[0, 0]), atol=1e-15)


def one_error(shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the covariance of an error of fixed size and either sign."""
    error = np.concatenate([shift, turn], axis=-1)
    return error[..., :, None] * error[..., None, :]


def test_a_moved_covariance_describes_the_error_at_the_new_point():
    shift, turn, lever = np.random.default_rng(8).normal(size=(3, 2, 4, 3))
    there = one_error(shift + np.cross(turn, lever), turn)
    np.testing.assert_allclose(move_covariance(one_error(shift, turn), lever), there, atol=1e-14)
    np.testing.assert_allclose(
        move_covariance(one_error(shift[0, 0], turn[0, 0]), lever[0, 0]), there[0, 0], atol=1e-14
    )


def test_a_rotated_covariance_describes_the_rotated_error():
    shift, turn = np.random.default_rng(9).normal(size=(2, 3))
    R = rotation_about([1, -2, 0.5], 0.8)
    np.testing.assert_allclose(rotate_covariance(one_error(shift, turn), R), one_error(R @ shift, R @ turn), atol=1e-14)


def test_align_to_z_rotates_by_the_smallest_angle():
    directions = np.array([[0, 0, 1], [0, 0, -2], [1, 0, 0], [1e-9, 0, -1], [1e-4, 0, -1], [-0.3, 0.8, -0.1]])
    d, R = directions / np.linalg.norm(directions, axis=1, keepdims=True), align_to_z(directions)
    assert is_rigid(make_transform(R, np.zeros(3)))
    np.testing.assert_allclose((R @ d[..., None])[..., 0], np.tile([0, 0, 1], (len(d), 1)), atol=1e-9)
    np.testing.assert_allclose(rotation_angle(R), np.arccos(d[:, 2]), atol=1e-7)
    np.testing.assert_array_equal(align_to_z(directions[5]), R[5])


def test_random_rotations_are_uniform():
    R = draw_rotations(20_000, np.random.default_rng(3))
    assert is_rigid(make_transform(R, np.zeros(3)))
    np.testing.assert_allclose(R.mean(axis=0), 0, atol=0.02)  # each axis takes every direction
    angle = rotation_angle(R)
    # Haar measure: the angle's distribution function is (theta - sin theta) / pi.
    for theta in (0.5, 1.5, 2.5):
        assert (angle < theta).mean() == pytest.approx((theta - np.sin(theta)) / np.pi, abs=0.01)


def test_axis_and_angle_match_any_rotation_and_the_identity():
    axis = np.array([2.0, -3.0, 6.0]) / 7
    for turn in (1e-6, 0.5, 3.0):
        angle_deg, found = axis_angle(rotation_about(axis, turn))
        assert angle_deg == pytest.approx(np.degrees(turn))
        np.testing.assert_allclose(found, axis, atol=1e-9)
    assert axis_angle(np.eye(3))[1].tolist() == [0, 0, 1]


@pytest.mark.parametrize("T", [np.eye(3), np.full((4, 4), np.nan), np.eye(4)[None], "pose", [[1, 0], [0]], None])
def test_what_is_not_a_finite_matrix_of_four_rows_is_refused(T):
    with pytest.raises(TouchError, match=naming("the pose", "(4, 4)")):
        require_rigid(T, "the pose", TouchError)


def test_a_rounded_rotation_becomes_orthogonal_and_stays_near():
    exact = make_transform(draw_rotations(200, np.random.default_rng(3)), [0.4, -0.1, 0.2])
    for T in exact:
        found = require_rigid(np.round(T, 3), "the pose")
        assert is_rigid(found, 1e-12)
        np.testing.assert_allclose(found, T, atol=1.5e-3)
        np.testing.assert_array_equal(require_rigid(T, "the pose"), T, "an exact pose stays as it is")


TURNED = make_transform(rotation_about([1, 2, 3], 1.0), [0.4, -0.1, 0.2])


@pytest.mark.parametrize(
    ("T", "words"),
    [
        (np.round(TURNED, 2), "three decimals"),
        (TURNED @ np.diag([1.0, 1, -1, 1]), "reflection"),
        (TURNED @ np.diag([1000.0, 1000, 1000, 1]), "scaled by 1000"),
        (TURNED @ np.diag([1.1, 1.1, 1.1, 1]), "scaled by 1.1,"),
        (TURNED @ np.diag([1.0, 1.2, 1, 1]), "orthogonal"),
        (np.zeros((4, 4)) + np.diag([0, 0, 0, 1.0]), "orthogonal"),
        (TURNED.T, "transpose"),
        (make_transform(TURNED[:3, :3], [8e-4, 0, -5e-4]).T, "transpose"),
        (TURNED * 1000, "last row"),
    ],
)
def test_each_fault_of_a_pose_is_named(T, words):
    assert not is_rigid(np.stack([np.eye(4), T]))
    with pytest.raises(ConfigError, match=naming("the pose", words)):
        require_rigid(T, "the pose")


def test_a_rounded_quaternion_gets_the_length_one():
    q = rotation_to_quaternion(TURNED[:3, :3])
    found = require_unit(np.round(q, 3), "the quaternion")
    assert np.linalg.norm(found) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(found, q, atol=1e-3)
    for wrong in (2 * q, 0.99 * q, 0 * q, np.nan * q):
        with pytest.raises(TouchError, match=naming("the quaternion", "length")):
            require_unit(wrong, "the quaternion", TouchError)


NEGATIVE = np.diag([1.0, 1, 1, 1, 1, -1e-3])
LOPSIDED = np.eye(6) + np.eye(6, k=1)


@pytest.mark.parametrize("values", [np.eye(3), np.ones(6), 1.0, NEGATIVE, LOPSIDED, np.full((6, 6), np.nan), "wide"])
def test_an_invalid_covariance_is_refused(values):
    with pytest.raises(ConfigError, match=naming("the pose", "(6, 6)")):
        require_covariance(values, "the pose's")


def test_a_covariance_may_be_tiny_or_zero():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6)) * 1e-8
    np.testing.assert_array_equal(require_covariance(A @ A.T, "it"), A @ A.T)
    np.testing.assert_array_equal(require_covariance(np.zeros((6, 6)), "it"), np.zeros((6, 6)))
    assert require_covariance(np.diag([1, 1, 1, 0, 0, 0]), "it").dtype == np.float64
    half = (A @ A.T).astype(np.float32)
    half[0, 1] *= np.float32(1) + np.finfo(np.float32).eps
    assert require_covariance(half, "it")[0, 1] == half[0, 1], "rounding to single precision keeps enough symmetry"


def test_small_negative_numbers_are_written_as_zero():
    T = make_transform(rotation_about([1e-9, -1e-9, 1], 0.5), [-1e-9, 0.001, -2e-6])
    assert format_pose(T) == ["0.00", "1.00", "0.00", "28.6", "(0.000, 0.000, 1.000)"]
    assert format_pose_words(T).place == "0.0, 1.0, 0.0"


@pytest.mark.parametrize(
    ("vector", "direction", "line"),
    [([0, 0, -3], "-z", "z"), ([0.2, 2, 0], "y", "y"), ([-1, 1e-9, -2], "(-0.45, 0.00, -0.89)", "(0.45, 0.00, 0.89)")],
)
def test_a_direction_has_a_sign_and_a_line_has_none(vector, direction, line):
    assert (name_direction(np.array(vector, float)), name_line(np.array(vector, float))) == (direction, line)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-6, 0.3, 2.0, np.pi - 1e-9, np.pi])
def test_vectors_and_quaternions_agree_with_scipy_at_any_angle(angle_rad):
    axes = np.random.default_rng(0).normal(size=(2, 50, 3))
    vectors = angle_rad * axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    expected = Rotation.from_rotvec(vectors.reshape(-1, 3))
    R = vector_to_rotation(vectors)
    np.testing.assert_allclose(R.reshape(-1, 3, 3), expected.as_matrix(), atol=1e-14)
    q = rotation_to_quaternion(R).reshape(-1, 4)
    same = np.abs(np.einsum("nk,nk->n", q, expected.as_quat(scalar_first=True)))
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
    assert (q[:, 0] >= 0).all()
    back = rotation_to_vector(R)
    np.testing.assert_allclose(vector_to_rotation(back), R, atol=1e-14)
    if angle_rad < 3.0:
        np.testing.assert_allclose(back, vectors, atol=1e-14)
