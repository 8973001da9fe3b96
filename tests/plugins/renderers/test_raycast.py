"""The ray caster: culling does not change the result; its cache."""

import sys

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import SensorGeometry, TriangleMesh
from tactile_loc.plugin import RenderError
from tactile_loc.plugin.helpers import bring_to_contact, draw_rotations, make_transform

pytest.importorskip("open3d")

from tactile_loc.plugins.renderers import raycast
from tactile_loc.plugins.renderers.raycast import RaycastRenderer


def contact_poses(mesh, g, count=12):
    rng = np.random.default_rng(3)
    R = draw_rotations(count, rng)
    offset = np.c_[rng.uniform(-0.012, 0.012, (count, 2)), np.zeros(count)]
    T, touching = bring_to_contact(mesh, make_transform(R, offset), g)
    return T[touching]


def test_only_surfaces_beyond_the_contact_band_are_culled(camera, bracket, monkeypatch):
    T = contact_poses(bracket, camera)
    culled = RaycastRenderer().render(bracket, T, camera)
    everything = slice(0, camera.height_px), slice(0, camera.width_px)
    monkeypatch.setattr(raycast, "_find_pixel_box", lambda points, g: everything)
    full = RaycastRenderer().render(bracket, T, camera)
    limit = camera.standoff_m + camera.max_depth_m
    np.testing.assert_array_equal(np.minimum(culled, limit), np.minimum(full, limit))
    assert np.isfinite(culled).sum() < np.isfinite(full).sum()


def test_a_surface_that_reaches_behind_the_camera_is_drawn(quad):
    """An upright plate beside the sensor, at x = -4 mm and on both sides of the camera: its projection is unbounded."""
    g = SensorGeometry("pinhole", 90, 64, 62.0, 50.0, 39.3, 36.1, 0.021, 0.002)
    T = make_transform([[0, 0, 1], [1, 0, 0], [0, 1, 0]], [-0.004, 0.0, 0.0])
    slopes = (np.arange(g.width_px) + 0.5 - g.cx) / g.fx
    seen = slopes < -0.004 / (g.standoff_m + g.max_depth_m)
    depth = RaycastRenderer().render(quad, T[None], g)[0]
    np.testing.assert_allclose(
        depth[:, seen], np.broadcast_to(-0.004 / slopes[seen], (g.height_px, seen.sum())), rtol=1e-5
    )
    assert seen.sum() > 20


def test_a_scene_is_built_once_for_equal_surfaces_and_few_are_cached(camera, sphere, bracket, monkeypatch):
    built = []
    build = raycast._build_scene
    monkeypatch.setattr(raycast, "_build_scene", lambda mesh: built.append(mesh) or build(mesh))
    monkeypatch.setattr(raycast, "MOST_MESHES", 1)
    renderer = RaycastRenderer()
    T = make_transform(np.eye(3), [0, 0, camera.standoff_m + 0.008])[None]
    first = renderer.render(sphere, T, camera)
    renderer.render(TriangleMesh(sphere.vertices_m.copy(), sphere.faces.copy()), T, camera)
    assert len(built) == 1
    assert (first != renderer.render(bracket, T, camera)).any()
    np.testing.assert_array_equal(renderer.render(sphere, T, camera), first)
    assert len(renderer._meshes) == 1


def test_a_missing_open3d_gives_a_one_sentence_error(camera, sphere, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(RenderError, match=naming("open3d", "libusb-1.0-0", "`renderer` heightmap")):
        RaycastRenderer().render(sphere, np.eye(4)[None], camera)
