"""The nearest surface point, compared with the search of trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.objects.surface_field import SurfaceField, find_closest_on_triangle

SOLIDS = {
    "ball": trimesh.creation.icosphere(3, 0.008),
    "box": trimesh.creation.box((0.03, 0.02, 0.012)),
    "ring": trimesh.creation.annulus(0.004, 0.009, 0.006),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_the_nearest_point_agrees_with_trimesh(name):
    solid = SOLIDS[name]
    mesh = TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))
    rng = np.random.default_rng(0)
    points = mesh.sample(2000, rng) + rng.normal(0, 1e-4, (2000, 3))
    found, which = SurfaceField.of(mesh).find_closest(points)
    in_mm = trimesh.Trimesh(
        1e3 * mesh.vertices_m, mesh.faces, process=False
    )  # trimesh has absolute tolerances too large for metres
    distance_m = 1e-3 * trimesh.proximity.closest_point(in_mm, 1e3 * points)[1]
    assert (which >= 0).all()
    off_m = np.linalg.norm(found - points, axis=1) - distance_m
    assert off_m.min() > -1e-9
    # near an edge, another triangle that is as near to the cell's centre may be chosen
    assert np.median(off_m) < 1e-9
    assert np.quantile(off_m, 0.95) < 2e-4
    assert off_m.max() < 5e-4


def test_no_point_is_found_beyond_the_reach():
    solid = SOLIDS["ball"]
    mesh = TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))
    found, which = SurfaceField.of(mesh, reach_m=2e-3).find_closest(np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.009]]))
    assert which.tolist()[0] == -1
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1], [0, 0, 0.008], atol=1e-4)


def test_the_mean_gap_of_a_ball_equals_its_formula():
    solid = SOLIDS["ball"]
    field = SurfaceField.of(TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64)))
    points = np.array([[0.008, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.1]])
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    outwards = np.eye(4)
    outwards[0, 3] = 1e-3  # the first point then has a gap of 1 mm, the second of hypot(1, 10) - 8 mm
    expected = [2e-3 + 3e-3, 2e-3 + 3e-3, 1e-3 + np.hypot(1e-3, 1e-2) - 8e-3 + 3e-3]
    gaps = field.measure_gaps(points, np.stack([np.eye(4), turn, outwards]), 3e-3)
    np.testing.assert_allclose(gaps, np.array(expected) / 3, atol=3e-5)
    assert field.measure_gaps(np.zeros((0, 3)), np.eye(4)[None], 3e-3).tolist() == [0.0]


def test_exact_gaps_of_surface_points_are_smaller_than_those_of_the_cells():
    solid = SOLIDS["ball"]
    mesh = TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))
    field, points = SurfaceField.of(mesh), mesh.sample(500, np.random.default_rng(3))
    roughly, exactly = (field.measure_gaps(points, np.eye(4)[None], 3e-3, exact)[0] for exact in (False, True))
    assert exactly < 1e-6 < roughly


def test_the_closest_point_is_right_in_every_region_of_a_triangle():
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    cases = {
        (0.5, 0.5, 3.0): (0.5, 0.5, 0.0), (-1.0, -1.0, 1.0): (0.0, 0.0, 0.0), (5.0, -1.0, 0.0): (2.0, 0.0, 0.0),
        (-1.0, 5.0, 0.0): (0.0, 2.0, 0.0), (1.0, -2.0, 0.5): (1.0, 0.0, 0.0), (-2.0, 1.0, 0.5): (0.0, 1.0, 0.0),
        (2.0, 2.0, -1.0): (1.0, 1.0, 0.0),
    }  # fmt: skip
    for point, nearest in cases.items():
        np.testing.assert_allclose(
            find_closest_on_triangle(np.array(point), corners[0], corners[1:] - corners[0]), nearest, atol=1e-12
        )
