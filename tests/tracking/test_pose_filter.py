"""A pose through motions and touches: the transport is exact, and common errors limit the certainty."""

import numpy as np
import pytest

from tactile_loc.core.geometry.hand_eye import UNIT
from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, make_translation
from tactile_loc.tracking.pose_filter import PoseFilter, SeenPose, estimate_motion_errors

GEL = np.array([0.002, -0.001, 0.01])
STD = np.array([1e-4] * 3 + [3e-3] * 3)
SENSOR = np.diag(np.array([2e-4] * 3 + [1e-3] * 3) ** 2)


def poses(count: int, rng: np.random.Generator) -> np.ndarray:
    return make_transform(draw_rotations(count, rng), 0.03 * rng.normal(size=(count, 3)))


def covariance(std: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A covariance with correlated components."""
    L = np.diag(std) @ (np.eye(6) + 0.3 * rng.normal(size=(6, 6)))
    return L @ L.T


def about(point_m: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return a motion that rotates about a point and then shifts."""
    T = move(np.eye(4), np.concatenate([np.zeros(3), error[3:]]))
    T[:3, 3] = point_m - T[:3, :3] @ point_m + error[:3]
    return T


def scaled(C: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return a covariance in units of the standard deviations of another."""
    return C / np.sqrt(np.outer(np.diag(by), np.diag(by)))


def test_a_covariance_is_transformed_to_another_frame_with_its_pose():
    rng = np.random.default_rng(0)
    T_base_object, T_base_sensor = poses(2, rng)
    C = covariance(STD, rng)
    T, seen = PoseFilter.known(T_base_object, C).view_from(T_base_sensor, GEL)
    assert np.allclose(T, invert(T_base_sensor) @ T_base_object)
    drawn = move(T_base_object, rng.multivariate_normal(np.zeros(6), C, size=20_000))
    errors = compute_pose_errors(invert(T_base_sensor) @ drawn, T)
    assert np.allclose(scaled(np.cov(errors.T), seen), scaled(seen, seen), atol=0.03)


def test_a_motions_error_moves_the_object_by_its_lever():
    rng = np.random.default_rng(1)
    T_base_object, T_base_sensor = poses(2, rng)
    C = covariance(1e-2 * np.ones(6), rng) * 1e-2
    found = estimate_motion_errors(C, T_base_sensor, T_base_object)
    T_sensor_object = invert(T_base_sensor) @ T_base_object
    drawn = move(T_base_sensor, rng.multivariate_normal(np.zeros(6), C, size=20_000)) @ T_sensor_object
    errors = compute_pose_errors(drawn, T_base_object)
    assert np.allclose(scaled(np.cov(errors.T), found), scaled(found, found), atol=0.04)


def test_a_wrong_sensor_pose_is_removed_from_the_view():
    """A sensor with a wrong reported pose: the seen pose and covariance are right to first order."""
    rng = np.random.default_rng(8)
    T_base_object, true_T_base_sensor = poses(2, rng)
    for off in np.concatenate([np.diag(STD), rng.normal(size=(2, 6)) * STD]) * 1e-2:
        said = true_T_base_sensor @ about(GEL, off)
        errors = np.concatenate([rng.normal(size=6), off / UNIT])  # touches' errors do not depend on the object's pose
        known = np.concatenate([np.zeros(6), errors])
        T, seen = PoseFilter(T_base_object, errors, np.outer(known, known)).view_from(said, GEL)
        truth = invert(true_T_base_sensor) @ T_base_object
        assert np.allclose(compute_pose_errors(T, truth) / STD, 0, atol=1e-5)
        moved_by = compute_pose_errors(truth, invert(said) @ T_base_object) / STD
        assert np.allclose(seen / np.outer(STD, STD), np.outer(moved_by, moved_by), atol=1e-6)


def start(seen: SeenPose) -> PoseFilter:
    """Return the filter of an unknown pose after one touch."""
    T = seen.T_base_sensor @ seen.T_sensor_object
    return PoseFilter.known(T, np.diag(np.square([1.0] * 3 + [3.0] * 3))).update(seen, 1.0)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_filter_equals_the_least_squares_of_all_touches(share):
    """Touches of a rotated sensor differ only by shifts, and their common errors fade: the equations are linear."""
    rng, count = np.random.default_rng(9), 4
    T_base_object = poses(1, rng)[0]
    sensors = poses(count, rng)
    prior, common, own, sensor = (covariance(STD, rng)[:3, :3] for _ in range(4))
    off = STD[0] * rng.normal(size=(count, 3))  # along the sensors' axes
    filtered = PoseFilter.known(T_base_object, shifts(prior))
    for number, (T, shift) in enumerate(zip(sensors, off, strict=True)):
        seen = make_translation(shift) @ invert(T) @ T_base_object
        touch = SeenPose(T, seen, shifts(common), shifts(own, 1e-9), shifts(sensor), GEL)
        filtered = filtered.update(touch, share if number else 1.0)
    alike = (1 - share) ** np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    noise = np.kron(alike, common + sensor) + np.kron(np.eye(count), own)
    J = np.concatenate([T[:3, :3].T for T in sensors])
    known = np.linalg.inv(np.linalg.inv(prior) + J.T @ np.linalg.solve(noise, J))
    expected = known @ J.T @ np.linalg.solve(noise, off.ravel())
    assert np.allclose(filtered.T_base_object[:3, 3] - T_base_object[:3, 3], expected, rtol=1e-6, atol=1e-12)
    found = filtered.covariance[:3, :3] * UNIT[0] ** 2
    assert np.allclose(found / STD[0] ** 2, known / STD[0] ** 2, atol=1e-7)


def shifts(covariance_m2: np.ndarray, turn: float = 0.0) -> np.ndarray:
    """Return the covariance (6, 6) of a pose with errors of position and almost none of rotation."""
    C = turn * np.eye(6)
    C[:3, :3] = covariance_m2
    return C


def test_a_possible_motion_of_the_object_adds_its_covariance():
    rng = np.random.default_rng(10)
    T_base_object, T_base_sensor = poses(2, rng)
    C, creep = covariance(STD, rng), covariance(STD, rng)
    later, uncertain = PoseFilter.known(T_base_object, C).predict(creep), PoseFilter.known(T_base_object, C + creep)
    for found, expected in zip(*(one.view_from(T_base_sensor, GEL) for one in (later, uncertain)), strict=True):
        assert np.allclose(found, expected, rtol=1e-9, atol=1e-15)


def seen_pose(T_base_sensor, T_sensor_object, C, common=0.75) -> SeenPose:
    return SeenPose(T_base_sensor, T_sensor_object, common * C, (1 - common) * C, SENSOR, GEL)


def test_the_first_touch_keeps_its_pose_and_covariance():
    rng = np.random.default_rng(2)
    T_base_sensor, T_sensor_object = poses(2, rng)
    C = covariance(STD, rng)
    T, found = start(seen_pose(T_base_sensor, T_sensor_object, C)).view_from(T_base_sensor, GEL)
    assert np.allclose(T, T_sensor_object)
    assert np.allclose(scaled(found, C), scaled(C, C), atol=1e-3)


def test_a_direction_that_touches_do_not_determine_stays_as_predicted():
    rng = np.random.default_rng(5)
    T_base_sensor, T_sensor_object = poses(2, rng)
    direction = np.array([0.0, 0, 0, 0, 0, 1])
    C = np.diag(STD**2) + 9.0 * np.outer(direction, direction)  # the rotation about z is undetermined
    known = PoseFilter.known(T_base_sensor @ T_sensor_object, np.diag(STD**2))
    turned = move(T_sensor_object, 0.02 * direction)
    for _ in range(100):
        known = known.update(seen_pose(T_base_sensor, turned, C), 0.05)
    T, found = known.view_from(T_base_sensor, GEL)
    assert abs(compute_pose_errors(T, T_sensor_object)[5]) < 1e-3
    assert found[5, 5] == pytest.approx(STD[5] ** 2, rel=0.3)


def test_a_touch_far_from_the_prediction_has_less_weight():
    """With Student's t, a touch twenty deviations away counts less than a touch two deviations away."""
    rng = np.random.default_rng(6)
    T_base_sensor, T_sensor_object = poses(2, rng)
    known = PoseFilter.known(T_base_sensor @ T_sensor_object, np.diag(STD**2))
    gain = []
    for far in (0.5, 2.0, 20.0):
        told = move(T_sensor_object, far * STD)
        T, _ = known.update(seen_pose(T_base_sensor, told, np.diag(STD**2)), 1.0).view_from(T_base_sensor, GEL)
        gain.append(np.linalg.norm(compute_pose_errors(T, T_sensor_object) / (far * STD)))
    assert gain[0] == pytest.approx(gain[1], rel=0.05), "both near touches must have full weight"
    assert gain[2] < 0.1 * gain[1]


@pytest.mark.slow
def test_the_covariance_is_right_for_correlated_errors():
    """The errors of touches and of sensor poses are first-order autoregressive; NEES is chi-squared."""
    nees, share = [], 0.1
    for number in range(150):
        rng = np.random.default_rng([6, number])
        T_base_object = poses(1, rng)[0]
        C = np.diag(STD**2)
        common, sensor = (rng.normal(size=6) for _ in range(2))
        filtered = None
        for _ in range(25):
            true_T_base_sensor = move(poses(1, np.random.default_rng(7))[0], 1e-3 * rng.normal(size=6))
            T = invert(true_T_base_sensor) @ T_base_object
            error = np.sqrt(0.75) * STD * common + np.sqrt(0.25) * STD * rng.normal(size=6)
            reported = true_T_base_sensor @ about(GEL, np.sqrt(np.diag(SENSOR)) * sensor)
            seen = seen_pose(reported, move(T, error), C)
            filtered = start(seen) if filtered is None else filtered.update(seen, share)
            fresh = np.sqrt(1 - (1 - share) ** 2)
            common, sensor = ((1 - share) * old + fresh * rng.normal(size=6) for old in (common, sensor))
        found, P = filtered.view_from(reported, GEL)
        e = compute_pose_errors(T, found)
        nees.append(e @ np.linalg.solve(P, e))
    assert np.mean(nees) == pytest.approx(6.0, abs=1.2)
    assert 0.9 < np.mean(np.array(nees) < 12.59) < 0.99
