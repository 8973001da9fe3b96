"""Registration of touched points to a surface, and the helpers of the methods."""

import numpy as np
import pytest
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about, transform_points

from tactile_loc_benchmark.methods.pixel_matching import measure_differences
from tactile_loc_benchmark.methods.surface_fit import FitOptions, SurfaceFit, shrink
from tactile_loc_benchmark.methods.touched_points import TouchedPoints, find_deepest_point
from tactile_loc_benchmark.methods.transform_consensus import PairTable

REACH_M = shrink(2e-3, 5e-4, 20)
MOTION = make_transform(rotation_about([1, 2, 3], np.radians(4)), [4e-4, -3e-4, 5e-4])


@pytest.fixture(scope="module")
def fit(example):
    return SurfaceFit.of(example.object, FitOptions())


@pytest.fixture(scope="module")
def points(example):
    return TouchedPoints.of(example.touches, 300)


@pytest.fixture(scope="module")
def truth(example, points):
    return invert(points.T_base_first) @ example.T_base_object


def test_touched_points_lie_on_the_surface(fit, points, truth):
    x = transform_points(invert(truth), points.points_m)
    nearest, which = fit.field.find_closest(x)
    assert np.linalg.norm(x - nearest, axis=1).max() < 1e-6
    turned = points.normals @ truth[:3, :3]
    assert np.einsum("pi,pi->p", turned, fit.field.triangles.normals[which]).mean() > 0.9


def test_touches_have_equal_weights(points):
    for k in range(3):
        assert points.weights[points.touch == k].sum() == pytest.approx(1 / 3)
    few = points.thin(31)
    assert len(few.points_m) <= 31
    assert few.weights.sum() == pytest.approx(1.0)


def test_the_deepest_point_is_the_nearest_one(example):
    touch = example.touches[0]
    z_m = find_deepest_point(touch)[2]
    assert z_m == pytest.approx(touch.geometry.surface_m - touch.indentation_m, abs=0.05 * touch.press_depth_m)


def test_registration_undoes_a_small_motion(fit, points, truth):
    found = fit.register((truth @ MOTION)[None], points, REACH_M)
    start, end = (fit.score(T, points, 5e-4)[0] for T in ((truth @ MOTION)[None], found))
    assert end > 0.95 > start


def test_poses_are_registered_one_by_one(fit, points, truth):
    T = np.stack([truth, truth @ MOTION, truth @ invert(MOTION)])
    together = fit.register(T, points, REACH_M)
    alone = np.concatenate([fit.register(one[None], points, REACH_M) for one in T])
    np.testing.assert_allclose(together, alone, atol=1e-9)


def test_the_score_is_one_at_the_truth_and_none_far_away(fit, points, truth):
    far = make_translation([0.3, 0, 0]) @ truth
    scores = fit.score(np.stack([truth, far]), points, 5e-4)
    assert scores[0] > 0.9
    assert scores[1] == 0


def test_the_best_poses_come_first_and_are_apart(fit, points, truth, example):
    rng = np.random.default_rng(0)
    some = np.stack([truth @ make_translation(rng.normal(0, 3e-3, 3)) for _ in range(20)])
    answer = fit.find_best(some, points)
    assert (np.diff(answer.scores) <= 0).all()
    apart_m = np.linalg.norm(answer.T_base_object[1:, :3, 3] - answer.T_base_object[0, :3, 3], axis=1)
    assert len(apart_m) == 0 or apart_m.min() > 1e-4


def test_differences_are_sums_over_observed_pixels():
    rng = np.random.default_rng(0)
    seen, drawn = (rng.random((k, 4, 5)).astype(np.float32) * 1e-3 for k in (3, 2))
    observed = rng.random((3, 4, 5)) < 0.7
    expected = [[1e6 * np.sum(o * (s - d) ** 2) for s, o in zip(seen, observed, strict=True)] for d in drawn]
    np.testing.assert_allclose(measure_differences(seen, observed, drawn), expected, rtol=1e-4)


def test_votes_find_the_transform_of_the_same_points(fit):
    points_m, normals = fit.sample_surface(200)
    table = PairTable.of(points_m, normals, 2e-3)
    T = make_transform(rotation_about([1, 2, 3], 2.0), [0.1, 0.2, 0.3])
    moved_m, moved_normals = transform_points(T, points_m), normals @ T[:3, :3].T
    found = table.vote(moved_m, moved_normals, 5)[0] @ T
    assert np.linalg.norm(transform_points(found, points_m) - points_m, axis=1).mean() < 3e-3
