"""Estimates of single touches are combined by their information, as in closed form for Gaussians."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc import ContactShape, GaussianPrior, SensorGeometry, Touch
from tactile_loc.core.geometry.lie import exponential, move_covariance
from tactile_loc.core.registration.estimates import Estimates, PoseFusion
from tactile_loc.core.registration.joint_registration import scale
from tactile_loc.plugin import RefinedPose, Scene, View
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform, make_translation
from tactile_loc.testing.problems import ReferenceRenderer

CAMERA = SensorGeometry("orthographic", 40, 30, 2500.0, 2500.0, 20.0, 15.0, 0.010, 0.002)


def random_pose(rng) -> np.ndarray:
    return make_transform(draw_rotations(1, rng)[0], rng.normal(scale=0.01, size=3))


def make_views(box, rng, count: int, **errors) -> list[View]:
    """Views with random sensor poses within some centimetres; what their touches show does not matter."""
    depth_m = np.full(CAMERA.shape, 1e-3, np.float32)
    depth_m[10:20, 10:20] = 5e-4
    shape = ContactShape(depth_m, 1e-3)
    scene = Scene(box, CAMERA, ReferenceRenderer())
    frames = [np.eye(4), *(random_pose(rng) for _ in range(count - 1))]
    return [View(Touch(shape, CAMERA), scene, T, **errors) for T in frames]


def draw_information(rng, count: int) -> np.ndarray:
    """Random information (1, N, 6, 6), from 1 to some 1000 per mm^2 or rad^2."""
    half = rng.normal(size=(1, count, 6, 6)) * 10 ** rng.uniform(0, 2, (1, count, 6, 1))
    return half.swapaxes(-1, -2) @ half


def solve(views, T_each, information, start, prior=None):
    problem = PoseFusion.of(views, Estimates(scale(T_each[None]), information))
    return problem, scale(problem.solve(start[None], prior), 1e-3)[0]


@pytest.mark.parametrize("seed", range(4))
def test_two_exact_estimates_combine_to_the_exact_pose(box, seed):
    rng = np.random.default_rng(seed)
    views, truth = make_views(box, rng, 2), random_pose(rng)
    seen = np.stack([view.T_sensor_first @ truth for view in views])
    start = exponential(np.array([0.1, -0.05, 0.08, 0.002, 0.001, -0.003]), truth[:3, 3]) @ truth
    _, T = solve(views, seen, draw_information(rng, 2), start)
    np.testing.assert_allclose(T, truth, atol=1e-9)


def test_each_touch_decides_the_directions_that_only_it_determines(box):
    """The first touch knows all but x and yaw, and the second all but z and a tilt. Their free directions are wrong."""
    rng, truth = np.random.default_rng(1), make_translation([0.001, 0.002, 0.012])
    views = make_views(box, rng, 1) * 2
    known = np.ones((2, 6))
    known[0, [2, 3]], known[1, [0, 5]] = 0.0, 0.0
    wrong = (1 - known) * [0.05, 0.05, 0.05, 1.5, 1.5, 1.5]
    centre = CAMERA.gel_middle_m * 1e3
    each = np.stack([scale(invert(exponential(w, centre)) @ scale(truth), 1e-3) for w in wrong])
    _, T = solve(views, each, (1e3 * known)[None, :, :, None] * np.eye(6), truth)
    np.testing.assert_allclose(T, truth, atol=1e-8)


def test_a_mean_of_translations_has_the_weights_of_the_inverse_variances(box):
    rng = np.random.default_rng(2)
    views = make_views(box, rng, 1) * 3
    shifts_mm, stds_mm = np.array([0.3, -0.1, 0.2]), np.array([0.1, 0.2, 0.4])
    each = np.stack([make_translation([1e-3 * s, 0, 0]) for s in shifts_mm])
    information = (stds_mm**-2.0)[None, :, None, None] * np.eye(6)
    problem, T = solve(views, each, information, np.eye(4))
    mean_mm = (shifts_mm / stds_mm**2).sum() / (1 / stds_mm**2).sum()
    np.testing.assert_allclose(T[:3, 3], [1e-3 * mean_mm, 0, 0], atol=1e-9)
    (pose,) = problem.describe(scale(T[None]))
    std_m = 1e-3 * (stds_mm**-2.0).sum() ** -0.5
    middle_m = CAMERA.gel_middle_m - T[:3, 3]
    about_gel = move_covariance(pose.covariance, middle_m)
    np.testing.assert_allclose(np.sqrt(np.diag(about_gel)[:3]), std_m, rtol=1e-3)


def test_an_error_of_the_sensors_pose_lowers_the_weight_of_its_touch(box):
    """Both touches are sure to 0.01 mm, and the second sensor's pose to 1 mm, so the first touch decides."""
    views = make_views(box, np.random.default_rng(0), 1) * 2
    views[1] = replace(views[1], sensor_std_m=1e-3)
    each = np.stack([np.eye(4), make_translation([1e-3, 0, 0])])
    information = np.broadcast_to(1e4 * np.eye(6), (1, 2, 6, 6))
    problem, T = solve(views, each, information, np.eye(4))
    assert abs(T[0, 3]) < 1e-6
    seen, nats = problem.see(scale(T[None]))
    np.testing.assert_allclose(seen[0, :, 0, 3], [0.0, 1.0], atol=1e-3)  # the sensor's pose is wrong, not the touch
    np.testing.assert_allclose(nats[0], [0.0, 0.5], atol=1e-3)  # by one standard deviation


def test_an_error_of_the_first_sensor_is_in_the_reported_covariance(box):
    views = [replace(view, sensor_std_m=1e-3) for view in make_views(box, np.random.default_rng(0), 1)]
    problem, T = solve(views, np.eye(4)[None], np.full((1, 1, 1, 1), 1e4) * np.eye(6), np.eye(4))
    (pose,) = problem.describe(scale(T[None]))
    own, reported = (
        np.sqrt(np.diag(move_covariance(C, CAMERA.gel_middle_m))[:3])
        for C in (pose.covariance, pose.reported_covariance)
    )
    np.testing.assert_allclose(own, 1e-5, rtol=1e-2)
    np.testing.assert_allclose(reported, 1e-3, rtol=1e-2)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_touches_does_not_matter(box, seed):
    rng = np.random.default_rng(seed)
    views, truth = make_views(box, rng, 3, sensor_std_m=3e-4, sensor_std_rad=0.003), random_pose(rng)
    noise = rng.normal(size=(3, 6)) * [0.01, 0.01, 0.01, 0.3, 0.3, 0.3]
    centre = CAMERA.gel_middle_m * 1e3
    each = np.stack(
        [
            scale(exponential(n, centre) @ scale(v.T_sensor_first @ truth), 1e-3)
            for v, n in zip(views, noise, strict=True)
        ]
    )
    information, order = draw_information(rng, 3), [2, 0, 1]
    _, T = solve(views, each, information, truth)
    back = invert(views[2].T_sensor_first)
    others = [replace(views[k], T_sensor_first=views[k].T_sensor_first @ back) for k in order]
    _, other = solve(others, each[order], information[:, order], invert(back) @ truth)
    np.testing.assert_allclose(back @ other, T, atol=1e-9)


def test_a_prior_decides_only_what_the_touches_leave_open(box):
    """The touch knows all but x, at 0. The prior's peak is 2 mm away along x and y, give or take 1 mm."""
    views = make_views(box, np.random.default_rng(0), 1)
    information = np.diag([1e7] * 3 + [0.0, 1e4, 1e4])[None, None]
    prior = GaussianPrior(make_translation([2e-3, 2e-3, 0]), 1e-3, 0.1)
    _, T = solve(views, np.eye(4)[None], information, np.eye(4), prior)
    np.testing.assert_allclose(T[:3, 3], [2e-3, 0, 0], atol=1e-5)


def test_the_covariance_of_a_refiner_counts_instead_of_the_touchs_hessian(box):
    """Two results 0.1 mm apart: the covariances say that the second one is surer."""
    views = make_views(box, np.random.default_rng(0), 1) * 2
    alone = [
        [RefinedPose(make_translation([x, 0, 0]), 1.0, True, 1, np.diag([std**2] * 3 + [1e-6] * 3))]
        for x, std in ((0.0, 1e-4), (1e-4, 1e-6))
    ]
    problem = PoseFusion.of(views, Estimates.of(views, alone))
    np.testing.assert_allclose(problem.solve(np.eye(4)[None])[0, 0, 3], 0.1, atol=1e-4)
