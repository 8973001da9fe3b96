import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tactile_loc import TriangleMesh, load_object
from tactile_loc.core.sensing.contact import bring_to_contact, find_lowest_points, group_rotations
from tactile_loc.plugin.helpers import draw_rotations, make_transform, make_translation, transform_points

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


SOLIDS = {
    "hook": lambda: load_object("hook", symmetry="none").mesh,
    "cube": lambda: surface(trimesh.creation.box([0.006, 0.006, 0.006])),
    "a face over the whole rectangle": lambda: surface(trimesh.creation.box([0.2, 0.2, 0.01])),
    "an edge across the rectangle": lambda: TriangleMesh(
        np.array([[-0.05, 0.0, 0.01], [0.05, 0.0, 0.002], [0.05, 0.05, 0.03], [-0.05, 0.05, 0.03]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    ),
    "a lower part beside the rectangle": lambda: surface(
        trimesh.util.concatenate(
            [
                trimesh.creation.box([0.004, 0.004, 0.02]).apply_translation([0.03, 0.0, 0.0]),
                trimesh.creation.box([0.03, 0.03, 0.002]).apply_translation([0.0, 0.0, 0.005]),
            ]
        )
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_lowest_points_agree_with_clipping_every_triangle(name):
    solid, T = SOLIDS[name](), np.concatenate([np.eye(4)[None], random_poses(6, 0)])
    points = transform_points(T, solid.triangles_m.reshape(-1, 3)).reshape(len(T), -1, 3, 3)
    expected = [lowest_by_clipping(triangles, RECTANGLE) for triangles in points]
    assert np.isfinite(expected).sum() >= 3
    np.testing.assert_allclose(find_lowest_points(solid, T, RECTANGLE), expected, atol=1e-12)


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
