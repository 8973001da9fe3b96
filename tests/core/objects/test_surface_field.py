"""The nearest surface point, compared with the search of trimesh."""

import numpy as np
import pytest
import trimesh

from tactile_loc.core.objects import surface_field as module
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.objects.surface_field import SurfaceField, build_surface_field, find_closest_point, pack_triangles
from tactile_loc.core.runtime.caches import ByteCache

SOLIDS = {
    "ball": trimesh.creation.icosphere(3, 0.008),
    "box": trimesh.creation.box((0.03, 0.02, 0.012)),
    "ring": trimesh.creation.annulus(0.004, 0.009, 0.006),
}
MESHES = {
    name: TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64)) for name, solid in SOLIDS.items()
}


@pytest.mark.parametrize("name", SOLIDS)
def test_the_nearest_point_agrees_with_trimesh(name):
    mesh = MESHES[name]
    rng = np.random.default_rng(0)
    points = mesh.sample(2000, rng) + rng.normal(0, 1e-4, (2000, 3))
    found, which = SurfaceField.of(mesh).find_closest(points)
    # trimesh has absolute tolerances too large for metres
    in_mm = trimesh.Trimesh(1e3 * mesh.vertices_m, mesh.faces, process=False)
    distance_m = 1e-3 * trimesh.proximity.closest_point(in_mm, 1e3 * points)[1]
    assert (which >= 0).all()
    off_m = np.linalg.norm(found - points, axis=1) - distance_m
    assert off_m.min() > -1e-9
    # near an edge, another triangle that is as near to the cell's centre may be chosen
    assert np.median(off_m) < 1e-9
    assert np.quantile(off_m, 0.95) < 2e-4
    assert off_m.max() < 5e-4


def test_the_fields_used_last_are_kept_within_a_number_of_bytes(monkeypatch):
    meshes = list(MESHES.values())
    sizes = [build_surface_field(mesh).nbytes for mesh in meshes]
    assert all(size > SurfaceField.of(mesh).distances.nbytes for size, mesh in zip(sizes, meshes, strict=True))
    monkeypatch.setattr(module, "_fields", ByteCache(sum(sizes) - 1, lambda field: field.nbytes))
    first, second, third = map(build_surface_field, meshes)
    assert module._fields.nbytes == sizes[1] + sizes[2]
    assert build_surface_field(meshes[1]) is second
    assert build_surface_field(meshes[2]) is third
    assert build_surface_field(meshes[0]) is not first


def test_no_point_is_found_beyond_the_reach():
    mesh = MESHES["ball"]
    found, which = SurfaceField.of(mesh, reach_m=2e-3).find_closest(np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.009]]))
    assert which.tolist()[0] == -1
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1], [0, 0, 0.008], atol=1e-4)


def test_distances_from_a_ball_equal_their_formula():
    field = SurfaceField.of(MESHES["ball"])
    points = np.array([[0.008, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.1]])
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    outwards = np.eye(4)
    outwards[0, 3] = 1e-3  # the first point is then 1 mm away, the second hypot(1, 10) - 8 mm
    expected = [[0.0, 2e-3, np.inf], [0.0, 2e-3, np.inf], [1e-3, np.hypot(1e-3, 1e-2) - 8e-3, np.inf]]
    found = field.measure_distances(points, np.stack([np.eye(4), turn, outwards]))
    np.testing.assert_allclose(found, expected, atol=3e-5)
    assert field.measure_distances(np.zeros((0, 3)), np.eye(4)[None]).shape == (1, 0)


def test_estimated_gaps_differ_from_the_gaps_by_less_than_a_cell():
    mesh = MESHES["ball"]
    field, points = SurfaceField.of(mesh), mesh.sample(500, np.random.default_rng(3))
    moves = np.tile(np.eye(4), (4, 1, 1))
    moves[:, 2, 3] = [0.0, 1e-3, 3e-3, 0.1]
    exact = np.minimum(field.measure_distances(points, moves), field.reach_m).mean(axis=1)
    rough = field.estimate_distances(points, moves)
    assert exact[0] < 1e-9
    assert exact[3] == pytest.approx(field.reach_m)
    assert rough[3] == pytest.approx(field.reach_m)
    np.testing.assert_allclose(rough, exact, atol=0.5 * np.sqrt(3) * 5e-4)
    assert field.estimate_distances(np.zeros((0, 3)), moves).tolist() == [0.0] * 4


def test_the_closest_point_is_right_in_every_region_of_a_triangle():
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    cases = {
        (0.5, 0.5, 3.0): (0.5, 0.5, 0.0),
        (-1.0, -1.0, 1.0): (0.0, 0.0, 0.0),
        (5.0, -1.0, 0.0): (2.0, 0.0, 0.0),
        (-1.0, 5.0, 0.0): (0.0, 2.0, 0.0),
        (1.0, -2.0, 0.5): (1.0, 0.0, 0.0),
        (-2.0, 1.0, 0.5): (0.0, 1.0, 0.0),
        (2.0, 2.0, -1.0): (1.0, 1.0, 0.0),
    }
    for point, nearest in cases.items():
        found = find_closest_point(*point, 0, pack_triangles(corners[None]))
        np.testing.assert_allclose(found, nearest, atol=1e-12)


@pytest.mark.parametrize("name", SOLIDS)
def test_triangles_with_a_common_edge_are_neighbours(name):
    solid = SOLIDS[name]
    faces = np.concatenate([solid.faces, solid.faces[:1]])  # a triangle twice, which is no neighbour of itself
    beside, ends = module._find_neighbours(np.array(solid.vertices)[faces])
    pairs = {(f, int(other)) for f in range(len(faces)) for other in beside[ends[f] : ends[f + 1]]}
    expected = {(int(a), int(b)) for one, other in solid.face_adjacency for a, b in ((one, other), (other, one))}
    last = len(solid.faces)
    copied = {(last, b) for a, b in expected if a == 0} | {(a, last) for a, b in expected if b == 0}
    assert pairs == expected | copied


def test_rounding_does_not_choose_between_the_triangles_of_an_edge():
    """Beside an edge, both faces are equally near. The face that the point is farther above is taken."""
    field, rng = SurfaceField.of(MESHES["box"]), np.random.default_rng(0)
    beyond = rng.uniform(1e-4, 2e-3, (200, 2))
    beyond[:50, 1] = beyond[:50, 0]  # on the bisector of the edge
    points = np.column_stack([rng.uniform(-0.012, 0.012, 200), 0.01 + beyond[:, 0], 0.006 + beyond[:, 1]])
    which = field.find_closest(points)[1]
    for _ in range(5):
        assert np.array_equal(field.find_closest(points + rng.normal(0, 1e-15, points.shape))[1], which)
    normals = field.triangles.normals[which]
    above_y = beyond[:, 0] > beyond[:, 1]
    np.testing.assert_allclose(normals[50:][above_y[50:]], np.broadcast_to([0, 1, 0], (above_y[50:].sum(), 3)))
    np.testing.assert_allclose(normals[50:][~above_y[50:]], np.broadcast_to([0, 0, 1], ((~above_y[50:]).sum(), 3)))


def test_a_search_ends_at_a_corner_whose_triangles_are_almost_equally_near():
    """Above this flat corner, each of three triangles is preferred to the next one, because equal is a range."""
    angle = np.radians([0, 120, 240])
    heights = [-1.49686227971962e-4, -1.48554223018370e-4, -1.50795846674782e-4]
    rim = 5e-3 * np.column_stack([np.cos(angle), np.sin(angle), heights])
    fan = TriangleMesh(np.vstack([np.zeros(3), rim]), np.array([(0, 3, 1), (0, 2, 3), (0, 1, 2)]))
    triangles = SurfaceField.of(fan).triangles
    for first in range(3):
        assert module.walk_to_nearest(0.0, 0.0, 1e-3, first, triangles)[1] == pytest.approx(1e-6)
