"""F_i X S_i = Y: the solution is exact without errors; with errors, its covariance fits the residuals."""

import numpy as np
import pytest
from scipy.stats import chi2

from tactile_loc.core.geometry.hand_eye import (
    MEDIAN_6,
    TRUSTED,
    estimate_typical_variance,
    fit_hand_eye,
    measure_turns,
    predict,
    screws_agree,
    solve_closed_form,
)
from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, make_translation, rotation_about

STD = np.array([2e-4] * 3 + [3e-3] * 3)
COVARIANCE = np.diag(STD**2)


def poses(count: int, std_m: float, rng: np.random.Generator) -> np.ndarray:
    return make_transform(draw_rotations(count, rng), std_m * rng.normal(size=(count, 3)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def problem(rng):
    """Return X, Y, flange poses and sensed poses of ten touches."""
    (X,), (Y,), S = poses(1, 0.05, rng), poses(1, 0.3, rng), poses(10, 0.03, rng)
    return X, Y, Y @ invert(S) @ invert(X), S


def fitted(problem, noise, **more):
    X, Y, F, S = problem
    covariances = np.repeat(COVARIANCE[None], len(S), axis=0)
    return fit_hand_eye(F, move(S, noise), covariances, X @ make_translation([1e-3, 0, 0]), Y, **more)


def test_pose_errors_invert_a_move(rng):
    T, e = poses(4, 0.1, rng), 0.1 * rng.normal(size=(4, 6))
    np.testing.assert_allclose(compute_pose_errors(move(T, e), T), e, atol=1e-12)


@pytest.mark.parametrize("count", [3, 10])
def test_the_closed_form_is_exact(problem, count):
    X, Y, F, S = problem
    found = solve_closed_form(F[:count], S[:count])
    np.testing.assert_allclose(found, (X, Y), atol=1e-7)
    np.testing.assert_allclose(predict(F, X, Y), S, atol=1e-12)


def test_several_problems_are_solved_together_also_with_half_turns(problem):
    X, Y, F, _ = problem
    axes = ([1, 0, 0], [1, 1, 0], [1, 2, 3])
    half = make_transform(np.stack([np.eye(3), *(rotation_about(a, np.pi) for a in axes)]), np.zeros(3))
    flanges = np.stack([F[:4], F[0] @ half])
    seen = predict(flanges, X, Y)
    np.testing.assert_allclose(solve_closed_form(flanges, seen)[0], [X, X], atol=1e-7)


def test_the_fit_converges_to_the_truth(problem):
    found = fitted(problem, np.zeros((10, 6)))
    np.testing.assert_allclose(found.T_flange_sensor, problem[0], atol=1e-9)
    np.testing.assert_allclose(found.T_base_object, problem[1], atol=1e-9)


def test_the_covariance_matches_the_errors_for_a_wrong_noise_level(problem, rng):
    nees, variances = [], []
    for _ in range(60):
        found = fitted(problem, 2 * STD * rng.normal(size=(10, 6)))
        e = compute_pose_errors(problem[0], found.T_flange_sensor)
        nees.append(e @ np.linalg.solve(found.covariance, e))
        variances.append(found.variance)
    left = 48 / 60  # the fit of twelve numbers absorbs the rest of the residuals
    assert np.mean(nees) == pytest.approx(6 / left, rel=0.25)
    assert np.mean(variances) == pytest.approx(4.0 * left, rel=0.1)


def test_a_robust_fit_ignores_a_wrong_touch(problem, rng):
    noise = STD * rng.normal(size=(10, 6))
    noise[4] = [5e-3, 0, 0, 0.1, 0, 0]
    plain, robust = (fitted(problem, noise, robust=r) for r in (False, True))
    off = [np.linalg.norm(compute_pose_errors(problem[0], f.T_flange_sensor)[:3]) for f in (plain, robust)]
    assert off[1] < 3e-4 < off[0]
    assert robust.chi2.argmax() == 4


def test_a_robust_fit_gives_full_weight_to_consistent_touches(problem):
    plain, robust = (fitted(problem, np.zeros((10, 6)), robust=r) for r in (False, True))
    np.testing.assert_allclose(robust.information, plain.information, rtol=1e-6, atol=1e-3)


def test_a_direction_without_information_does_not_affect_the_rest(problem):
    X, Y, F, S = problem
    loose = np.repeat(np.diag([9e-4, *STD[1:] ** 2])[None], 10, axis=0)  # a touch has no information along x
    found = fit_hand_eye(F, S, loose, X @ make_translation([1e-3, 0, 0]), Y)
    np.testing.assert_allclose(found.T_flange_sensor, X, atol=1e-6)


def test_the_typical_variance_follows_the_chi_squared_distribution():
    assert chi2(6).median() == pytest.approx(MEDIAN_6, rel=1e-4)
    assert chi2(6).ppf(0.999) == pytest.approx(TRUSTED, rel=2e-3)
    drawn = chi2(6).ppf((np.arange(999) + 0.5) / 999)
    assert estimate_typical_variance(4.6 * drawn) == pytest.approx(4.6, rel=1e-3)
    assert estimate_typical_variance(0.1 * drawn) == 1.0


def test_rotations_about_one_axis_leave_the_shift_along_it_unknown(problem):
    """X and Y may be shifted along the axis together: eleven numbers are found instead of twelve."""
    X, Y, F, _ = problem
    axis = np.array([2.0, -3.0, 6.0]) / 7
    F = make_transform(F[0, :3, :3] @ rotation_about(axis, np.linspace(-1.5, 1.5, 10)), F[:, :3, 3])
    found = fit_hand_eye(F, predict(F, X, Y), np.repeat(COVARIANCE[None], 10, axis=0), X, Y)
    std_m = np.sqrt(np.linalg.eigvalsh(found.information)[0]) ** -1
    assert std_m > 1.0, "the shift is practically unknown"
    values, vectors = np.linalg.eigh(found.information[:3, :3])
    assert abs(vectors[:, 0] @ X[:3, :3].T @ axis) == pytest.approx(1.0, abs=1e-6)
    assert values[0] < 1e-6 * values[1]


def test_rotations_about_one_axis_are_detected():
    axis = np.array([1.0, 2.0, 2.0]) / 3
    F = make_transform(rotation_about(axis, np.array([0.0, 0.4, 1.1, 2.0])), [0.1, 0, 0])
    (most, second, _), axes = measure_turns(F)
    assert most > 0.5
    assert second < 1e-7
    assert abs(axes[0] @ axis) == pytest.approx(1.0)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def screw(axis: list[float], angle_rad: float, slide_m: float) -> np.ndarray:
    unit = np.array(axis) / np.linalg.norm(axis)
    return make_transform(rotation_about(axis, angle_rad), slide_m * unit)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_screws_of_different_angles_or_shifts_do_not_agree(shape):
    still, one = np.eye(4), screw([1.0, 2, 3], np.pi / 2, 0.010)
    for angle_rad, slide_m, expected in (
        (np.pi / 2, 0.010, True),
        (np.pi / 2 + 0.009, 0.0109, True),
        (np.pi / 2 - 0.009, 0.0091, True),
        (np.pi / 2, 0.0111, False),
        (np.pi / 2, 0.0089, False),
        (np.pi / 2 + 0.011, 0.010, False),
        (np.pi / 2 - 0.011, 0.010, False),
    ):
        other = screw([-3.0, 0, 1], angle_rad, slide_m)
        four = [np.broadcast_to(T, (*shape, 4, 4)) for T in (one, still, still, other)]
        agree = screws_agree(*four, angle_rad=0.01, slide_m=0.001)
        assert agree.shape == shape
        assert (agree == expected).all()
