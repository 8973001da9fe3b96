from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import (
    draw_rotations,
    make_transform,
    make_translation,
    rotation_about,
    transform_points,
)
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.contact import bring_to_contact, find_lowest_points, group_rotations
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.meshes.mesh_files import load_object

PROJECT = Path(__file__).parents[3]
RECTANGLE = (-0.006, 0.010, -0.004, 0.007)


def surface(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))


@pytest.fixture(scope="module")
def hook() -> TriangleMesh:
    return load_object("hook", symmetry="none").mesh


def random_poses(count: int, seed: int, spread_m: float = 0.02) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_transform(draw_rotations(count, rng), rng.uniform(-spread_m, spread_m, (count, 3)))


def clip(polygon: list[np.ndarray], axis: int, limit: float, sign: float) -> list[np.ndarray]:
    """Return the part of a polygon where sign * coordinate <= sign * limit (Sutherland and Hodgman)."""
    kept = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        da, db = sign * (a[axis] - limit), sign * (b[axis] - limit)
        if da <= 0:
            kept.append(a)
        if da * db < 0:
            kept.append(a + (b - a) * da / (da - db))
    return kept


def lowest_by_clipping(triangles: np.ndarray, rectangle: tuple[float, float, float, float]) -> float:
    x0, x1, y0, y1 = rectangle
    lowest = np.inf
    for triangle in triangles:
        polygon = list(triangle)
        for axis, limit, sign in ((0, x0, -1), (0, x1, 1), (1, y0, -1), (1, y1, 1)):
            polygon = clip(polygon, axis, limit, sign) if polygon else polygon
        lowest = min([lowest, *(p[2] for p in polygon)])
    return lowest


def test_lowest_points_agree_with_clipping_every_triangle(hook):
    T = random_poses(6, 0)
    expected = [
        lowest_by_clipping(transform_points(t, hook.triangles_m.reshape(-1, 3)).reshape(-1, 3, 3), RECTANGLE) for t in T
    ]
    assert np.isfinite(expected).sum() >= 4
    np.testing.assert_allclose(find_lowest_points(hook, T, RECTANGLE), expected, atol=1e-12)


def test_the_lowest_point_of_a_sphere_depends_on_the_rectangle():
    radius = 0.008
    ball = surface(trimesh.creation.icosphere(5, radius))
    # The second sphere's pole lies 3 mm beyond the side x = 10 mm: its lowest point is above that side.
    T = make_translation([[0.001, 0.002, 0.03], [0.013, 0.0, 0.03], [-0.006 - 0.0081, 0.0, 0.03]])
    lowest = find_lowest_points(ball, T, RECTANGLE)
    assert lowest[0] == pytest.approx(0.03 - radius, abs=1e-6)
    assert lowest[1] == pytest.approx(0.03 - np.sqrt(radius**2 - 0.003**2), abs=1e-5)
    assert lowest[2] == np.inf


def test_the_lowest_point_may_be_on_a_corner_an_edge_or_a_face():
    cube = surface(trimesh.creation.box([0.006, 0.006, 0.006]))
    half, over = 0.003, np.array([0.002, 0.001, 0.0])
    on_edge = rotation_about([1, 0, 0], np.pi / 4)
    on_corner = rotation_about(np.cross([1, 1, 1], [0, 0, -1]), np.arccos(-1 / np.sqrt(3)))
    T = make_transform(np.stack([np.eye(3), on_edge, on_corner]), over)
    np.testing.assert_allclose(
        find_lowest_points(cube, T, RECTANGLE), [-half, -half * np.sqrt(2), -half * np.sqrt(3)], atol=1e-12
    )


def test_a_face_that_covers_the_rectangle_is_found():
    plate = surface(trimesh.creation.box([0.2, 0.2, 0.01]))
    slope = make_transform(rotation_about([0, 1, 0], -0.1), [0.0, 0.0, 0.05])
    # The underside rises with x: it is lowest over the side x = x0.
    expected = 0.05 - 0.005 / np.cos(0.1) + RECTANGLE[0] * np.tan(0.1)
    assert find_lowest_points(plate, slope[None], RECTANGLE)[0] == pytest.approx(expected, abs=1e-12)


def test_an_edge_that_only_crosses_the_rectangle_is_found():
    """The ridge of a roof is lowest where it leaves the rectangle; both ends lie outside."""
    roof = TriangleMesh(
        np.array([[-0.05, 0.0, 0.01], [0.05, 0.0, 0.002], [0.05, 0.05, 0.03], [-0.05, 0.05, 0.03]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    expected = 0.006 - 0.08 * RECTANGLE[1]
    assert find_lowest_points(roof, np.eye(4)[None], RECTANGLE)[0] == pytest.approx(expected, abs=1e-12)


def test_parts_beside_the_rectangle_are_ignored():
    low_post = trimesh.creation.box([0.004, 0.004, 0.02]).apply_translation([0.03, 0.0, 0.0])
    high_plate = trimesh.creation.box([0.03, 0.03, 0.002]).apply_translation([0.0, 0.0, 0.005])
    both = surface(trimesh.util.concatenate([low_post, high_plate]))
    T = make_translation([[0.0, 0.0, 0.0], [-0.025, 0.0, 0.0]])
    np.testing.assert_allclose(find_lowest_points(both, T, RECTANGLE), [0.004, -0.01], atol=1e-12)


def test_the_sides_of_the_rectangle_are_at_their_coordinates():
    """The tip of a needle is just inside and just outside each of the four sides."""
    needle = TriangleMesh(np.array([[0, 0, 0], [1e-5, 0, 0.01], [0, 1e-5, 0.01]]), np.array([[0, 1, 2]]))
    x0, x1, y0, y1 = RECTANGLE
    inside = np.array([[x0 + 1e-4, 0], [x1 - 1e-4, 0], [0, y0 + 1e-4], [0, y1 - 1e-4]])
    outside = np.array([[x0 - 1e-4, 0], [x1 + 1e-4, 0], [0, y0 - 1e-4], [0, y1 + 1e-4]])
    assert np.isfinite(
        find_lowest_points(needle, make_translation(np.column_stack([inside, np.zeros(4)])), RECTANGLE)
    ).all()
    assert np.isinf(
        find_lowest_points(needle, make_translation(np.column_stack([outside, np.zeros(4)])), RECTANGLE)
    ).all()


def test_bringing_to_contact_moves_poses_only_along_z(hook, flat_camera, pinhole):
    for geometry in (flat_camera, pinhole):
        T = random_poses(50, 3, spread_m=0.05)
        moved, touching = bring_to_contact(hook, T, geometry)
        assert 10 < touching.sum() < 50
        lowest = find_lowest_points(hook, moved[touching], geometry.rectangle)
        np.testing.assert_allclose(lowest, geometry.standoff_m, atol=1e-12)
        difference = moved - T
        difference[:, 2, 3] = 0
        assert not difference.any()
        assert np.array_equal(moved[~touching], T[~touching])
        assert np.isinf(find_lowest_points(hook, T[~touching], geometry.rectangle)).all()


def test_bringing_to_contact_keeps_its_input_and_accepts_no_poses(hook, flat_camera):
    T = random_poses(3, 4)
    before = T.copy()
    bring_to_contact(hook, T, flat_camera)
    assert np.array_equal(T, before)
    moved, touching = bring_to_contact(hook, T[:0], flat_camera)
    assert (moved.shape, touching.shape) == ((0, 4, 4), (0,))


def test_contact_does_not_depend_on_the_object_frame(hook, flat_camera):
    X, T = random_poses(1, 6)[0], random_poses(20, 7)
    drawn_elsewhere = TriangleMesh(transform_points(X, hook.vertices_m), hook.faces)
    moved, touching = bring_to_contact(hook, T, flat_camera)
    other, again = bring_to_contact(drawn_elsewhere, T @ np.linalg.inv(X), flat_camera)
    assert np.array_equal(touching, again)
    np.testing.assert_allclose((other @ X)[touching], moved[touching], atol=1e-12)


def test_contact_moves_with_the_rectangle():
    """A shift of the rectangle and the object together does not change the lowest points."""
    cube = surface(trimesh.creation.box([0.01, 0.02, 0.03]))
    T = random_poses(30, 8)
    x0, x1, y0, y1 = RECTANGLE
    shifted = (x0 + 0.01, x1 + 0.01, y0 - 0.02, y1 - 0.02)
    np.testing.assert_allclose(
        find_lowest_points(cube, make_translation([0.01, -0.02, 0]) @ T, shifted),
        find_lowest_points(cube, T, RECTANGLE),
        atol=1e-12,
    )


def test_lowest_points_are_equal_for_poses_together_and_alone(hook):
    """The search sorts many poses of one rotation, but not a few poses."""
    R = draw_rotations(3, np.random.default_rng(9))
    t = np.random.default_rng(10).uniform(-0.03, 0.03, (3, 12, 3))
    T = make_transform(R[:, None], t).reshape(-1, 4, 4)[np.random.default_rng(11).permutation(36)]
    together = find_lowest_points(hook, T, RECTANGLE)
    alone = np.concatenate([find_lowest_points(hook, pose[None], RECTANGLE) for pose in T])
    assert np.array_equal(together, alone)
    assert 0 < np.isinf(together).sum() < 36


def test_rotations_are_grouped_by_equality():
    R = draw_rotations(4, np.random.default_rng(12))
    order = np.array([2, 0, 0, 3, 2, 1, 2, 0])
    distinct, starts, members = group_rotations(R[order])
    assert len(distinct) == 4
    for k in range(4):
        for i in members[starts[k] : starts[k + 1]]:
            assert np.array_equal(distinct[k], R[order][i])
    assert sorted(members) == list(range(8))
    negative_zero = np.eye(3)
    negative_zero[0, 1] = -0.0
    assert len(group_rotations(np.stack([np.eye(3), negative_zero]))[0]) == 1


def test_the_rectangle_of_the_sensor_limits_contact():
    gel = SensorGeometry(
        "orthographic", 100, 100, 5000, 5000, 50, 50, 0.01, 0.002, rectangle_m=(-0.01, 0.0, -0.01, 0.01)
    )
    ball = surface(trimesh.creation.icosphere(3, 0.002))
    _, touching = bring_to_contact(ball, make_translation([[-0.005, 0, 0], [0.005, 0, 0]]), gel)
    assert touching.tolist() == [True, False]


def test_the_first_use_prints_no_warning():
    """For example, numba may warn about threading libraries that the user has not chosen."""
    script = """
import numpy as np
from tactile_loc.core.sensing.contact import find_lowest_points
from tactile_loc.core.objects.mesh import TriangleMesh
mesh = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
print(find_lowest_points(mesh, np.eye(4)[None], (-1, 1, -1, 1))[0])
"""
    ran = subprocess.run(
        [sys.executable, "-W", "default", "-c", script], capture_output=True, text=True, check=True, cwd=PROJECT
    )
    assert float(ran.stdout) == 0.0
    assert ran.stderr == ""
