"""Known metrics of known posteriors."""

import numpy as np
import pytest
import trimesh

from tactile_loc import PoseGrid, PoseMetric, PosePosterior
from tactile_loc.evaluation.metrics import LEVELS, POSTERIOR_METRICS, compute_nees, measure_posterior
from tactile_loc.plugin.helpers import make_transform, rotation_about

P = np.array([0.1, 0.4, 0.2, 0.3])
STEP_M = 2e-3


@pytest.fixture
def posterior(make_object) -> PosePosterior:
    """Four poses in a row, 2 mm apart."""
    part = make_object(trimesh.creation.box((0.02, 0.01, 0.01)))
    poses = make_transform(np.eye(3), np.column_stack([np.arange(4) * STEP_M, np.zeros((4, 2))]))
    return PosePosterior(PoseGrid(poses, PoseMetric(part)), np.log(P))


def asked(posterior: PosePosterior, T: np.ndarray, seed: int = 0) -> dict[str, float]:
    return dict(zip(POSTERIOR_METRICS, measure_posterior(posterior, T, np.random.default_rng(seed)), strict=True))


def test_a_known_posterior_has_its_known_metrics(posterior):
    found = asked(posterior, posterior.grid.T_sensor_object[2])
    assert found["nll_nats"] == pytest.approx(-np.log(0.2))
    assert found["entropy_nats"] == pytest.approx(-(P * np.log(P)).sum())
    assert found["expected_error_m"] == pytest.approx(STEP_M * (0.1 * 2 + 0.4 * 1 + 0.3 * 1))
    assert found["spread_m"] == pytest.approx(STEP_M * (0.1 * 1 + 0.2 * 1 + 0.3 * 2))
    levels = [asked(posterior, posterior.grid.T_sensor_object[2], seed)["credible_level"] for seed in range(400)]
    assert (min(levels), max(levels)) == (pytest.approx(0.7, abs=5e-3), pytest.approx(0.9, abs=5e-3))
    assert np.mean(levels) == pytest.approx(0.8, abs=0.01)


def test_a_truth_between_poses_counts_as_the_nearest_pose(posterior):
    T = posterior.grid.T_sensor_object[1].copy()
    T[0, 3] += 0.4 * STEP_M
    assert asked(posterior, T)["nll_nats"] == pytest.approx(-np.log(0.4))
    assert asked(posterior, T)["expected_error_m"] == pytest.approx(
        STEP_M * (0.1 * 1.4 + 0.4 * 0.4 + 0.2 * 0.6 + 0.3 * 1.6)
    )


def test_posterior_metrics_respect_the_symmetry(make_object):
    part = make_object(trimesh.creation.box((0.02, 0.01, 0.01)), "z2")
    grid = PoseGrid(make_transform(np.eye(3), np.zeros((1, 3))), PoseMetric(part))
    turned = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))
    assert asked(PosePosterior(grid, np.zeros(1)), turned)["expected_error_m"] == pytest.approx(0, abs=1e-9)


def test_credible_levels_of_calibrated_posteriors_are_uniform(posterior):
    rng = np.random.default_rng(5)
    truths = rng.choice(4, size=4000, p=P)
    levels = [
        measure_posterior(posterior, posterior.grid.T_sensor_object[i], rng)[POSTERIOR_METRICS.index("credible_level")]
        for i in truths
    ]
    held = [(np.array(levels) <= sure).mean() for sure in (0.25, *LEVELS)]
    assert held == pytest.approx((0.25, *LEVELS), abs=0.025)


@pytest.mark.parametrize("symmetry", ["none", "z2"])
def test_nees_of_errors_drawn_from_the_covariance_is_six_on_average(make_object, symmetry):
    part = make_object(trimesh.creation.box((0.02, 0.01, 0.01)), symmetry)
    metric, rng = PoseMetric(part), np.random.default_rng(7)
    root = rng.normal(size=(6, 6)) * ([1e-4] * 3 + [3e-3] * 3)
    covariance, found = root.T @ root, []
    T = make_transform(rotation_about([1, 2, 3], 0.7), [0.01, 0.02, 0.03])
    for _ in range(300):
        e = root.T @ rng.normal(size=6)
        turned = rotation_about(e[3:], np.linalg.norm(e[3:])) @ T[:3, :3]
        truth = make_transform(turned, T[:3, 3] + e[:3]) @ part.symmetry.list_elements()[-1]
        found.append(compute_nees(metric, T, covariance, truth))
    assert np.mean(found) == pytest.approx(6.0, abs=0.6)  # three standard deviations of the mean
    assert np.median(found) == pytest.approx(5.35, abs=0.7)
