import dataclasses

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, make_translation, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.contact import bring_to_contact
from tactile_loc.core.sensing.zbuffer import draw_nearest_depths
from tactile_loc.slots.registry import registry
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.problems import LOPSIDED_CAMERAS


@pytest.fixture(scope="module")
def knot() -> TriangleMesh:
    """Return a mesh with many small triangles, overhangs and no symmetry."""
    parts = [
        trimesh.creation.torus(0.008, 0.003),
        trimesh.creation.icosphere(3, 0.004).apply_translation([0.006, 0.004, 0.003]),
        trimesh.creation.box([0.004, 0.02, 0.003]),
    ]
    solid = trimesh.util.concatenate(parts)
    return TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))


@pytest.fixture(scope="module")
def raycast() -> Renderer:
    pytest.importorskip("open3d")
    return registry().create("renderer", "raycast", {})


def test_the_zbuffer_agrees_with_ray_casting(camera, knot, raycast):
    R = draw_rotations(6, np.random.default_rng(1))
    T, touching = bring_to_contact(knot, make_transform(R, [0.001, -0.002, 0.0]), camera)
    assert touching.all()
    limit = camera.standoff_m + camera.max_depth_m
    ours, theirs = (
        np.minimum(depth, limit) for depth in (draw_nearest_depths(knot, T, camera), raycast.render(knot, T, camera))
    )
    assert (ours < limit).mean() > 0.01
    assert (np.abs(ours - theirs) < 2e-7).mean() > 0.999  # a pixel's centre may lie on an edge


def test_a_triangle_that_reaches_behind_the_camera_is_clipped(raycast):
    g = LOPSIDED_CAMERAS["pinhole"]
    wall = TriangleMesh(np.array([[0.02, -1.0, -0.3], [0.02, 1.0, -0.3], [-0.005, 0.0, 0.0225]]), np.array([[0, 1, 2]]))
    ours = draw_nearest_depths(wall, np.eye(4)[None], g)[0]
    theirs = raycast.render(wall, np.eye(4)[None], g)[0]
    limit = g.standoff_m + g.max_depth_m
    assert (ours < limit).any()
    np.testing.assert_allclose(np.minimum(ours, limit), np.minimum(theirs, limit), rtol=1e-5)


def test_surfaces_beyond_the_band_or_the_view_are_not_drawn(camera, knot):
    far = make_translation([[0.0, 0.0, 1.0], [5.0, 0.0, camera.standoff_m], [-5.0, 5.0, camera.standoff_m]])
    assert np.isinf(draw_nearest_depths(knot, far, camera)).all()


def test_no_ray_passes_between_two_adjacent_triangles(camera):
    """A fan of triangles whose edges pass through pixel centres."""
    turn = rotation_about([0, 0, 1], np.linspace(0, 2 * np.pi, 25)[:-1])
    rim = turn @ np.array([0.1, 0.0, 0.0])
    mesh = TriangleMesh(
        np.vstack([[[0.0, 0.0, 0.0]], rim]), np.array([[0, 1 + i, 1 + (i + 1) % 24] for i in range(24)])
    )
    centred = dataclasses.replace(camera, cx=45.5, cy=32.5)
    assert np.isfinite(draw_nearest_depths(mesh, make_translation([[0.0, 0.0, 0.022]]), centred)).all()
