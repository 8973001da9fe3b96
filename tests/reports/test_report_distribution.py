"""A distribution over poses, for pictures: over the object's surface, and over rotations."""

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import align_to_z, draw_rotations, make_transform, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.reports.distribution import (
    compute_vertex_areas,
    compute_yaw_rad,
    count_yaws,
    map_sides,
    spread_over_surface,
)

Z = [0, 0, 1]


def surface(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))


@pytest.fixture(scope="module")
def rod() -> TriangleMesh:
    """Thin triangles as long as the rod."""
    return surface(trimesh.creation.cylinder(0.004, 0.060, sections=48))


@pytest.fixture
def centre(flat_camera) -> np.ndarray:
    """The middle of the sensor's surface, in metres."""
    x0, x1, y0, y1 = flat_camera.rectangle
    return np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), flat_camera.standoff_m])


def test_vertices_of_a_ball_have_its_areas_and_normals():
    ball = surface(trimesh.creation.icosphere(3, 0.01))
    assert compute_vertex_areas(ball).sum() == pytest.approx(ball.face_areas.sum())
    outwards = ball.vertices_m / 0.01
    assert (ball.vertex_normals * outwards).sum(axis=1).min() > 0.999


def test_the_probability_sums_to_one_and_lies_under_the_sensor(rod, flat_camera, centre):
    """In all poses, the same point of the rod is above the sensor's centre."""
    touched = np.array([0.004, 0.0, 0.013])
    R = draw_rotations(50, np.random.default_rng(0))
    T = make_transform(R, centre - R @ touched)
    weights = np.random.default_rng(1).dirichlet(np.ones(50))
    found = spread_over_surface(rod, T, weights, flat_camera, 0.001)
    assert found.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert (found.mass >= 0).all()
    away = np.linalg.norm(found.mesh.vertices_m - touched, axis=1)
    assert found.mass[away < 0.0045].sum() == pytest.approx(1.0)
    assert away[found.density.argmax()] < 0.002


def test_the_back_of_a_thin_wall_gets_no_probability(flat_camera, centre):
    plate = surface(trimesh.creation.box((0.03, 0.03, 0.0005)))
    T = make_transform(np.eye(3), centre - [0.001, 0.002, -0.00025])[None]  # on its lower side
    found = spread_over_surface(plate, T, np.ones(1), flat_camera, 0.002)
    assert found.mass.sum() == pytest.approx(1.0)
    assert found.mass[found.mesh.vertices_m[:, 2] > 0].sum() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("normal", [[0, 0, -1], [0, 0, 1], [1, 0, 0], [0.3, -0.5, 0.2]])
def test_the_yaw_is_the_rotation_of_a_face_on_the_sensor(normal):
    yaw = np.linspace(-3, 3, 25)
    R = rotation_about(Z, yaw) @ align_to_z(-np.array(normal, float))
    assert compute_yaw_rad(R) == pytest.approx(yaw)


def test_yaw_and_side_determine_the_rotation():
    R = draw_rotations(40, np.random.default_rng(0))
    again = np.stack([rotation_about(Z, yaw) @ align_to_z(r[2]) for yaw, r in zip(compute_yaw_rad(R), R, strict=True)])
    assert again == pytest.approx(R)


def test_a_lattice_has_a_bar_for_each_yaw_and_irregular_yaws_are_counted_in_bins():
    yaw_deg = np.repeat(np.arange(0, 360, 15.0), 3)
    weights = np.random.default_rng(0).dirichlet(np.ones(len(yaw_deg)))
    found = count_yaws(rotation_about(Z, np.radians(yaw_deg)) @ align_to_z([0, 1, 0]), weights)
    assert found["deg"] == pytest.approx(np.arange(0, 360, 15.0), abs=0.01)
    assert found["percent"] == pytest.approx(100 * weights.reshape(-1, 3).sum(axis=1))
    assert found["width"] == pytest.approx(15.0)
    irregular = count_yaws(draw_rotations(500, np.random.default_rng(0)), np.full(500, 1 / 500))
    assert len(irregular["percent"]) == 36
    assert sum(irregular["percent"]) == pytest.approx(100)


def test_small_tilts_are_mapped_in_the_sensor_frame():
    tilt = np.radians([-10.0, 0.0, 10.0])
    R = rotation_about([1, 0, 0], tilt) @ rotation_about(Z, np.array(0.7)) @ align_to_z([1, 0, 0])
    found = map_sides(R, np.array([0.2, 0.3, 0.5]))
    assert found["kind"] == "lean"
    share, edges = np.array(found["percent"]) / 100, np.array(found["y"])
    assert share.sum() == pytest.approx(1.0)
    y = 0.5 * (edges[1:] + edges[:-1])
    rows = share.sum(axis=1)
    # rotated about +x by 10 degrees, the side that faced -z leans towards +y
    assert sorted(zip(y[rows > 0].round(1), rows[rows > 0].round(6), strict=True)) == [
        (pytest.approx(-10, abs=1), 0.2),
        (pytest.approx(0, abs=1), 0.3),
        (pytest.approx(10, abs=1), 0.5),
    ]
    assert share[:, len(rows) // 2].sum() == pytest.approx(1.0)


def test_poses_on_all_sides_are_mapped_on_a_globe_of_equal_areas():
    R = draw_rotations(20_000, np.random.default_rng(0))
    weights = np.full(len(R), 0.5 / len(R))
    side = np.array([np.cos(np.radians(40)), np.sin(np.radians(40)), 0.0])
    R = np.concatenate([R, align_to_z(-side)[None]])
    found = map_sides(R, np.append(weights, 0.5))
    assert found["kind"] == "globe"
    share = np.array(found["percent"]) / 100
    assert share.sum() == pytest.approx(1.0)
    row, column = np.unravel_index(share.argmax(), share.shape)
    assert np.mean(found["x"][column : column + 2]) == pytest.approx(40, abs=10)
    assert np.mean(found["y"][row : row + 2]) == pytest.approx(0, abs=7)
    rest = np.sort(share.ravel())[:-1]
    assert rest.max() < 2.5 * rest.mean()
    assert found["normal"] == pytest.approx(side)
