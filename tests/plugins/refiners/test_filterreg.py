import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactile_loc.bases.cloud_refiner import Cloud
from tactile_loc.core.geometry.lie import exponential
from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about, transform_points
from tactile_loc.plugins.refiners.filterreg import kernels
from tactile_loc.plugins.refiners.filterreg.refiner import REACH, FilterRegRefiner, Mixtures

Options = FilterRegRefiner.Options


def bowl(count: int = 900, seed: int = 0) -> Cloud:
    """A curved patch of 10 x 7 mm that nothing slides on: z = x^2 / 10 + y^2 / 6 + x y / 20, normals downwards."""
    x, y = np.random.default_rng(seed).uniform([-5, -3.5], [5, 3.5], (count, 2)).T
    points = np.column_stack([x, y, x**2 / 10 + y**2 / 6 + x * y / 20])
    normals = np.column_stack([x / 5 + y / 20, y / 3 + x / 20, -np.ones(count)])
    return Cloud(points, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.sqrt(70.0 / count))


def moved(cloud: Cloud, T: np.ndarray) -> Cloud:
    return Cloud(transform_points(T, cloud.points_mm), cloud.normals @ T[:3, :3].T, cloud.spacing_mm)


def small_motion(scale: float = 1.0) -> np.ndarray:
    return make_transform(rotation_about([1, -2, 3], 0.08 * scale), [0.4 * scale, -0.3 * scale, 0.2 * scale])


def normal_equations(source: Cloud, observed) -> np.ndarray:
    result, T = np.zeros((1, 6, 7)), np.eye(4)[None]
    starts, which, centre = np.array([0, len(source)]), np.array([0]), source.points_mm.mean(axis=0)[None]
    cloud, candidates = (source.points_mm, source.normals, starts), (which, T, centre)
    kernels.add_equations(0, 1, cloud, candidates, observed, result)
    return result[0]


def test_the_sums_equal_those_over_all_points_within_reach():
    """The table, its columns and the cut-off against a plain sum over a KD-tree's neighbours."""
    target, sigma = bowl(), 0.4
    observed = Mixtures(target, 0.1).make_mixture(sigma, merged=False)
    near = cKDTree(target.points_mm).query_ball_point(target.points_mm[:: len(target.points_mm) // 100], REACH * sigma)
    expected = []
    for i, js in zip(range(0, 900, 9), near, strict=True):
        squared = ((target.points_mm[js] - target.points_mm[i]) ** 2).sum(axis=1)
        facing = np.maximum(0.0, target.normals[js] @ target.normals[i])
        expected.append((facing * np.exp(-0.5 * squared / sigma**2)).sum())
    assert observed.outlier == pytest.approx(np.mean(expected) * 0.1 / 0.9, rel=1e-9)


def test_the_normal_equations_are_the_derivatives_of_the_cost():
    """Compare with finite differences of the weighted cost at fixed correspondences."""
    target, source = bowl(), moved(bowl(60, seed=1), small_motion())
    observed = Mixtures(target, 0.1).make_mixture(0.5, merged=False)
    x, n, y = source.points_mm, source.normals, target.points_mm
    squared = ((x[:, None] - y) ** 2).sum(axis=2)
    w = np.maximum(0.0, n @ target.normals.T) * np.exp(-0.5 * squared / 0.5**2) * (squared < (REACH * 0.5) ** 2)
    m = w.sum(axis=1)
    mean, normal = w @ y / m[:, None], w @ target.normals / m[:, None]
    trust, centre = m / (m + observed.outlier), x.mean(axis=0)

    def cost(twist):
        T = exponential(twist, centre)
        apart = transform_points(T, x) - mean
        flat = (apart * normal).sum(axis=1)
        return 0.5 * (trust * flat**2).sum()

    found, h = normal_equations(source, observed), 1e-5
    slope = [(cost(h * e) - cost(-h * e)) / (2 * h) for e in np.eye(6)]
    np.testing.assert_allclose(-found[:, 6], slope, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found[:, :6], found[:, :6].T, atol=1e-9)
    assert (np.linalg.eigvalsh(found[:, :6]) > 0).all()


def test_a_known_motion_is_undone():
    """Target and source are different samples of one surface, so that no two points are the same."""
    T = small_motion()
    found = FilterRegRefiner().register(moved(bowl(600, seed=1), T), bowl(3000))
    assert found.converged
    assert found.iterations < 20
    np.testing.assert_allclose(transform_points(found.T_mm @ T, bowl().points_mm), bowl().points_mm, atol=0.03)


def test_the_registration_is_robust_to_outliers():
    T, rng = small_motion(0.7), np.random.default_rng(5)
    source = moved(bowl(600, seed=1), T)
    stray = bowl(150, seed=2)
    stray = Cloud(stray.points_mm + [0, 0, 1] * rng.uniform(0.8, 2.0, (150, 1)), stray.normals, stray.spacing_mm)
    points, normals = (np.concatenate([getattr(c, name) for c in (source, stray)]) for name in ("points_mm", "normals"))
    both = Cloud(points, normals, source.spacing_mm)
    errors = []
    for outlier in (0.3, 1e-6):
        found = FilterRegRefiner(Options(outlier=outlier, sigma_mm=1.0)).register(both, bowl(3000)).T_mm
        errors.append(np.abs(transform_points(found @ T, bowl().points_mm) - bowl().points_mm).max())
    assert errors[0] < 0.05
    assert errors[0] < 0.5 * errors[1]


def test_clouds_out_of_reach_are_not_registered():
    found = FilterRegRefiner().register(moved(bowl(), make_translation([0, 0, 50.0])), bowl())
    assert (found.T_mm, found.converged, found.iterations) == (None, False, 1)


def test_few_iterations_do_not_claim_to_have_converged():
    source = moved(bowl(600, seed=1), small_motion())
    for most in (1, 3):
        found = FilterRegRefiner(Options(iterations=most)).register(source, bowl(3000))
        assert found.T_mm is not None
        assert (found.converged, found.iterations) == (False, most)


def test_a_plane_does_not_slide():
    """A plane does not determine a position along itself, so the cloud only moves onto the plane."""
    x, y = np.random.default_rng(0).uniform(-5, 5, (2, 2000))
    plane = Cloud(np.column_stack([x, y, 0 * x]), np.tile([0.0, 0.0, -1.0], (2000, 1)), 0.2)
    inner = Cloud(plane.points_mm[(abs(x) < 3) & (abs(y) < 3)][::3], plane.normals[:300], 0.4)
    inner = Cloud(inner.points_mm[:200], inner.normals[:200], 0.4)
    T = FilterRegRefiner().register(moved(inner, make_translation([0, 0, 0.3])), plane).T_mm
    np.testing.assert_allclose(T[:3, 3], [0, 0, -0.3], atol=1e-3)
