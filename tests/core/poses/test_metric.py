import numpy as np
import pytest
import trimesh
from pose_helpers import random_poses
from scipy.spatial.distance import cdist

from tactile_loc import ObjectModel, TriangleMesh, load_object
from tactile_loc.core.poses import metric
from tactile_loc.core.poses.metric import SPACING_SAMPLE, PoseGrid, PoseMetric, measure_distances, remove_equivalent
from tactile_loc.plugin.helpers import SymmetryGroup, draw_rotations, make_translation, transform_points


def quadrature(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return points and weights that integrate quadratics over the surface exactly: the middles of all face edges."""
    a, b, c = np.moveaxis(mesh.triangles_m, 1, 0)
    points = np.concatenate([a + b, b + c, c + a]) / 2
    weights = np.tile(mesh.face_areas, 3)
    return points, weights / weights.sum()


@pytest.fixture(scope="module")
def pin() -> ObjectModel:
    return load_object("pin", symmetry="none")


def test_embedding_distance_equals_the_rms_point_distance(pin):
    points, weights = quadrature(pin.mesh)
    T1, T2 = random_poses(20, 0), random_poses(20, 1)
    squared = ((transform_points(T1, points) - transform_points(T2, points)) ** 2).sum(axis=-1) @ weights
    metric = PoseMetric(pin)
    np.testing.assert_allclose(((metric.embed(T1) - metric.embed(T2)) ** 2).sum(axis=-1), squared, rtol=1e-9)
    np.testing.assert_allclose(metric.distance(T1, T2), np.sqrt(squared), rtol=1e-9)


def test_a_flat_surface_has_a_metric_in_any_orientation():
    corners = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.02, 0.0]])
    T1, T2 = random_poses(4, 6), random_poses(4, 36)
    for R in draw_rotations(20, np.random.default_rng(37)):  # rounding makes some of the smallest moments negative
        mesh = TriangleMesh(corners @ R.T, np.array([[0, 1, 2]]))
        metric = PoseMetric(ObjectModel("sheet", mesh, SymmetryGroup.parse("none", np.zeros(3))))
        points, weights = quadrature(mesh)
        squared = ((transform_points(T1, points) - transform_points(T2, points)) ** 2).sum(axis=-1) @ weights
        np.testing.assert_allclose(metric.distance(T1, T2), np.sqrt(squared))


def test_equivalents_have_the_same_surface(make_box, cylinder):
    for obj, count in ((make_box(0.03, 0.02, 0.01, symmetry="x2*y2"), 4), (cylinder, None)):
        same = PoseMetric(obj).equivalents(random_poses(2, 12), step_m=0.002)
        assert same.shape[1:] == (2, 4, 4)
        assert count in (None, len(same))
        mesh = trimesh.Trimesh(obj.mesh.vertices_m, obj.mesh.faces, process=False)
        back = np.linalg.inv(same[0, 0]) @ same[:, 0]  # the motion of the object
        for S in back:
            gap = np.abs(trimesh.proximity.signed_distance(mesh, transform_points(S, obj.mesh.vertices_m)))
            assert gap.max() < 4e-5, "the gap is at most the sagitta of the cylinder's 64 sides"


def test_equivalents_of_a_rotationally_symmetric_part_are_at_most_a_step_apart(cylinder):
    metric = PoseMetric(cylinder)
    for step_m in (0.003, 0.0005):
        same = metric.equivalents(random_poses(1, 13), step_m)[:, 0]
        turns = same[: len(same) // 2]  # the others are flipped
        gaps = metric.distance(turns, np.roll(turns, 1, axis=0))
        assert 0.3 * step_m < gaps.max() <= step_m


def test_the_symmetric_distance_between_equivalents_is_zero(make_box, cylinder):
    brick = make_box(0.03, 0.02, 0.01, symmetry="x2*y2")
    for obj in (brick, cylinder):
        metric = PoseMetric(obj)
        T = random_poses(3, 14)
        for S in obj.symmetry.list_elements(0.7):
            assert metric.symmetric_distance(T, T @ S).max() <= 1e-12
    assert PoseMetric(brick).distance(T, T @ brick.symmetry.list_elements()[1]).min() > 0.01, (
        "the plain distance is not zero"
    )


def test_the_distance_of_spheres_is_that_of_their_centres(make_object):
    ball = make_object(trimesh.creation.icosphere(3, 0.01).apply_translation([0.05, 0, 0]), "sphere")
    metric, T1, T2 = PoseMetric(ball), random_poses(20, 14), random_poses(20, 15)
    moved = transform_points(T2, [[0.05, 0, 0]])[:, 0] - transform_points(T1, [[0.05, 0, 0]])[:, 0]
    for distance in (metric.symmetric_distance(T1, T2), metric.distance(T1, T2)):
        np.testing.assert_allclose(distance, np.linalg.norm(moved, axis=1), atol=1e-9)
    same = metric.nearest_equivalents(T1, T2)
    np.testing.assert_allclose(same[:, :3, :3], T2[:, :3, :3])
    np.testing.assert_allclose(metric.symmetric_distance(same, T1), 0, atol=1e-9)


@pytest.fixture(params=["differences", "tree"])
def ways_to_search(request, monkeypatch):
    """Search the nearest pose by all differences, and by a tree."""
    monkeypatch.setattr(metric, "FEW_PAIRS", 10**6 if request.param == "differences" else 0)


@pytest.mark.usefixtures("ways_to_search")
@pytest.mark.parametrize("symmetry", ["none", "x2*y2"])
def test_the_nearest_pose_agrees_with_brute_force(make_box, symmetry):
    obj = make_box(0.03, 0.02, 0.01, symmetry=symmetry)
    grid = PoseGrid(random_poses(300, 17), PoseMetric(obj))
    queries = random_poses(40, 18)
    points, weights = quadrature(obj.mesh)
    same = queries[:, None] @ obj.symmetry.list_elements()
    gaps = transform_points(same, points)[:, :, None] - transform_points(grid.T_sensor_object, points)
    rms = np.sqrt((gaps**2).sum(axis=-1) @ weights).min(axis=1)
    distance, index = grid.nearest(queries)
    assert index.tolist() == rms.argmin(axis=1).tolist()
    np.testing.assert_allclose(distance, rms.min(axis=1))


@pytest.mark.usefixtures("ways_to_search")
@pytest.mark.parametrize("symmetry", ["none", "x2*y2", "zinf*x2"])
def test_the_nearest_pose_within_a_bound_is_the_nearest_or_none(make_box, cylinder, symmetry):
    obj = cylinder if "inf" in symmetry else make_box(0.03, 0.02, 0.01, symmetry=symmetry)
    grid, queries = PoseGrid(random_poses(300, 24), PoseMetric(obj)), random_poses(60, 25)
    distance, index = grid.nearest(queries)
    bound_m = float(np.median(distance))
    near, found = grid.nearest(queries, bound_m)
    inside = distance < bound_m
    assert np.array_equal(found, np.where(inside, index, -1))
    np.testing.assert_array_equal(near, np.where(inside, distance, np.inf))


def finely_sampled(metric, T1, T2, step_m=2e-4):
    """Return the smallest distance over a sampled symmetry."""
    return metric.distance(metric.equivalents(T1, step_m), T2).min(axis=0)


def test_the_distance_of_orbits_equals_that_of_their_nearest_poses(cylinder):
    """The distance is exact for any rotation of a rotationally symmetric part; sampled ones agree within a step."""
    metric, T1, T2 = PoseMetric(cylinder), random_poses(50, 26), random_poses(50, 27)
    gaps = metric.embed_orbits(T1) - metric.embed_orbits(T2)[0]
    exact = np.linalg.norm(gaps, axis=-1).min(axis=0)
    sampled = finely_sampled(metric, T1, T2)
    np.testing.assert_array_equal(metric.symmetric_distance(T1, T2), exact)
    assert (exact <= sampled + 1e-12).all()
    assert (sampled**2 <= exact**2 + 1e-8).all(), "half a step along the orbit at most"
    turned = T1 @ cylinder.symmetry.list_elements(0.123)[4]
    np.testing.assert_allclose(metric.embed_orbits(turned)[0], metric.embed_orbits(T1)[0], atol=1e-12)


def test_orbit_distances_hold_for_a_centre_of_symmetry_off_the_centroid():
    """A cone whose declared centre is its tip."""
    cone = trimesh.creation.cone(0.01, 0.03, sections=48)
    mesh = TriangleMesh(np.array(cone.vertices), np.array(cone.faces, np.int64))
    metric = PoseMetric(ObjectModel("cone", mesh, SymmetryGroup.parse("zinf", [0, 0, 0.03])))
    T1, T2 = random_poses(40, 28), random_poses(40, 29)
    exact = np.linalg.norm(metric.embed_orbits(T1)[0] - metric.embed_orbits(T2)[0], axis=-1)
    np.testing.assert_allclose(exact, finely_sampled(metric, T1, T2, 1e-4), rtol=1e-3)


def test_the_mean_spacing_of_a_lattice_is_its_pitch(box, cylinder):
    x = np.stack(np.meshgrid(np.arange(40), np.arange(40), [0]), -1).reshape(-1, 3) * 0.003
    assert PoseGrid(make_translation(x), PoseMetric(box)).spacing_m == pytest.approx(0.003)
    assert PoseGrid(make_translation(x) @ cylinder.symmetry.list_elements(0.5)[3], PoseMetric(cylinder)).spacing_m == (
        pytest.approx(0.003)
    )
    grid, alone = (PoseGrid(make_translation(some), PoseMetric(box)) for some in (x, x[:1]))
    np.testing.assert_allclose(grid.neighbour_spacing(), 0.003)
    np.testing.assert_allclose(grid.neighbour_spacing(np.array([0, 7])), [0.003, 0.003])
    assert alone.spacing_m == np.inf
    assert alone.neighbour_spacing().tolist() == [np.inf]


def test_the_mean_spacing_of_a_large_grid_includes_all_parts(box):
    steps_m = np.repeat([0.001, 0.003, 0.002], SPACING_SAMPLE)
    x = np.column_stack([np.cumsum(steps_m), 0 * steps_m, 0 * steps_m])
    assert PoseGrid(make_translation(x), PoseMetric(box)).spacing_m == pytest.approx(0.002, rel=0.01)
    two = PoseGrid(make_translation([[0, 0, 0], [0, 0.004, 0.0]]), PoseMetric(box))
    assert two.spacing_m == pytest.approx(0.004)
    assert two.neighbour_spacing() == pytest.approx([0.004, 0.004])


def test_find_within_includes_symmetric_poses(make_box):
    obj = make_box(0.03, 0.02, 0.01, symmetry="z2")
    T = random_poses(1, 20)[0]
    half_turn = obj.symmetry.list_elements()[1]
    off = [make_translation([0.001 * k, 0, 0]) @ T for k in range(5)]
    grid = PoseGrid(np.stack([*off, *(t @ half_turn for t in off)]), PoseMetric(obj))
    assert grid.find_within(0.0015, 0).tolist() == [0, 1, 5, 6]


def test_removal_keeps_no_two_poses_within_the_radius(cylinder):
    T = random_poses(150, 22, spread_m=0.002)
    metric, radius_m = PoseMetric(cylinder), 0.004
    keep = remove_equivalent(T, metric, radius_m)
    kept = T[keep]
    assert 5 < len(kept) < 100
    same = metric.embed(metric.equivalents(T, step_m=radius_m / 10))
    gaps = np.stack([cdist(equivalents, metric.embed(kept)) for equivalents in same]).min(axis=0)
    assert np.sort(gaps[keep], axis=1)[:, 1].min() >= 0.98 * radius_m
    assert gaps.min(axis=1).max() <= 1.01 * radius_m, "every removed pose is near a kept one"


def test_removal_keeps_all_poses_of_an_asymmetric_object_and_accepts_none(box, cylinder):
    T = np.repeat(random_poses(2, 23), 2, axis=0)
    assert remove_equivalent(T, PoseMetric(box), 0.001).all()
    for obj in (box, cylinder):
        assert remove_equivalent(T[:0], PoseMetric(obj), 0.001).shape == (0,)


@pytest.fixture(params=["none", "x2*y2", "zinf*x2"])
def grid(request, make_box, cylinder) -> PoseGrid:
    obj = cylinder if "inf" in request.param else make_box(0.03, 0.02, 0.01, symmetry=request.param)
    return PoseGrid(random_poses(60, 30), PoseMetric(obj))


def test_the_nearest_equivalent_is_equivalent_and_nearest(grid):
    metric, T, T_near = grid.metric, random_poses(7, 31), random_poses(7, 32)
    found = metric.nearest_equivalents(T, T_near)
    assert metric.symmetric_distance(found, T).max() < 1e-12
    least = metric.symmetric_distance(T, T_near)
    np.testing.assert_allclose(metric.distance(found, T_near) ** 2, least**2, atol=1e-8)


def test_distances_between_points_are_euclidean():
    a, b = np.random.default_rng(34).normal(size=(2, 9, 5))
    np.testing.assert_allclose(measure_distances(a, b[:4]), cdist(a, b[:4]), rtol=1e-7)
    assert measure_distances(1e3 * a, 1e3 * a).diagonal() == pytest.approx(0, abs=1e-3), (
        "no square root of a negative number"
    )


@pytest.mark.usefixtures("ways_to_search")
@pytest.mark.parametrize("steps_m", [[0.02], [-0.02], [0.03, -0.01]])
def test_a_raised_grid_equals_a_grid_of_raised_poses(grid, steps_m):
    raised = grid
    for step_m in steps_m:
        raised = raised.raise_level(step_m)
    up = make_translation([0, 0, sum(steps_m)])
    anew = PoseGrid(up @ grid.T_sensor_object, grid.metric)
    np.testing.assert_allclose(raised.T_sensor_object, anew.T_sensor_object, atol=1e-15)
    np.testing.assert_allclose(raised.phi, anew.phi, atol=1e-12)
    queries = random_poses(20, 35)
    for found, expected in zip(raised.nearest(queries), anew.nearest(queries), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(raised.distances(queries[0]), anew.distances(queries[0]), atol=1e-9)
    np.testing.assert_allclose(raised.neighbour_spacing(), anew.neighbour_spacing(), atol=1e-12)
    assert raised.spacing_m == pytest.approx(anew.spacing_m)
    assert raised.find_within(0.02, 5).tolist() == anew.find_within(0.02, 5).tolist()


def test_a_raised_grid_shares_the_search_tree(grid):
    before = grid.T_sensor_object.copy()
    assert grid.raise_level(0.0) is grid
    assert grid.raise_level(0.01).raise_level(0.01)._orbit_tree is grid._orbit_tree
    assert np.array_equal(grid.T_sensor_object, before)
